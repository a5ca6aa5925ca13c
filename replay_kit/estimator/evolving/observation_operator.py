"""The observation operator: rows of unit noise for profiles and for means along a path.

At a place each unknown of the process model gives a current level by level, S_c (Z x n) for component c, which the hat functions D
interpolate to the bins; oscillations have depth functions of their own, D_o, and biases are proportional to the velocity relative to the
platform. So a component's design is

    [D S_c | D_o O_c | B_c] = J F_c,    J = [D | D_o | M],

with one depth factor J for both components, which a QR factorisation compresses as in ``update/compression.py``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.evolution import ProcessModel
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.observation import Observation, PathMean
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.basis.noise import bin_noise
from replay_kit.estimator.evolving.extras import Oscillations
from replay_kit.estimator.update.biases import Biases, relative_velocity
from replay_kit.estimator.update.compression import Bins
from replay_kit.estimator.update.path_mean import depth_means, mean_noise
from replay_kit.estimator.update.screening import local_mean

_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class LinearObservation(Bins):
    """An observation's rows: y = H x + noise of unit variance.

    Attributes:
        design: shape (2 k, n), H. Values are measured about the current of unknowns that are all zero.
    """

    design: Array


@dataclass(frozen=True, slots=True, eq=False)
class ObservationOperator:
    """The map from the state to observations.

    Attributes:
        basis: Basis flows.
        process: The weights' prior through time.
        oscillations: Uniform over the region.
        biases: Of the instrument.
        representation_std: shape (Z,) [m/s], representation error of the basis, by level.
    """

    basis: Basis
    process: ProcessModel
    oscillations: Oscillations
    biases: Biases
    representation_std: Array

    def current(self, east: float, north: float, time_ns: int) -> tuple[Array, Array]:
        """Return the current at a place level by level: without the unknowns, shape (Z, 2), and of each of them, (F + B, Z, 2) [m/s]."""
        offset, modes = self.basis.at_place(np.array([east, north]))
        known = offset.T + self.process.mean_at(time_ns) @ modes.T
        return known, self.process.project(modes, time_ns)

    def profile(self, observation: Observation, used: NDArray[np.intp]) -> LinearObservation:
        """Return the rows of a profile's usable bins."""
        grid, depth, time_ns = self.basis.grid, observation.depth[used], observation.time_ns
        place = (grid.projection, observation.longitude, observation.latitude)
        east, north = to_local(*place)
        known, unknown = self.current(float(east), float(north), time_ns)
        weights = depth_weights(self.basis.depth_functions, depth, grid.levels)
        velocity = np.column_stack(rotate_to_local(*place, *observation.velocity[used].T))
        (of_levels,) = self.basis.local_error(
            np.array([[east, north]], dtype=np.float64), self.representation_std
        )
        representation = np.interp(depth, grid.levels, of_levels)
        noise = bin_noise(
            depth,
            observation.error_std[used],
            representation,
            observation.common_std,
            observation.correlation_depth,
        )
        relative = relative_velocity(observation, used, grid.projection)
        of_biases = self.biases.bins(depth, relative)
        joint: Array = np.hstack([weights, self.oscillations.weights(depth), of_biases.depth])
        q, r = np.linalg.qr(noise.whiten @ joint)
        n_levels, n_knots = weights.shape[1], self.oscillations.knots.size
        design = [
            np.hstack(
                [
                    r[:, :n_levels] @ unknown[:, :, c].T,
                    r[:, n_levels : n_levels + n_knots] @ self.oscillations.factor(c),
                    r[:, n_levels + n_knots :] @ of_biases.factor[c],
                ]
            )
            for c in range(2)
        ]
        return LinearObservation(q, noise, velocity - weights @ known, np.vstack(design))

    def path(self, mean: PathMean) -> LinearObservation:
        """Return the rows of a mean along a path: the time-weighted sum over its points, each at its own time.

        The unknowns are those at the path's end. Pairs are rotated back to each point's time; process noise within a dive is neglected.
        """
        grid = self.basis.grid
        east, north = to_local(grid.projection, mean.longitude, mean.latitude)
        weights = depth_means(mean, self.basis)
        knots = mean.weight[:, None] * self.oscillations.weights(mean.depth)
        known, design, oscillating = (
            np.zeros(2),
            np.zeros((self.process.size, 2)),
            np.zeros((2, self.oscillations.size)),
        )
        for k in np.flatnonzero(mean.weight > 0.0):
            of_known, unknown = self.current(
                float(east[k]), float(north[k]), int(mean.path_time_ns[k])
            )
            known += weights[k] @ of_known
            design += np.einsum("z,nzc->nc", weights[k], unknown)
            back = (int(mean.path_time_ns[k]) - mean.time_ns) / _NS
            for c in range(2):
                oscillating[c] += self.oscillations.at(knots[k] @ self.oscillations.factor(c), back)
        noise = mean_noise(
            mean, self.basis, np.column_stack([east, north]), self.representation_std
        )
        rows = np.hstack([design.T, oscillating, np.zeros((2, self.biases.size))]) / noise.std[0]
        return LinearObservation(
            np.ones((1, 1)), noise, local_mean(mean, grid.projection) - known, rows
        )
