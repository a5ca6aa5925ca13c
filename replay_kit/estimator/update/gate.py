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

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from replay_kit.config.gating import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Decision

#: Share of the noise variance above which a direction's prior variance is significant.
SIGNIFICANT_SHARE = 0.01
#: Prior standard deviations by which a softened profile may move the estimate, about.
SOFTENING = 2.0
#: A softening that inflates the error variance by less than this factor is none.
LEAST_SOFTENING = 1.1
# Upper end of the 95 % band: one profile in forty lies beyond it.
_TAIL = 0.025
# Largest covariance inflation: at one time, and the product of all.
_ONE_INFLATION, _TOTAL_INFLATION = 2.0, 4.0
# Profiles after which the gate rejects, and the share of the latest beyond the gate up to which it does.
_LEAST_PROFILES, _OUTLIER_SHARE = 5, 0.34


@dataclass(frozen=True, slots=True, eq=False)
class GateResult:
    """The gate's decision on a profile.

    Attributes:
        decision: ``accepted``, ``softened`` or ``rejected``.
        statistic: Normalised innovation squared of the compressed rows, with the errors as adapted.
        dof: Number of compressed rows.
        threshold: Chi-square threshold of the statistic; inf without a gate.
        exceeds_gate: Whether the profile exceeds the gate, in the sum or in one direction.
        inflation: Factor, at least 1, on the profile's error variance.
        variance: shape (dof,), eigenvalues of the rows' predicted covariance.
    """

    decision: Decision
    statistic: float
    dof: int
    threshold: float
    exceeds_gate: bool
    inflation: float
    variance: Array

    def signal_dof(self, inflation: float) -> float:
        """Return the degrees of freedom for signal, the trace of the update's influence matrix (Cardinali et al. 2004).

        Args:
            inflation: Factor on the error variance in the update.
        """
        return float(np.sum(self.variance / (self.variance + inflation)))


def gate_innovation(
    innovation: Array,
    cov: Array,
    residual: tuple[float, int],
    config: GatingConfig | None,
    is_consistent: bool = True,
) -> GateResult:
    """Return the gate's decision on a profile.

    Args:
        innovation: shape (m,), of compressed rows with noise of unit variance.
        cov: shape (m, m), predicted covariance of the rows without their noise.
        residual: Squared norm of the whitened compression residual, and its degrees of freedom.
        config: None accepts every profile with its stated errors.
        is_consistent: Whether recent innovations agree with the estimate; if not, a profile beyond the gate is softened, not rejected.
    """
    values, vectors = np.linalg.eigh(cov)
    values, along = np.maximum(values, 0.0), vectors.T @ innovation
    residual_square, residual_dof = residual
    scale = 1.0
    if (
        config
        and config.adapt_errors
        and residual_dof
        and residual_square > chi_square_threshold(config.gate_probability, residual_dof)
    ):
        scale = residual_square / residual_dof
    squared = along**2 / (values + scale)
    statistic, dof = float(squared.sum()), innovation.size
    if config is None or config.gate == "off":
        return GateResult("accepted", statistic, dof, np.inf, False, scale, values)
    threshold = chi_square_threshold(config.gate_probability, dof)
    # where the prior has no part in the variance, directions are arbitrary, and their sum is tested already
    significant = squared[values > SIGNIFICANT_SHARE * scale]
    exceeds = statistic > threshold or bool(
        np.any(significant > chi_square_threshold(config.gate_probability / dof, 1))
    )
    decision: Decision = "rejected" if exceeds else "accepted"
    if config.gate == "soften" or (exceeds and not is_consistent):
        softened = float(np.max(softened_variance(values, scale, along, SOFTENING)))
        decision, scale = "softened" if softened > scale * LEAST_SOFTENING else "accepted", softened
    return GateResult(decision, statistic, dof, threshold, exceeds, scale, values)


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
        self, result: GateResult, config: GatingConfig | None
    ) -> "tuple[ConsistencyMonitor, float]":
        """Return the monitor after a profile, and the factor by which to inflate the estimate's covariance, usually 1.

        When half of the latest profiles lie beyond what one in forty should, the covariance grows by the median of their normalised
        innovations, and the monitor starts again. Contradictory data, as from two instruments that disagree, would inflate it for ever:
        each inflation and their product are limited.
        """
        if config is None:
            return self, 1.0
        latest = (*self.latest, (result.statistic, result.dof, result.exceeds_gate))[
            -config.inflation_profiles :
        ]
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
