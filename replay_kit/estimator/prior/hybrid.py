"""The prior of the weights: mean and covariance over the ensemble's members, kept in the parts that it is made of."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.basis.shifts import projector, shift_operators, shifted_in_modes
from replay_kit.estimator.prior.localised import localised_part
from replay_kit.estimator.prior.reduction import Reduction, hybrid_reduction


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
        """Return what rows take from the covariance of sums of levels; see ``reduction.py``.

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
        return np.diag(self.variance[_indices(levels)].ravel())

    def of_sum(self, levels: tuple[int, ...]) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        return np.diag(self.variance[list(levels)].sum(axis=0))

    def reduction(self, directions: Array, matrix: Array) -> Reduction:
        """Return what rows in ``directions``, shape (s, r), with ``matrix``, shape (Z s, Z s), take from sums of levels."""
        blocks = matrix.reshape(len(self.variance), len(directions), len(self.variance), -1)

        def reduction(levels: tuple[int, ...]) -> Array:
            scaled = {level: directions * self.variance[level] for level in levels}
            return np.asarray(sum(scaled[j].T @ blocks[j, :, k] @ scaled[k] for j in levels for k in levels))

        return reduction


@dataclass(frozen=True, slots=True, eq=False)
class HybridPrior:
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

    def matvec(self, weights: Array) -> Array:
        """Return the covariance times each weight vector, shape (m, Z, r), in the same shape."""
        rows = self.factor.reshape(self.factor.shape[0], self.mean.size)
        of_factor = ((weights.reshape(len(weights), self.mean.size) @ rows.T) @ rows).reshape(weights.shape)
        in_functions = (self.vertical @ weights).swapaxes(0, 1)  # (q, m, r)
        groups = [np.matmul(in_functions[part], of_modes) for part, of_modes in self._groups()]
        return np.asarray(of_factor + np.einsum("qz,qmr->mzr", self.vertical, np.concatenate([in_functions[:0], *groups]), optimize=True))

    def matvec_modes(self, basis: Array, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights with ``basis``, shape (c, r), at each level: shape (Z, c, L, r)."""
        n_rows, n_levels, n_modes = self.factor.shape
        n_basis, chosen = basis.shape[0], _indices(levels)
        factor = self.factor[:, chosen]
        n_chosen = factor.shape[1]
        at_basis = (self.factor @ basis.T).reshape(n_rows, n_levels * n_basis)
        of_factor = (at_basis.T @ factor.reshape(n_rows, n_chosen * n_modes)).reshape(n_levels, n_basis, n_chosen, n_modes)
        in_modes = np.matmul(basis, self.horizontal).reshape(len(self.horizontal), basis.size)  # (g, c r)
        pairs = self._pairs(slice(None), chosen).reshape(-1, n_levels * n_chosen)
        in_functions = (pairs.T @ in_modes).reshape(n_levels, n_chosen, n_basis, n_modes)
        of_factor += in_functions.transpose(0, 2, 1, 3)
        return np.asarray(of_factor)

    def mode_std(self) -> Array:
        """Return the standard deviation of each mode's weight, root mean square over levels, shape (r,)."""
        of_factor = np.einsum("fzr,fzr->r", self.factor, self.factor)
        # the squares of the functions of one covariance sum to one
        in_functions = np.einsum("grr->r", self.horizontal)
        return np.asarray(np.sqrt((of_factor + in_functions) / self.factor.shape[1]))

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        chosen = _indices(levels)
        factor = self.factor[:, chosen]
        n_rows, n_levels, n_modes = factor.shape
        stacked = factor.reshape(n_rows, n_levels * n_modes)
        cov = stacked.T @ stacked
        block = cov.reshape(n_levels, n_modes, n_levels, n_modes)
        for pairs, of_modes in zip(self._pairs(chosen, chosen), self.horizontal, strict=True):
            block += np.multiply.outer(pairs, of_modes).transpose(0, 2, 1, 3)
        return cov

    def of_sum(self, levels: tuple[int, ...]) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        factor, share = self.factor[:, list(levels)].sum(axis=1), np.square(self.vertical[:, list(levels)].sum(axis=1))
        shares = np.array([share[part].sum() for part, _ in self._groups()])
        return np.asarray(factor.T @ factor + np.tensordot(shares, self.horizontal, 1))

    def reduction(self, directions: Array, matrix: Array) -> Reduction:
        """Return what rows in ``directions``, shape (s, r), with ``matrix``, shape (Z s, Z s), take from sums of levels."""
        return hybrid_reduction(self.factor, self.vertical, self.horizontal, directions, matrix)

    def _groups(self) -> Iterator[tuple[slice, Array]]:
        """Yield the functions that share a covariance of the modes' amplitudes, and that covariance."""
        last = len(self.horizontal) - 1
        for group, of_modes in enumerate(self.horizontal):
            yield slice(group, None if group == last else group + 1), of_modes

    def _pairs(self, levels: slice | list[int], others: slice | list[int]) -> Array:
        """Return the covariance between levels of one unit of each covariance of the modes' amplitudes, shape (g, L, M)."""
        rows, columns = self.vertical[:, levels], self.vertical[:, others]
        parts = [rows[part].T @ columns[part] for part, _ in self._groups()]
        return np.stack(parts) if parts else np.empty((0, rows.shape[1], columns.shape[1]))


def _indices(levels: tuple[int, ...] | None) -> slice | list[int]:
    """Return the index of some levels along their axis."""
    return slice(None) if levels is None else list(levels)


def diagonal_prior(member_weights: Array) -> DiagonalPrior:
    """Return the paper's prior: mean over members, and the variances alone.

    Args:
        member_weights: shape (E, Z, r).
    """
    return DiagonalPrior(member_weights.mean(axis=0).ravel(), member_weights.var(axis=0, ddof=1))


def hybrid_prior(member_weights: Array, velocity_modes: Array, nodes: Array, settings: PriorSettings) -> HybridPrior:
    """Return the prior of the members and their shifted copies: sample covariance, mixed with a localised one.

    Every member is used unshifted and, with half the weight each, shifted by one correlation length to the four sides: the shape of eddies
    in the members holds for eddies nearby too (spatial averages of covariances, Berre and Desroziers 2010, Mon. Wea. Rev. 138;
    valid-space shifting, Xu et al. 2011). The sample covariance of so many members still contains chance correlations between distant
    places, and has low rank. The localised part (hybrid covariance, Hamill and Snyder 2000) has full rank and no distant correlations: for
    each empirical orthogonal function of depth, the covariance over the grid is tapered with distance (Gaspari and Cohn 1999) and
    projected on the modes (``localised.py``).

    Args:
        member_weights: shape (E, Z, r).
        velocity_modes: shape (2N, r) [m/s for a weight of one], the modes at the nodes.
        nodes: shape (N, 2) [m], east and north.
        settings: Shares and distances. A share of 1 and no shift give the plain sample covariance.
    """
    share = settings.sample_share
    n_members, n_levels, n_modes = member_weights.shape
    mean = member_weights.mean(axis=0)
    to_modes = projector(velocity_modes)
    anomalies = (member_weights - mean) / np.sqrt(n_members - 1.0)
    anomalies = shifted_in_modes(anomalies, shift_operators(velocity_modes, to_modes, nodes, settings.shift))
    if share == 1.0:
        return HybridPrior(mean.ravel(), anomalies, np.empty((0, n_levels)), np.empty((0, n_modes, n_modes)), settings)
    vertical, horizontal = localised_part(anomalies, velocity_modes, to_modes, nodes, settings.radius)
    return HybridPrior(mean.ravel(), np.sqrt(share) * anomalies, vertical, (1.0 - share) * horizontal, settings)
