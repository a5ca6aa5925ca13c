"""What the places of a mission keep clear of: half-planes that stay, or that touch obstacles where the places are and follow them."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from planners.solver import KM
from replay_kit.core.arrays import Array


class Obstacles(Protocol):
    """Obstacles near places, one for each of some places of the path."""

    def planes(self, points: Array) -> tuple[Array, Array]:
        """Return the half-planes that touch them, and how these turn.

        Args:
            points: shape (n, 2) [m].

        Returns:
            shape (n, 3), normal and offset [m], with a margin; shape (n,), curvature of the lines of equal distance [1/m].
        """


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Half-planes at the places of a path.

    Attributes:
        key: Of the unknowns that they belong to.
        normals: shape (L, n_places, P, 2).
        curvature: shape (L, n_places, P) [1/km].
        shares: shape (L, n_places, P), of the step that leads to the place, at which each counts; 1 for the place itself.
        beyond: shape (L, n_places, P), how far the path is beyond each [km]; negative inside.
    """

    key: bytes
    normals: Array
    curvature: Array
    shares: Array
    beyond: Array

    def _moved(self, begins: Array, ends: Array) -> Array:
        """Return the derivatives of the places at which they count, shape (L, n_places, P, 2, Q)."""
        shares = self.shares[..., None, None]
        return (1.0 - shares) * begins[:, :, None] + shares * ends[:, :, None]

    def jacobian(self, begins: Array, ends: Array) -> Array:
        """Return the derivatives of ``beyond``, shape (L, n_places, P, Q), by those of where steps begin and end, (L, n_places, 2, Q)."""
        return (self.normals[..., None, :] @ self._moved(begins, ends))[..., 0, :]

    def pulls(self, weights: Array) -> Array:
        """Return a weighted sum, weights of shape (L, n_places, P), as one over the places: shape (L, n_places, 2)."""
        each = weights[..., None] * self.normals
        out = np.sum(self.shares[..., None] * each, axis=2)
        # where a leg begins is an unknown itself, without second derivatives
        out[:, :-1] += np.sum((1.0 - self.shares)[..., None] * each, axis=2)[:, 1:]
        return np.asarray(out)

    def bend(self, weights: Array, begins: Array, ends: Array) -> Array:
        """Return the second derivatives of the weighted sum by the turning of the half-planes, shape (L, Q, Q)."""
        number, size = len(weights), begins.shape[-1]
        turning = np.nonzero(weights * self.curvature)
        out = np.zeros((number, size, size))
        if not turning[0].size:
            return out
        shares = self.shares[turning][:, None, None]
        moved = (1.0 - shares) * begins[turning[:2]] + shares * ends[turning[:2]]
        normals = self.normals[turning]
        # round a corner the distance bends across the direction to it
        across = np.einsum("ki,kiq->kq", normals[:, ::-1] * np.array([1.0, -1.0]), moved)
        np.add.at(
            out,
            turning[0],
            -(weights * self.curvature)[turning][:, None, None]
            * across[:, :, None]
            * across[:, None],
        )
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """What the places of a mission keep clear of.

    Attributes:
        shares: shape (L, n_places, P), of the step that leads to a place, at which each half-plane counts; 1 for the place itself.
        planes: shape (L, n_places, P, 3), normal and offset [m] of half-planes that stay; None for those that follow the places.
        obstacles: What they touch as they follow; None for half-planes that stay.
    """

    shares: Array
    planes: Array | None = None
    obstacles: Obstacles | None = None

    @property
    def count(self) -> int:
        """Number of half-planes of each place."""
        return int(self.shares.shape[2])

    def limits(self, begins: Array, ends: Array, key: bytes) -> Limits:
        """Return the half-planes at a path, given where each step that counts begins and ends [km], shape (L, n_places, 2)."""
        at = begins[:, :, None] + self.shares[..., None] * (ends - begins)[:, :, None]
        if self.obstacles is None:
            assert self.planes is not None, "half-planes stay or follow"
            planes, curvature = self.planes, np.zeros(at.shape[:3])
        else:
            found, turning = self.obstacles.planes(at.reshape(-1, 2) * KM)
            planes, curvature = found.reshape(*at.shape[:3], 3), turning.reshape(at.shape[:3]) * KM
        normals = planes[..., :2]
        return Limits(
            key,
            normals,
            curvature,
            self.shares,
            np.sum(normals * at, axis=-1) - planes[..., 2] / KM,
        )
