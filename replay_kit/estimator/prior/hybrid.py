"""The prior of the weights: mean and covariance over the ensemble's members, kept in the parts that it is made of."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import HybridProducts, Reduction, indices_of
from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.prior.localised import localised_part


class Prior(Protocol):
    """Gaussian prior of the weights, level after level, r for each level."""

    @property
    def settings(self) -> "PriorSettings | None":
        """The settings it was made with; None when it was not made of members by settings."""
        ...

    @property
    def mean(self) -> Array:
        """Mean, shape (Z r,)."""
        ...

    def matvec(self, weights: Array) -> Array:
        """Return the covariance times each weight vector, shape (m, Z, r), in the same shape."""
        ...

    def matvec_modes(self, basis: Array, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights with modes' combinations at each level, shape (Z, c, L, r).

        Args:
            basis: shape (c, r); entry [z, c] of the result is the covariance times a weight vector that holds ``basis[c]`` at level z.
            levels: The L levels; None for all.
        """
        ...

    def mode_std(self) -> Array:
        """Return the standard deviation of each mode's weight, root mean square over levels, shape (r,)."""
        ...

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        ...

    def of_sum(self, levels: tuple[int, ...]) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        ...

    def reduction(self, directions: Array, matrix: Array) -> Reduction:
        """Return what rows take from the covariance of sums of levels; see ``core/flow/covariance.py``.

        Args:
            directions: shape (s, r), of the rows.
            matrix: shape (Z s, Z s), symmetric.
        """
        ...


@dataclass(frozen=True, slots=True)
class PriorSettings:
    """The settings of a hybrid prior.

    Attributes:
        sample_share: Of the sample covariance; the localised one has the rest.
        shift: Distance of the shifted copies [m]; 0 makes none.
        radius: Where the localised part's taper reaches zero [m].
    """

    sample_share: float
    shift: float
    radius: float

    def __str__(self) -> str:
        """Return the settings in words."""
        shift, radius = self.shift / 1e3, self.radius / 1e3
        return f"sample share {self.sample_share:.2f}, members shifted by {shift:.1f} km, taper to zero at {radius:.1f} km"


@dataclass(frozen=True, slots=True, eq=False)
class DiagonalPrior:
    """Independent weights, as in the paper.

    Attributes:
        mean: shape (Z r,).
        variance: shape (Z, r).
        settings: Always None.
    """

    mean: Array
    variance: Array
    settings: None = None

    def matvec(self, weights: Array) -> Array:
        """Return the covariance times each weight vector, shape (m, Z, r), in the same shape."""
        return self.variance * weights

    def matvec_modes(self, basis: Array, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights with ``basis``, shape (c, r), at each level: shape (Z, c, L, r)."""
        n_levels, n_modes = self.variance.shape
        chosen = np.arange(n_levels) if levels is None else np.array(levels)
        out = np.zeros((n_levels, basis.shape[0], chosen.size, n_modes))
        out[chosen, :, np.arange(chosen.size), :] = self.variance[chosen, None, :] * basis
        return out

    def mode_std(self) -> Array:
        """Return the standard deviation of each mode's weight, root mean square over levels, shape (r,)."""
        return np.asarray(np.sqrt(self.variance.mean(axis=0)))

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        return np.diag(self.variance[indices_of(levels)].ravel())

    def of_sum(self, levels: tuple[int, ...]) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        return np.diag(self.variance[list(levels)].sum(axis=0))

    def reduction(self, directions: Array, matrix: Array) -> Reduction:
        """Return what rows in ``directions``, shape (s, r), with ``matrix``, shape (Z s, Z s), take from sums of levels."""
        blocks = matrix.reshape(len(self.variance), len(directions), len(self.variance), -1)

        def reduction(levels: tuple[int, ...]) -> Array:
            scaled = {level: directions * self.variance[level] for level in levels}
            return np.asarray(
                sum(scaled[j].T @ blocks[j, :, k] @ scaled[k] for j in levels for k in levels)
            )

        return reduction


@dataclass(frozen=True, slots=True, eq=False)
class HybridPrior(HybridProducts):
    """The sum of a low-rank covariance and one that is independent between vertical functions.

    Attributes:
        mean: shape (Z r,).
        factor: shape (F, Z, r); the first part is the sum of the rows' outer products.
        vertical: shape (q, Z), orthogonal rows, one a vertical function.
        horizontal: shape (g, r, r), covariance of the modes' amplitudes for each vertical function; those from the g-th on have the last.
        settings: The settings it was made with; None when it was not made of members.
    """

    mean: Array
    factor: Array
    vertical: Array
    horizontal: Array
    settings: PriorSettings | None = None


def diagonal_prior(member_weights: Array) -> DiagonalPrior:
    """Return the paper's prior: mean over members, and the variances alone.

    Args:
        member_weights: shape (E, Z, r).
    """
    return DiagonalPrior(member_weights.mean(axis=0).ravel(), member_weights.var(axis=0, ddof=1))


def hybrid_prior(
    member_weights: Array, modes: ShiftedModes, settings: PriorSettings
) -> HybridPrior:
    """Return the prior of the members and their shifted copies: sample covariance, mixed with a localised one.

    Every member is used unshifted and, with half the weight each, shifted by one correlation length to the four sides: the shape of eddies
    in the members holds for eddies nearby too (spatial averages of covariances, Berre and Desroziers 2010, Mon. Wea. Rev. 138;
    valid-space shifting, Xu et al. 2011). The sample covariance of so many members still contains chance correlations between distant
    places, and has low rank. The localised part (hybrid covariance, Hamill and Snyder 2000) has full rank and no distant correlations: for
    each empirical orthogonal function of depth, the covariance over the grid is tapered with distance (Gaspari and Cohn 1999) and
    projected on the modes (``localised.py``).

    Args:
        member_weights: shape (E, Z, r).
        modes: Shifted by the settings' distance.
        settings: Shares and distances. A share of 1 and no shift give the plain sample covariance.
    """
    share = settings.sample_share
    n_members, n_levels, n_modes = member_weights.shape
    mean = member_weights.mean(axis=0)
    anomalies = modes.copies((member_weights - mean) / np.sqrt(n_members - 1.0))
    if share == 1.0:
        return HybridPrior(
            mean.ravel(),
            anomalies,
            np.empty((0, n_levels)),
            np.empty((0, n_modes, n_modes)),
            settings,
        )
    vertical, horizontal = localised_part(anomalies, modes, settings.radius)
    return HybridPrior(
        mean.ravel(), np.sqrt(share) * anomalies, vertical, (1.0 - share) * horizontal, settings
    )


def with_mean_amplitude(prior: HybridPrior, mean_weights: Array, variance: float) -> HybridPrior:
    """Return a prior under which the amplitude of the ensemble mean is uncertain too.

    Args:
        prior: Of the members.
        mean_weights: shape (Z, r), the ensemble mean.
        variance: Of its amplitude, whose mean is 1.
    """
    return replace(
        prior, factor=np.concatenate([prior.factor, np.sqrt(variance) * mean_weights[None]])
    )
