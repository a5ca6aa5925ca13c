"""Check of a forecast's file by the joint density of DACs under the prior, as it is and with each fault undone.

The prior gives the means p of the currents along dive paths and their covariance C; R is the observation-error covariance. A file with
currents M f in place of f gives means M p and covariance M C M'. The densities N(M p, M C M' + R) of the DACs compare the faults. C
accounts for dives in one eddy; for a forecast without skill no fault is found or excluded.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding
from replay_kit.core.observation import PathMean
from replay_kit.estimator import ReducedBasisEstimator
from replay_kit.estimator.update.screening import screened
from replay_kit.measurements.checks import concluded as findings
from replay_kit.measurements.checks.likelihood import LEAST_GAIN
from replay_kit.measurements.checks.slips import slips

# Dives before which nothing is said, and those that are compared at most, evenly spread.
_LEAST_DIVES, _MOST_DIVES = 8, 40
# Logarithm of the likelihood ratio of a fault below which it is excluded; faults whose gains differ by less are named together.
_EXCLUDED, _ALIKE = -3.0, 3.0


class FileCheck(NamedTuple):
    """Result of the check of a forecast's file by DACs: a warning, or a sentence on faults neither found nor excluded."""

    finding: Finding | None = None
    note: str = ""


def check_file(estimator: Any, means: Iterable[PathMean]) -> FileCheck:
    """Return the check of a forecast's file by DACs.

    Args:
        estimator: Estimator with the prior; the check is empty if that is not a single Gaussian of weights.
        means: DACs of dives.
    """
    if not isinstance(estimator, ReducedBasisEstimator):
        return FileCheck()
    dives = [*filter(estimator.usable, means)]
    if len(dives) < _LEAST_DIVES:
        return FileCheck()
    measured, predicted, covariance, variance = _under_prior(
        estimator, dives[:: math.ceil(len(dives) / _MOST_DIVES)]
    )
    as_is, _ = _density(measured, predicted, covariance, variance)
    gains = dict[str, float]()
    for each in slips():
        turn = np.kron(np.eye(len(measured) // 2), each.matrix)
        density, misfit = _density(measured, turn @ predicted, turn @ covariance @ turn.T, variance)
        # of a forecast that is too sure of itself all gains count for less
        gain = (density - as_is) / max(1.0, misfit)
        gains[each.name] = max(gain, gains.get(each.name, -math.inf))
    best = max(gains.values())
    likely = [name for name, gain in gains.items() if gain > best - _ALIKE]
    if best >= LEAST_GAIN:
        return FileCheck(findings.forecast_fault(likely, best, len(measured) // 2))
    left = sorted(name for name, gain in gains.items() if gain > _EXCLUDED)
    listed = ", ".join(f"{name} e^{gains[name]:z.0f}" for name in left)
    about = f"(likelihood ratios to none by {len(measured) // 2} mean currents: {listed})"
    return FileCheck(
        note=f"cannot be known here: some faults of the forecast's file {about}" if left else ""
    )


def _under_prior(
    estimator: ReducedBasisEstimator, dives: Sequence[PathMean]
) -> tuple[Array, Array, Array, Array]:
    """Return measured and predicted DACs, shape (2 k,) [m/s], the covariance of the prediction, and the observation-error variances."""
    columns = estimator.observer.columns(screened(dives, estimator.grid)[0])
    design = np.concatenate([column.design for column in columns])
    parts = [column.parts[0] for column in columns]
    innovation = np.concatenate([part.about[0].ravel() for part in parts])
    variance = np.repeat([part.layout.std[0] ** 2 for part in parts], 2)
    measured = np.concatenate([mean.used for mean in dives])
    return measured, measured - innovation, design @ design.T, variance


def _density(
    measured: Array, predicted: Array, covariance: Array, variance: Array
) -> tuple[float, float]:
    """Return the log density without the constant of 2 pi, and the normalised innovation squared per value."""
    lower = np.linalg.cholesky(covariance + np.diag(variance))
    nis = float(np.sum(solve_triangular(lower, measured - predicted, lower=True) ** 2))
    return -0.5 * nis - float(np.log(np.diag(lower)).sum()), nis / len(measured)
