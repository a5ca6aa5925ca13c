"""The gate: chi-square test of a profile's innovation, softening, errors adapted to the profile's own scatter, covariance inflation.

A profile's compressed rows carry all its information on the weights; the compression residual is noise alone, and measures how large the
noise is. The innovation of the rows is tested along the eigenvectors of its predicted covariance: a profile that is wrong as a whole, as
after a bad platform velocity, differs along the one of most variance, where a sum over all rows would hide it among the others.

Outliers are few, however, and a wrong estimate is contradicted by many profiles: until five profiles were tested, or where more than a
third of the latest exceed the gate, a profile is softened instead (the K-factor of EnKF-C: it moves the estimate by about two standard
deviations at most). Where half of the latest twenty exceed their 97.5 % limit, the covariance is inflated by the median of their
normalised innovations, by two at once and four in all, and the run reports it: an instrument that fails for long looks the same as a
wrong ensemble, and a covariance without bounds would follow it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from replay_kit.config.estimation import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Decision

#: What the gate decides, of a measurement that can be used.
DECISIONS: tuple[Decision, ...] = ("accepted", "softened", "rejected")
#: Positions among them.
SOFTENED, REJECTED = 1, 2
# Share of the noise variance above which a direction's prior variance is significant.
_SIGNIFICANT_SHARE = 0.01
# Prior standard deviations by which a softened profile may move the estimate, about.
_SOFTENING = 2.0
# A softening that inflates the error variance by less than this factor is none.
_LEAST_SOFTENING = 1.1
# Upper end of the 95 % band: one profile in forty lies beyond it.
_TAIL = 0.025
# Largest covariance inflation: at one time, and the product of all.
_ONE_INFLATION, _TOTAL_INFLATION = 2.0, 4.0
# Profiles after which the gate rejects, and the share of the latest beyond the gate up to which it does.
_LEAST_PROFILES, _OUTLIER_SHARE = 5, 0.34


@dataclass(frozen=True, slots=True, eq=False)
class Gates:
    """The gate's decisions on n profiles of m compressed rows, the last of which may be empty.

    Attributes:
        decision: shape (n,), position in ``DECISIONS``.
        statistic: shape (n,), normalised innovation squared of the compressed rows, with the errors as adapted.
        threshold: shape (n,), chi-square threshold of the statistic; inf without a gate.
        exceeds: shape (n,), whether the profile exceeds the gate, in the sum or in one direction.
        error_factor: shape (n,), factor, at least 1, on the profile's error variance.
        dof: shape (n,), number of compressed rows.
        variance: shape (n, m), eigenvalues of the rows' predicted covariance; 0 of empty rows.
        vectors: shape (n or 1, m, m), eigenvectors.
        along: shape (n, m), innovations along these.
    """

    decision: NDArray[np.intp]
    statistic: Array
    threshold: Array
    exceeds: NDArray[np.bool_]
    error_factor: Array
    dof: NDArray[np.intp]
    variance: Array
    vectors: Array
    along: Array

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """Which profiles are assimilated."""
        return np.asarray(self.decision < REJECTED)

    @property
    def nis(self) -> Array:
        """Normalised innovation squared of the rows, with the stated errors, shape (n,)."""
        return np.asarray(np.sum(self.along**2 / (self.variance + 1.0), axis=1))

    @staticmethod
    def joined(parts: "Sequence[Gates]") -> "Gates":
        """Return the decisions on several parts of a group as one."""
        if len(parts) == 1:
            return parts[0]

        def whole(name: str) -> NDArray[Any]:
            each = [getattr(part, name) for part in parts]
            return np.concatenate(
                [
                    np.broadcast_to(v, (len(p.along), *v.shape[1:]))
                    for v, p in zip(each, parts, strict=True)
                ]
            )

        return Gates(*(whole(each.name) for each in fields(Gates)))


class Spectrum(NamedTuple):
    """Innovations of n profiles along the eigenvectors of their predicted covariance, without the noise of unit variance.

    Attributes:
        variance: shape (n or 1, m), eigenvalues; 0 of empty rows.
        vectors: shape (n or 1, m, m), eigenvectors.
        along: shape (n, m), innovations along these.
    """

    variance: Array
    vectors: Array
    along: Array

    @staticmethod
    def of(innovation: Array, cov: Array) -> "Spectrum":
        """Return that of innovations, shape (n, m), 0 of empty rows, and their covariance, shape (n or 1, m, m)."""
        variance, vectors = np.linalg.eigh(cov)
        along = np.matmul(vectors.swapaxes(1, 2), innovation[..., None])[..., 0]
        return Spectrum(np.maximum(variance, 0.0), vectors, along)


def gate_innovations(
    spectrum: Spectrum,
    dof: NDArray[np.intp],
    residual: tuple[Array, NDArray[np.intp]],
    config: GatingConfig | None,
    is_consistent: bool = True,
) -> Gates:
    """Return the gate's decisions on profiles.

    Args:
        spectrum: Of their compressed rows.
        dof: shape (n,), number of rows that are not empty.
        residual: Squared norm of the whitened compression residual, and its degrees of freedom, shape (n,) each.
        config: None accepts every profile with its stated errors.
        is_consistent: Whether recent innovations agree with the estimate; if not, a profile beyond the gate is softened, not rejected.
    """
    n, along = len(spectrum.along), spectrum.along
    values = np.broadcast_to(spectrum.variance, along.shape)
    square, residual_dof = residual
    scale = np.ones(n)
    if config and config.adapt_errors:
        noisy = (residual_dof > 0) & (square > _thresholds(config.gate_probability, residual_dof))
        scale = np.where(noisy, square / np.maximum(residual_dof, 1), 1.0)
    squared = along**2 / (values + scale[:, None])
    statistic, decision = squared.sum(axis=1), np.zeros(n, np.intp)
    threshold, exceeds = np.full(n, np.inf), np.zeros(n, np.bool_)
    if config is not None and config.gate != "off":
        threshold = _thresholds(config.gate_probability, dof)
        # where the prior has no part in the variance, directions are arbitrary, and their sum is tested already
        one = _of_each(dof, lambda rows: chi_square_threshold(config.gate_probability / rows, 1))
        significant = values > _SIGNIFICANT_SHARE * scale[:, None]
        beyond = significant & (squared > one[:, None])
        exceeds = (statistic > threshold) | np.any(beyond, axis=1)
        decision = np.where(exceeds, REJECTED, 0)
        soft = np.full(n, config.gate == "soften") | (exceeds & (not is_consistent))
        if soft.any():
            softened = softened_variance(values, scale[:, None], along, _SOFTENING).max(axis=1)
            is_softened = softened > scale * _LEAST_SOFTENING
            decision = np.where(soft, np.where(is_softened, SOFTENED, 0), decision)
            scale = np.where(soft, softened, scale)
    return Gates(
        decision, statistic, threshold, exceeds, scale, dof, values, spectrum.vectors, along
    )


def _of_each(numbers: NDArray[np.intp], function: Callable[[int], float]) -> Array:
    """Return a function of numbers, most often all the same, shape (n,)."""
    if np.all(numbers == numbers[0]):
        return np.full(numbers.shape, function(int(numbers[0])))
    return np.array([function(each) for each in numbers.tolist()])


def _thresholds(probability: float, dof: NDArray[np.intp]) -> Array:
    return _of_each(
        dof, lambda each: chi_square_threshold(probability, each) if each else float("inf")
    )


def softened_variance(
    prior: Array, error: Array | float, innovation: Array, factor: float
) -> Array:
    """Return error variances that bound how far innovations move the estimate (Sakov and Sandery 2017, Tellus A 69, eq. 8).

    Args:
        prior: shape (m,), predicted variance of each innovation without error.
        error: Its error variance, one or those of many.
        innovation: shape (m,).
        factor: K; an update is at most about K prior standard deviations.
    """
    softened = np.sqrt((prior + error) ** 2 + prior * innovation**2 / factor**2) - prior
    return np.maximum(np.where(prior > 0.0, softened, error), error)


@lru_cache(maxsize=1024)
def chi_square_threshold(probability: float, dof: int) -> float:
    """Return the value that a chi-square variable exceeds with a probability."""
    return float(chdtri(dof, probability))


@dataclass(frozen=True, slots=True)
class ConsistencyMonitor:
    """The latest gate results: whether innovations are as large as the estimate predicts.

    Attributes:
        latest: Statistic, degrees of freedom and whether the gate was exceeded, of the latest profiles, oldest first.
        inflation: Product of all inflations of the covariance.
    """

    latest: tuple[tuple[float, int, bool], ...] = ()
    inflation: float = 1.0

    @property
    def is_consistent(self) -> bool:
        """Whether recent innovations agree with the estimate: outliers are few, and a wrong estimate is contradicted by many profiles.

        A gate that rejects every profile would keep a wrong estimate for ever.
        """
        exceeding = sum(exceeds for _, _, exceeds in self.latest)
        return len(self.latest) >= _LEAST_PROFILES and exceeding <= _OUTLIER_SHARE * len(
            self.latest
        )

    def updated(
        self, gates: Gates, config: GatingConfig | None
    ) -> "tuple[ConsistencyMonitor, float]":
        """Return the monitor after profiles, and the factor by which to inflate the estimate's covariance, usually 1.

        The first alone counts, as the others share the estimate's error.

        When half of the latest profiles lie beyond what one in forty should, the covariance grows by the median of their normalised
        innovations, and the monitor starts again. Contradictory data, as from two instruments that disagree, would inflate it for ever:
        each inflation and their product are limited.
        """
        if config is None:
            return self, 1.0
        first = float(gates.statistic[0]), int(gates.dof[0]), bool(gates.exceeds[0])
        latest = (*self.latest, first)[-config.inflation_profiles :]
        tail = sum(statistic > chi_square_threshold(_TAIL, dof) for statistic, dof, _ in latest)
        full = len(latest) == config.inflation_profiles
        if not (
            config.inflate
            and full
            and 2 * tail >= len(latest)
            and self.inflation < _TOTAL_INFLATION
        ):
            return ConsistencyMonitor(latest, self.inflation), 1.0
        median = float(np.median([statistic / dof for statistic, dof, _ in latest]))
        factor = float(np.clip(median, 1.0, min(_ONE_INFLATION, _TOTAL_INFLATION / self.inflation)))
        return ConsistencyMonitor((), self.inflation * factor), factor
