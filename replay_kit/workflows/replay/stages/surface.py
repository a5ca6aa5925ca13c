"""The surface current at each time of radars' total vectors: the estimate, with what the vectors show beside it as a field.

The field's covariance is the likeliest for the first two times, and that of the first alone until then.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.points import known_at
from replay_kit.core.geodesy import rotate_to_local, to_geographic, to_local
from replay_kit.core.observation import LinearMeasurement
from replay_kit.measurements.residual_field import ResidualField
from replay_kit.results.slices import Slice

# times that say what the covariance is, and vectors that a time has at least to be one
_TIMES, _LEAST_VECTORS = 2, 20
# cells of a grid at most; each is half as wide as vectors are apart
_MOST_CELLS = 1600


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceState:
    """What the vectors so far say of the field.

    Attributes:
        seen: The vectors of the first times, and what they are beside the estimate, shape (n, 2) [m/s]; none once all have come.
        field: Of the residuals; None before any.
    """

    seen: tuple[tuple[LinearMeasurement, Array], ...] = ()
    field: ResidualField | None = None

    @property
    def notes(self) -> list[str]:
        """What the user should know of the field."""
        if self.field is None:
            return []
        size = f"{100.0 * self.field.std:.1f} cm/s over {self.field.length / 1e3:.0f} km"
        return [
            f"radars show currents beside the estimate, a field of {size}: table surface has both"
        ]


def surface_step(
    state: SurfaceState, vectors: LinearMeasurement, flow: FlowEstimate
) -> tuple[SurfaceState, Slice | None]:
    """Return the state after the vectors of a time, and the surface current on a grid over them; None where too few are in the water.

    Args:
        state: Before them.
        vectors: Total vectors at one depth.
        flow: The estimate after them.
    """
    projection, depth = flow.grid.projection, float(vectors.depth[0])
    places = vectors.value_places
    seen = np.column_stack(rotate_to_local(projection, *places, *vectors.value.T))
    local = to_local(projection, *places)
    residual = seen - _estimated(flow, vectors.time_ns, *local, depth)
    if np.isfinite(residual).all(axis=1).sum() < _LEAST_VECTORS:
        return state, None
    field = state.field
    if field is None or state.seen:
        times = (*state.seen, (vectors, residual))
        field = ResidualField.likeliest(times)
        state = SurfaceState(times if len(times) < _TIMES else (), field)
    east, north = _grid(np.column_stack(local))
    x, y = (each.ravel() for each in np.meshgrid(east, north))
    beside, error = field.between(vectors, residual, *to_geographic(projection, x, y))
    velocity = _estimated(flow, vectors.time_ns, x, y, depth) + beside
    shape = (north.size, east.size, 2)
    known = np.where(np.isfinite(velocity), error[:, None], np.nan)
    return state, Slice(depth, east, north, velocity.reshape(shape), known.reshape(shape))


def _estimated(flow: FlowEstimate, time_ns: int, east: Array, north: Array, depth: float) -> Array:
    """Return the estimate with its oscillations at local places [m], shape (n, 2) [m/s], local axes; NaN where it has none."""
    known = known_at(flow.grid, east, north, depth)
    velocity = np.where(known[:, None], flow.velocity(east, north, depth), np.nan)
    beside = flow.oscillation
    if beside is not None:
        velocity += [np.interp(depth, flow.levels, each) for each in beside.velocity(time_ns)]
    return velocity


def _grid(places: Array) -> tuple[Array, Array]:
    """Return cell centres along both axes over places, shape (n, 2) [m]."""
    low, size = places.min(axis=0), np.ptp(places, axis=0)
    apart = np.hypot(*(places[:, None] - places).T)
    np.fill_diagonal(apart, np.inf)
    cell = max(0.5 * np.median(apart.min(axis=0)), np.sqrt(size.prod() / _MOST_CELLS))
    east, north = (
        begin + cell * np.arange(max(2, round(along / cell) + 1))
        for begin, along in zip(low, size, strict=True)
    )
    return east, north
