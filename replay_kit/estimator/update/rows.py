"""Measurements as rows of unit noise on the weights: a product where all values lie at one place, dense where each is a sum over several.

A mean along a path is the exact weighted sum of the basis flows at the path's points.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Generic, Literal, TypeVar

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import LinearMeasurement
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.update.gate import ConsistencyMonitor
from replay_kit.estimator.update.noise import BinNoise, compress
from replay_kit.estimator.update.screening import local_values
from replay_kit.estimator.update.stack import Stack, stack_of_one


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What rows were made of.

    Attributes:
        y: shape (c k,), the rows' values, component after component.
        stack: The measurement, or those that are combined.
    """

    y: Array
    stack: Stack

    def misfit(self, rows: Array) -> Array:
        """Return measured minus predicted values of one measurement along the local axes, shape (m, 2) [m/s]; ``rows``, shape (c k,)."""
        by_component = rows.reshape(1, len(self.stack.components), -1)
        return np.asarray(self.stack.misfit(by_component)[self.stack.used])


@dataclass(frozen=True, slots=True, eq=False)
class ProfileRows(Measured):
    """A profile compressed: y = H w + noise of unit variance, with k = min(m, Z) rows a component.

    Attributes:
        r: shape (k, Z), the whitened depth factor.
        basis: shape (c, r), the modes' velocity at the point along each component.
    """

    r: Array
    basis: Array

    at_one_place: ClassVar[Literal[True]] = True

    def design(self) -> Array:
        """Return H, shape (c k, Z r), component after component."""
        rows: Array = np.einsum("kz,cm->ckzm", self.r, self.basis)
        return rows.reshape(len(self.basis) * len(self.r), -1)

    def matvec(self, weights: Array) -> Array:
        """Return H times weights, shape (..., c k); ``weights`` of shape (..., Z, r)."""
        rows: Array = self.r @ (weights @ self.basis.T)  # (..., k, c)
        return np.swapaxes(rows, -1, -2).reshape(*weights.shape[:-2], -1)


@dataclass(frozen=True, slots=True, eq=False)
class PathRows(Measured):
    """Sums over several places: y = H w + noise of unit variance, one row for each value that is known.

    Attributes:
        by_level: shape (c k, Z, r), H.
    """

    by_level: Array

    at_one_place: ClassVar[Literal[False]] = False

    def design(self) -> Array:
        """Return H, shape (c k, Z r)."""
        return self.by_level.reshape(len(self.by_level), -1)

    def matvec(self, weights: Array) -> Array:
        """Return H times weights, shape (..., c k); ``weights`` of shape (..., Z, r)."""
        return np.asarray(np.tensordot(weights, self.by_level, axes=([-2, -1], [1, 2])))


#: Rows of a measurement, in one of two forms.
Rows = ProfileRows | PathRows


def places_of(observation: LinearMeasurement, projection: Projection) -> Array:
    """Return the places of a measurement's points, shape (P, 2) or (1, 2) [m], local east and north."""
    return np.column_stack(to_local(projection, observation.longitude, observation.latitude))


def measurement_rows(
    observation: LinearMeasurement, used: NDArray[np.intp], basis: Basis, noise: BinNoise
) -> Rows:
    """Return the rows of a measurement's usable values, compressed where all of them lie at one place.

    Args:
        observation: The measurement.
        used: Positions of its usable values.
        basis: Basis flows.
        noise: Of these values, the same for each component.
    """
    projection = basis.grid.projection
    values, components = local_values(observation, used, projection)
    at_points, weights = basis.depth_weights(observation.depth), observation.weights
    if observation.at_one_place:
        at_values = observation.at_values(at_points)[used]
        offset, modes = basis.at_place(places_of(observation, projection)[0])
        q, r = compress(noise, at_values)
        about = values - at_values @ offset.T @ components.T
        own = noise, q, np.eye(len(r))
        stack = stack_of_one(observation, used, (about, components), own, basis.grid)
        return ProfileRows(stack.y.ravel(), stack, r, components @ modes)
    assert weights is not None, "each value is a sum over places"
    places = places_of(observation, projection)
    n, levels = used.size, np.arange(at_points.shape[1])
    at_levels = (weights[used, :, None] * at_points).swapaxes(1, 2).reshape(n * levels.size, -1)
    offsets, modes = (
        each.reshape(2, n, levels.size, -1)
        for each in basis.horizontal.sums(places, at_levels, basis.offset, basis.modes)
    )
    known = offsets[:, :, levels, levels].sum(axis=-1).T @ components.T
    along = np.tensordot(components, modes, axes=1)  # (c, n, Z, r)
    design = np.tensordot(noise.whiten, along, axes=(1, 1)).swapaxes(0, 1)
    each, left = np.eye(len(noise.whiten)), (values - known, components)
    stack = stack_of_one(observation, used, left, (noise, each, each), basis.grid)
    return PathRows(stack.y.ravel(), stack, design.reshape(-1, *design.shape[2:]))


_NEW_MONITOR = ConsistencyMonitor()
After = TypeVar("After")


@dataclass(frozen=True, eq=False)
class PredictedObservation(Generic[After]):
    """The prediction of an observation's rows before they are assimilated.

    Attributes:
        means: shape (c k, 1 + b): mean of the rows, and its change for each instrument error of one unit.
        cov: shape (c k, c k), of the rows without their own noise.
        update: Returns the estimate after the rows, given the Cholesky factor of the scaled innovation covariance, the innovation whitened
            by it, and the error scale by which both were divided.
    """

    means: Array
    cov: Array
    update: Callable[[Array, Array, float], After]


def kalman_update(
    means: Array, cov: Array, design: Array, innovation: Array
) -> tuple[Array, Array]:
    """Return means and covariance after rows of unit noise.

    Args:
        means: shape (n, 1 + b): the state's mean, and its sensitivity to each instrument error of one unit.
        cov: shape (n, n).
        design: shape (m, n).
        innovation: shape (m, 1 + b).
    """
    cross = design @ cov
    lower = np.linalg.cholesky(cross @ design.T + np.eye(len(design)))
    both = scipy.linalg.solve_triangular(lower, np.hstack([cross, innovation]), lower=True)
    gain = both[:, : len(cov)]
    return means + gain.T @ both[:, len(cov) :], cov - gain.T @ gain


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Assimilation:
    """What every state holds of the measurements so far, beside the estimate.

    Attributes:
        time_ns: Of the last observation used [ns, UTC]; None before the first.
        monitor: Of the latest gate results.
        last: The last measurement with a usable bin; an equal one that follows is a duplicate.
    """

    time_ns: int | None = None
    monitor: ConsistencyMonitor = _NEW_MONITOR
    last: LinearMeasurement | None = None
