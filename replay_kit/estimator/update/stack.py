"""Measurements with as many values each as arrays, whitened and compressed as ``noise.py`` does with one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.grid import Grid
from replay_kit.core.observation import BOTH_COMPONENTS, LinearMeasurement
from replay_kit.estimator.update.biases import bias_rows, scale_error_std
from replay_kit.estimator.update.noise import BinNoise
from replay_kit.estimator.update.screening import relative_velocities

#: Noise, Q and R of a measurement's used values.
Factors = Callable[[LinearMeasurement, NDArray[np.intp]], tuple[BinNoise, Array, Array]]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """What measurements with the same depths, errors and used values have in common, padded with zeros where a value is not used.

    Attributes:
        rows: shape (q, n), from values to compressed rows, Q'W.
        whiten: shape (n, n), W.
        unwhiten: shape (n, n).
        q: shape (n, q), Q.
        r: shape (q, q), from a column's unknowns to the rows.
        distance: shape (n,) [m], from the first used value.
        std: shape (n,) [m/s], stated error of each value; zero where not used.
        dof: Number of independent measured values of all components.
        k: Number of compressed rows of a component.
        half_log_det: Of one component's error covariance.
    """

    rows: Array
    whiten: Array
    unwhiten: Array
    q: Array
    r: Array
    distance: Array
    std: Array
    dof: int
    k: int
    half_log_det: float


def layout_of(
    observation: LinearMeasurement, used: NDArray[np.intp], noise: BinNoise, q: Array, r: Array
) -> Layout:
    """Return the layout of a measurement's used values.

    Args:
        observation: The measurement.
        used: Positions of the values.
        noise: Of these.
        q: shape (m, k), orthonormal columns.
        r: shape (k, q), from a column's unknowns to the rows.
    """
    depth = observation.value_depth
    n, (known, k), width = depth.size, q.shape, r.shape[1]
    whiten, unwhiten, wide, square = (
        np.zeros(shape) for shape in ((n, n), (n, n), (n, width), (width, width))
    )
    whiten[:known, used], unwhiten[used, :known] = noise.whiten, noise.unwhiten
    wide[:known, :k], square[:k] = q, r
    distance, std = np.zeros(n), np.zeros(n)
    distance[used], std[used] = np.abs(depth[used] - depth[used[0]]), noise.std
    return Layout(
        wide.T @ whiten,
        whiten,
        unwhiten,
        wide,
        square,
        distance,
        std,
        len(observation.components) * known,
        k,
        noise.half_log_det,
    )


# Not slotted: what is computed of all is kept.
@dataclass(frozen=True, eq=False)
class Stack:
    """Usable measurements as arrays.

    Attributes:
        observations: The n measurements.
        used: shape (n, m), which values are used.
        values: shape (n, m, c) [m/s], along the components, about the estimator's reference current; 0 where not used.
        components: shape (c, 2), of the local axes, that are measured.
        relative: shape (n, 2) [m/s], mean velocity of the used values relative to the platform; None where the log does not state it.
        layouts: Those that occur.
        layout: shape (n,), each measurement's.
    """

    observations: tuple[LinearMeasurement, ...]
    used: NDArray[np.bool_]
    values: Array
    components: Array
    relative: Array | None
    layouts: tuple[Layout, ...]
    layout: NDArray[np.intp]

    @cached_property
    def whitened(self) -> Array:
        """The values in units of their error, shape (n, m, c)."""
        return np.asarray(np.matmul(self.of("whiten"), self.values))

    @cached_property
    def y(self) -> Array:
        """Compressed rows, shape (n, c, q)."""
        return np.asarray(np.matmul(self.of("rows"), self.values).swapaxes(1, 2))

    @cached_property
    def residual_square(self) -> Array:
        """Squared norm of the compression residual, shape (n,)."""
        of_values, of_rows = (np.sum(each**2, axis=(1, 2)) for each in (self.whitened, self.y))
        return np.asarray(np.maximum(of_values - of_rows, 0.0))

    def of(self, name: str) -> Array:
        """Return an attribute of the layouts: of each measurement, shape (n, ...), or of all, shape (1, ...), where they have the same."""
        if len(self.layouts) == 1:
            return np.asarray(getattr(self.layouts[0], name))[None]
        return np.stack([np.asarray(getattr(layout, name)) for layout in self.layouts])[self.layout]

    def of_each(self, name: str) -> NDArray[Any]:
        """Return a number of the layouts for each measurement, shape (n,)."""
        first = getattr(self.layouts[0], name)
        return np.full(len(self.layout), first) if len(self.layouts) == 1 else self.of(name)

    def part(self, rows: NDArray[np.intp]) -> "Stack":
        """Return some of the measurements."""
        if len(rows) == len(self.observations):
            return self
        kept = np.unique(self.layout[rows])
        found = Stack(
            tuple(self.observations[i] for i in rows),
            self.used[rows],
            self.values[rows],
            self.components,
            None if self.relative is None else self.relative[rows],
            tuple(self.layouts[i] for i in kept),
            np.searchsorted(kept, self.layout[rows]),
        )
        # what was computed of all is not computed again
        for name in ("whitened", "y", "residual_square"):
            found.__dict__[name] = getattr(self, name)[rows]
        return found

    def misfit(self, rows: Array) -> Array:
        """Return measured minus predicted values along the local axes, shape (..., n, m, 2) [m/s], 0 where not used.

        Args:
            rows: shape (..., n, c, q), predicted.
        """
        return np.asarray(
            np.matmul(self.of("unwhiten"), self.whitened_misfit(rows)) @ self.components
        )

    def whitened_misfit(self, rows: Array) -> Array:
        """Return the same along the components, in units of their error, shape (..., n, m, c)."""
        return np.asarray(self.whitened - np.matmul(self.of("q"), rows.swapaxes(-1, -2)))

    def variances(self, cov: Array) -> tuple[Array, Array]:
        """Return the variance of the values along the local axes that the rows' has, and that of their errors, shape (n, m, 2) [m^2/s^2].

        Args:
            cov: shape (n, c q, c q), covariance of the rows.
        """
        bins, n_components = np.matmul(self.of("unwhiten"), self.of("q")), len(self.components)
        q = cov.shape[1] // n_components
        of_rows = np.stack(
            [
                np.sum(np.matmul(bins, cov[:, part, part]) * bins, axis=2)
                for part in (slice(c * q, (c + 1) * q) for c in range(n_components))
            ],
            axis=-1,
        )
        errors = np.broadcast_to(self.of("std")[..., None] ** 2, self.values.shape)
        turned = self.components**2
        return np.maximum(of_rows, 0.0) @ turned, errors @ turned

    @property
    def ones(self) -> Array:
        """The rows of a velocity of one in all used values, shape (n, q)."""
        return np.asarray(
            np.matmul(self.of("rows"), self.used[..., None].astype(np.float64))[..., 0]
        )

    @property
    def scale_error_std(self) -> Array | None:
        """See ``biases.scale_error_std``, shape (n,); None where the first has none."""
        stds = [scale_error_std(observation) for observation in self.observations]
        return None if stds[0] is None else np.array(stds, dtype=np.float64)

    def bias_rows(self, misfit: Array) -> Array | None:
        """Return the effect of instrument errors of one unit on the rows, shape (n, 2, q, 3); see ``biases.bias_rows``.

        Args:
            misfit: shape (n, m, 2) [m/s], measured minus predicted values.
        """
        if self.relative is None:
            return None
        growing = np.matmul(self.of("rows"), self.of("distance")[..., None])[..., 0]
        mean = misfit.sum(axis=1) / self.used.sum(axis=1)[:, None]
        return bias_rows(self.ones, growing, self.relative, mean)


def stack_of_one(
    observation: LinearMeasurement,
    used: NDArray[np.intp],
    about: tuple[Array, Array],
    compressed: tuple[BinNoise, Array, Array],
    grid: Grid,
) -> Stack:
    """Return a measurement as a stack.

    Args:
        observation: The measurement.
        used: Positions of its m usable values.
        about: These about the estimator's reference current, shape (m, c) [m/s], and the components of the local axes, shape (c, 2).
        compressed: Their noise, Q and R; an R of one makes the measurement's own rows the unknowns of its column.
        grid: The region.
    """
    own, components = about
    is_used = np.zeros((1, len(observation.value)), np.bool_)
    is_used[0, used] = True
    values = np.zeros((*is_used.shape, len(components)))
    values[0, used] = own
    return Stack(
        (observation,),
        is_used,
        values,
        components,
        relative_velocities([observation], is_used, grid),
        (layout_of(observation, used, *compressed),),
        np.zeros(1, np.intp),
    )


def stacked(
    observations: Sequence[LinearMeasurement],
    used: NDArray[np.bool_],
    values: Array,
    relative: Array | None,
    factors: Factors,
) -> Stack:
    """Return measurements as arrays.

    Args:
        observations: As many values in each.
        used: As of ``Stack``, as are the next two.
        values: What they are where not used does not matter.
        relative: See there.
        factors: Returns the noise, Q and R of a measurement's used values.
    """
    known: dict[bytes, int] = {}
    layouts: list[Layout] = []
    depth, error_std, common_std = (
        np.array([getattr(each, name) for each in observations])
        for name in ("depth", "error_std", "common_std")
    )
    rows = np.column_stack([depth, error_std, common_std, used])
    which = np.zeros(len(rows), np.intp)
    # they are all alike of an instrument that stays at one depth
    if not (rows == rows[0]).all():
        which[:] = [known.setdefault(row.tobytes(), len(known)) for row in rows]
    for first in np.unique(which, return_index=True)[1].tolist():
        at = np.flatnonzero(used[first])
        layouts.append(layout_of(observations[first], at, *factors(observations[first], at)))
    return Stack(
        tuple(observations),
        used,
        np.where(used[..., None], values, 0.0),
        BOTH_COMPONENTS,
        relative,
        tuple(layouts),
        which,
    )
