"""What an observation said, once it was looked at: the same words for every form of the estimate."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.estimator.gate import Verdict
from replay_kit.estimator.kalman import Bins
from replay_kit.estimator.screening import scatter
from replay_kit.types import Array, Innovation


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """What was expected of an observation's rows; all of unit noise.

    Attributes:
        mean: shape (m,), before it counted.
        cov: shape (m, m), of that, without the rows' own noise.
        prior: shape (m,), without any observation.
    """

    mean: Array
    cov: Array
    prior: Array


def innovation_of(
    said: Innovation,
    used: NDArray[np.intp],
    bins: Bins,
    values: Array,
    expected: Expected,
    after: Array,
    verdict: Verdict,
    inflation: float,
    grown: float,
) -> Innovation:
    """Return the innovation of an observation that was judged.

    Args:
        said: What is said of it before it is looked at.
        used: Positions of the usable bins.
        bins: Their rows.
        values: shape (n, 2) [m/s], of the usable bins, about the same as the rows.
        expected: Of the rows.
        after: shape (m,), rows' mean after it counted, or before when it was rejected.
        verdict: On it.
        inflation: Of the error variance, in the update.
        grown: Factor on the estimate's covariance after it.
    """
    rows, left_out = bins.compress(values)
    innovation, size = rows - expected.mean, said.depth.size
    believed = verdict.decision != "rejected"
    variance = bins.expand_variance(expected.cov) + np.square(bins.noise.std)[:, None]
    return replace(
        said,
        innovation=scatter(size, used, bins.misfit(values, expected.mean)),
        innovation_std=scatter(size, used, np.sqrt(variance)),
        residual=scatter(size, used, bins.misfit(values, after)),
        prior_innovation=scatter(size, used, bins.misfit(values, expected.prior)),
        nis=float(innovation @ np.linalg.solve(expected.cov + np.eye(rows.size), innovation)) + left_out,
        dof=bins.dof,
        accepted=believed,
        error_inflation=inflation,
        decision=verdict.decision,
        gate_statistic=verdict.statistic,
        gate=verdict.gate,
        signal_dof=verdict.signal_dof(inflation) if believed else 0.0,
        prior_inflation=grown,
    )
