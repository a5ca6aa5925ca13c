"""The covariance of a flow's weights in factors: a prior's parts, and what measured rows took from it.

With directions B, shape (s, r), and a symmetric matrix M, shape (Z s, Z s), the covariance is P = P0 - X' M X with X = (I (x) B) P0, of
which there are far fewer elements than of P where directions are few.

A sample needs no P either. With w drawn from the prior, b = (I (x) B) w its components, C = (I (x) B) P0 (I (x) B') and M = U'U,

    w - X' (M b + U' n),    n ~ N(0, 1 - U C U'),

has the covariance P0 - 2 X' M X + X' (M C M + M - M C M) X = P. It is the prior's sample conditioned on perturbed measurements (Matheron's
rule; Journel and Huijbregts 1978, Mining Geostatistics): with rows H that have noise of variance 1, M = H' (H C H' + 1)^-1 H, and
U' n stands for what their perturbations add.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import HybridCovariance, Levels, Reduction, root_of, symmetric


def n_stored(prior: HybridCovariance, n_directions: int) -> int:
    """Return the number of elements to store of a covariance with some number of directions, of symmetric matrices one half."""
    _, n_levels, n_modes = prior.factor.shape
    halves = len(prior.horizontal) * half_size(n_modes) + half_size(n_levels * n_directions)
    return int(prior.factor.size + prior.vertical.size + halves + n_directions * n_modes)


def half_size(n: int) -> int:
    """Return the number of elements of a symmetric matrix of n rows, none twice."""
    return n * (n + 1) // 2


# Not slotted: what samples need is computed when first asked for.
@dataclass(frozen=True, eq=False)
class CovarianceFactors:
    """The covariance of weights in factors, a ``FactoredCovariance``.

    Attributes:
        prior: Before any measurement.
        directions: shape (s, r), B.
        matrix: shape (Z s, Z s), M, symmetric.
    """

    prior: HybridCovariance
    directions: Array
    matrix: Array

    def __call__(self, levels: Levels | None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        cov = self.prior.covariance(levels)
        across = self.prior.matvec_modes(self.directions, levels).reshape(
            len(self.matrix), len(cov)
        )
        cov -= across.T @ (self.matrix @ across)
        return symmetric(cov)

    def of_sum(self, levels: Levels) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        before = self.prior.of_sum(levels)
        return before - self._reduction(levels) if len(self.directions) else before

    def of_combinations(self, design: Array) -> Array:
        """Return the covariance of combinations of the weights, shape (m, m); ``design`` of shape (m, Z, r)."""
        cross, m = self.prior.matvec(design), len(design)
        inside = (cross @ self.directions.T).reshape(m, -1)
        return np.asarray(
            design.reshape(m, -1) @ cross.reshape(m, -1).T - inside @ self.matrix @ inside.T
        )

    def factors(self) -> "CovarianceFactors":
        """Return itself."""
        return self

    def draws(self, n: int, seed: int) -> Array:
        """Return samples of the weights about their mean, shape (n, Z, r); the same seed gives the same.

        Raises:
            EstimatorError: The covariance is not a number.
        """
        rng = np.random.default_rng(seed)
        factor, vertical = self.prior.factor, self.prior.vertical
        weights = np.tensordot(rng.standard_normal((n, len(factor))), factor, axes=1)
        last = len(self._roots) - 1
        for number, function in enumerate(vertical):
            root = self._roots[min(number, last)]
            weights += (
                function[:, None] * (rng.standard_normal((n, root.shape[1])) @ root.T)[:, None]
            )
        if not len(self.directions):
            return weights
        turned, noise = self._conditioning
        inside = (weights @ self.directions.T).reshape(n, -1)
        taken = inside @ self.matrix + rng.standard_normal((n, noise.shape[1])) @ noise.T @ turned.T
        by_level = taken.reshape(n, -1, len(self.directions)) @ self.directions
        return np.asarray(weights - self.prior.matvec(by_level))

    @cached_property
    def _reduction(self) -> Reduction:
        return self.prior.reduction(self.directions, self.matrix)

    @cached_property
    def _roots(self) -> list[Array]:
        """Factors of the covariances of the modes' amplitudes."""
        return [root_of(each) for each in self.prior.horizontal]

    @cached_property
    def _conditioning(self) -> tuple[Array, Array]:
        """U', shape (Z s, u), and a factor of the covariance of n, shape (u, .)."""
        turned = root_of(self.matrix)
        inside = (self.prior.matvec_modes(self.directions) @ self.directions.T).reshape(
            self.matrix.shape
        )
        return turned, root_of(symmetric(np.eye(turned.shape[1]) - turned.T @ inside @ turned))


def half_of(matrix: Array) -> Array:
    """Return the lower halves of symmetric matrices, shape (..., n, n), row by row, shape (..., n (n + 1) / 2)."""
    rows, columns = np.tril_indices(matrix.shape[-1])
    return np.asarray(matrix[..., rows, columns])


def whole_of(half: Array) -> Array:
    """Return symmetric matrices, shape (..., n, n), of their lower halves.

    Raises:
        ValueError: The halves are of no square matrix.
    """
    n = int((np.sqrt(8 * half.shape[-1] + 1) - 1) / 2)
    if half_size(n) != half.shape[-1]:
        raise ValueError(f"{half.shape[-1]} elements are not half of a symmetric matrix")
    rows, columns = np.tril_indices(n)
    matrix = np.empty((*half.shape[:-1], n, n))
    matrix[..., rows, columns] = half
    matrix[..., columns, rows] = half
    return matrix


@runtime_checkable
class FactoredCovariance(Protocol):
    """A covariance kept in factors."""

    def __call__(self, levels: Levels | None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        ...

    def of_sum(self, levels: Levels) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        ...

    def of_combinations(self, design: Array) -> Array:
        """Return the covariance of combinations of the weights, shape (m, m); ``design`` of shape (m, Z, r)."""
        ...

    def factors(self) -> CovarianceFactors | None:
        """Return the factors to keep; None where the matrix has fewer elements."""
        ...


#: A matrix, shape (Z r, Z r), or a function that returns that of some levels' weights, None for all.
WeightCovariance = Array | Callable[[Levels | None], Array]


def covariance_of_sum(covariance: WeightCovariance, levels: Levels, n_modes: int) -> Array:
    """Return the covariance of the sum of some levels' weights, shape (r, r).

    Args:
        covariance: Of all weights.
        levels: The levels.
        n_modes: Number of modes r.
    """
    if isinstance(covariance, FactoredCovariance):
        return covariance.of_sum(levels)
    if callable(covariance):
        blocks = covariance(levels).reshape(len(levels), n_modes, len(levels), n_modes)
    else:
        chosen = list(levels)
        blocks = covariance.reshape(-1, n_modes, covariance.shape[0] // n_modes, n_modes)[chosen][
            :, :, chosen
        ]
    return np.asarray(blocks.sum(axis=(0, 2)))
