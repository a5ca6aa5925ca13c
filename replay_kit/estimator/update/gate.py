"""Whether a profile is believed, and how much: chi-square gate, softening, errors adapted to the profile's own scatter.

A profile's compressed rows carry all it says of the weights; what compression leaves out is noise alone, and tells how large the noise
is. The innovation of the rows is looked at along the eigenvectors of its predicted covariance: a profile that is wrong as a whole, as
after a bad platform velocity, differs along the one of most variance, where a sum over all rows would hide it among the others.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from replay_kit.config.gating import TrustConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation import Decision


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What is done with a profile.

    Attributes:
        decision: ``accepted``, ``softened`` or ``rejected``.
        statistic: Normalised innovation squared of the compressed rows, with the errors as adapted.
        dof: Number of compressed rows.
        gate: What the statistic was held against; inf without a gate.
        beyond: Whether the profile lies beyond the gate, in all or in one direction.
        inflation: Factor, at least 1, by which the profile's error variance grows.
        variance: shape (dof,), eigenvalues of the rows' predicted covariance.
    """

    decision: Decision
    statistic: float
    dof: int
    gate: float
    beyond: bool
    inflation: float
    variance: Array

    def signal_dof(self, inflation: float) -> float:
        """Return the degrees of freedom for signal, the trace of the update's influence matrix (Cardinali et al. 2004).

        Args:
            inflation: Of the error variance, in the update.
        """
        return float(np.sum(self.variance / (self.variance + inflation)))


def judge(innovation: Array, cov: Array, left_out: float, n_left_out: int, config: TrustConfig | None, settled: bool = True) -> Verdict:
    """Return what is done with a profile.

    Args:
        innovation: shape (m,), of compressed rows with noise of unit variance.
        cov: shape (m, m), predicted covariance of the rows without their noise.
        left_out: Squared norm of the whitened innovation that compression left out.
        n_left_out: Number of its degrees of freedom.
        config: None accepts everything as it is.
        settled: Whether the estimate has been right of late; what contradicts one that has not is softened, not rejected.
    """
    dof = innovation.size
    values, vectors = np.linalg.eigh(cov)
    values, along = np.maximum(values, 0.0), vectors.T @ innovation
    if config is None:
        return Verdict("accepted", float(np.sum(along**2 / (values + 1.0))), dof, np.inf, False, 1.0, values)
    scale = 1.0
    if config.adapt_errors and n_left_out and left_out > limit(config.gate_probability, n_left_out):
        scale = left_out / n_left_out
    squared = along**2 / (values + scale)
    statistic = float(squared.sum())
    if config.gate == "off":
        return Verdict("accepted", statistic, dof, np.inf, False, scale, values)
    gate = limit(config.gate_probability, dof)
    # where the estimate has no part in the variance, directions are arbitrary, and their sum is judged already
    known = squared[values > _PART * scale]
    beyond = statistic > gate or bool(np.any(known > limit(config.gate_probability / dof, 1)))
    if config.gate == "soften" or (beyond and not settled):
        softened = float(np.max(softened_variance(values, scale, along, config.soften_factor)))
        return Verdict("softened" if softened > scale * _VISIBLE else "accepted", statistic, dof, gate, beyond, softened, values)
    return Verdict("rejected" if beyond else "accepted", statistic, dof, gate, beyond, scale, values)


# Of the noise's variance, above which the estimate's own is a direction's matter.
_PART = 0.01
# a softening below this share of the error variance is none
_VISIBLE = 1.1


def softened_variance(prior: Array, error: float, innovation: Array, factor: float) -> Array:
    """Return error variances that bound how far innovations move the estimate (Sakov and Sandery 2017, Tellus A 69, eq. 8).

    Args:
        prior: shape (m,), predicted variance of each innovation without error.
        error: Its error variance.
        innovation: shape (m,).
        factor: K; an update is at most about K prior standard deviations.
    """
    grown = np.sqrt((prior + error) ** 2 + prior * innovation**2 / factor**2) - prior
    return np.maximum(np.where(prior > 0.0, grown, error), error)


@lru_cache(maxsize=1024)
def limit(probability: float, dof: int) -> float:
    """Return the value that a chi-square variable exceeds with a probability."""
    return float(chdtri(dof, probability))


@dataclass(frozen=True, slots=True)
class Watch:
    """The latest profiles' verdicts: whether the estimate knows its own errors.

    Attributes:
        latest: Statistic, degrees of freedom and whether beyond the gate, of the latest profiles, oldest first.
        grown: Product of all factors by which the covariance was grown.
    """

    latest: tuple[tuple[float, int, bool], ...] = ()
    grown: float = 1.0

    @property
    def settled(self) -> bool:
        """Whether the estimate has been right of late: outliers are few, and an estimate that is wrong is contradicted by many.

        A gate that rejects profile after profile would keep what the first of them said, or the ensemble did, for ever.
        """
        return len(self.latest) >= _SETTLED and sum(beyond for _, _, beyond in self.latest) <= _OUTLIERS * len(self.latest)

    def after(self, verdict: Verdict, config: TrustConfig | None) -> "tuple[Watch, float]":
        """Return the watch after a profile, and the factor by which the estimate's covariance should grow; 1 as a rule.

        Profiles with outliers are few, and an estimate that is wrong is contradicted by most. When half of the latest lie beyond what
        one in forty should, the covariance grows by the median of their normalised innovations, and the watch begins anew. What
        contradicts itself, as two instruments that disagree, would let it grow for ever: there is a limit to each growth and to all.
        """
        if config is None:
            return self, 1.0
        latest = (*self.latest, (verdict.statistic, verdict.dof, verdict.beyond))[-config.watch_profiles :]
        same = Watch(latest, self.grown)
        if len(latest) < config.watch_profiles or not config.watch:
            return same, 1.0
        beyond = sum(statistic > limit(_TAIL, dof) for statistic, dof, _ in latest)
        if 2 * beyond < len(latest) or self.grown >= _ALL_GROWTH:
            return same, 1.0
        median = float(np.median([statistic / dof for statistic, dof, _ in latest]))
        factor = float(np.clip(median, 1.0, min(_ONE_GROWTH, _ALL_GROWTH / self.grown)))
        return Watch((), self.grown * factor), factor


# one in forty: the upper end of the 95 % band
_TAIL = 0.025
# Factors on the covariance: of one growth, and of all together.
_ONE_GROWTH, _ALL_GROWTH = 2.0, 4.0
# Profiles after which the gate rejects, and the share of the latest beyond it up to which it does.
_SETTLED, _OUTLIERS = 5, 0.34
