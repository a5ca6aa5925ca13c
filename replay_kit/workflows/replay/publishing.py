"""Publishing stage: outputs of each step, and due times of depth slices.

At each time of radar total vectors the surface current is published: the estimate plus a field of the residuals of the vectors. The
maximum-likelihood covariance of the field is fitted to the first two times, until then to the first.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from replay_kit.config.run import OutputConfig
from replay_kit.core.arrays import Array, replace
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.local import SurfaceCurrent
from replay_kit.core.flow.points import known_at
from replay_kit.core.geodesy import rotate_to_local, to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import LinearMeasurement, VehicleState
from replay_kit.measurements.surface.residual_field import ResidualField
from replay_kit.results.mcap.writer import ResultWriter
from replay_kit.results.slices import Slices
from replay_kit.workflows.replay.steps import Step

# times that say what the covariance is, and vectors that a time has at least to be one
_TIMES, _LEAST_VECTORS = 2, 20
# cells of a grid at most; each is half as wide as vectors are apart
_MOST_CELLS = 1600
# A vehicle that moved less keeps its frame [m], and one that moved less from place to place its heading.
_MOVED = 10.0
_Place = tuple[float, float, float]

#: Writes what is published to a result.
Output = Callable[[ResultWriter], None]
#: Returns the estimate for a time [ns, UTC].
FlowAt = Callable[[int], FlowEstimate]


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceState:
    """State of the field of surface residuals.

    Attributes:
        seen: Vectors of the first times and their residuals, shape (n, 2) [m/s]; empty once all have arrived.
        field: Field model of the residuals; None before any.
        last: Field of the last time and its frame; None before any.
    """

    seen: tuple[tuple[LinearMeasurement, Array], ...] = ()
    field: ResidualField | None = None
    last: tuple[Projection, SurfaceCurrent] | None = None

    def added(self, flow: FlowEstimate) -> FlowEstimate:
        """Return an estimate with the field of the last time, if in the same frame."""
        projection, last = self.last or (None, None)
        if last is None or projection != flow.grid.projection:
            return flow
        return replace(flow, surface=last.at(flow.time_ns or last.time_ns))

    @property
    def notes(self) -> list[str]:
        """Notes on the field for the user."""
        if self.field is None:
            return []
        size = f"{100.0 * self.field.std:.1f} cm/s over {self.field.length / 1e3:.0f} km"
        return [
            f"radars differ from the modes by a field of {size}, which the estimate at the surface includes (table surface)"
        ]


@dataclass(frozen=True, slots=True)
class PublishingState:
    """State of the publishing stage.

    Attributes:
        projection: Local frame; None before the first position.
        turned: Local east and north [m] of the last heading, and the heading, clockwise from local north [rad].
        placed: Local east, north and depth [m] of the frame last published.
        surface: State of the radar residuals.
    """

    projection: Projection | None = None
    turned: _Place | None = None
    placed: _Place | None = None
    surface: SurfaceState = field(default_factory=SurfaceState)


def publish_surface(
    writer: ResultWriter, state: PublishingState, step: Step, flow_at: FlowAt
) -> PublishingState:
    """Write the surface current by the vectors of a radar, if a step assimilated such, and return the state after it.

    Args:
        writer: Writer of the result.
        state: State before it.
        step: The step.
        flow_at: Function of the estimate after it at a time [ns, UTC].
    """
    event = step.event
    vectors = event.label.vectors if isinstance(event, LinearMeasurement) else None
    if step.innovation is None or not vectors:
        return state
    surface, found = surface_step(state.surface, vectors, flow_at(event.time_ns))
    if found:
        writer.surface(event.time_ns, found)
    return replace(state, surface=surface)


def publish_track(
    writer: ResultWriter,
    state: PublishingState,
    track: Iterable[VehicleState],
    flow_at: FlowAt,
) -> PublishingState:
    """Write consecutive positions and the vehicle's frame, oriented along its track; return the state after them."""
    track = list(track)
    projection = state.projection or flow_at(track[0].time_ns).grid.projection
    degrees = np.array([(each.longitude, each.latitude) for each in track])
    local = (each.tolist() for each in to_local(projection, *degrees.T))
    turned, placed = state.turned, state.placed
    for position, east, north in zip(track, *local, strict=True):
        turned, place = turned or (east, north, 0.0), (east, north, depth_of(position))
        moved = east - turned[0], north - turned[1]
        if math.hypot(*moved) > _MOVED:
            turned = east, north, math.atan2(*moved)
        writer.fix(position)
        if placed is None or math.dist(placed, place) > _MOVED:
            placed = place
            writer.vehicle(position.time_ns, place, turned[2])
    return replace(state, projection=projection, turned=turned, placed=placed)


def depth_slices(time_ns: int, flow: FlowEstimate, settings: OutputConfig) -> Output:
    """Return a flow at some depths as output, followed by a digest of the messages so far.

    The depths are those of the settings, or the first, middle and last level.
    """
    levels = flow.levels.tolist()
    usual = dict.fromkeys((levels[0], levels[len(levels) // 2], levels[-1]))

    def write(writer: ResultWriter) -> None:
        writer.grids(time_ns, flow, settings.depths or tuple(usual))
        writer.digest(time_ns)

    return write


def depth_of(position: VehicleState) -> float:
    """Return the depth of a position [m]; that of the surface if it is unknown."""
    return max(float(position.depth), 0.0) if math.isfinite(position.depth) else 0.0


def surface_step(
    state: SurfaceState, vectors: LinearMeasurement, flow: FlowEstimate
) -> tuple[SurfaceState, Slices | None]:
    """Return the state after vectors of one time, and the surface current on a grid around them; None for too few in water.

    Args:
        state: State before.
        vectors: Total vectors at one depth.
        flow: Estimate after.
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
        state = replace(state, seen=times if len(times) < _TIMES else (), field=field)
    east, north = _grid(np.column_stack(local))
    x, y = (each.ravel() for each in np.meshgrid(east, north))
    beside, error = field.between(vectors, residual, *to_geographic(projection, x, y))
    velocity = _estimated(flow, vectors.time_ns, x, y, depth) + beside
    shape = north.size, east.size
    known = np.where(np.isfinite(velocity), error[:, None], np.nan)
    fields = np.column_stack([velocity, known]).T.reshape(4, *shape)
    last = SurfaceCurrent(
        east,
        north,
        beside.reshape(*shape, 2),
        error.reshape(shape),
        field.std,
        max(depth, float(flow.levels[0])),
        vectors.time_ns,
    )
    shown = Slices(np.array([depth]), east, north, fields[None])
    return replace(state, last=(projection, last)), shown


def _estimated(flow: FlowEstimate, time_ns: int, east: Array, north: Array, depth: float) -> Array:
    """Return the estimate with its oscillations at local places [m], shape (n, 2) [m/s], local axes; NaN outside it."""
    known = known_at(flow.grid, east, north, depth)
    velocity = np.where(known[:, None], flow.velocity(east, north, depth), np.nan)
    beside = flow.oscillation
    if beside is not None:
        velocity += [np.interp(depth, flow.levels, each) for each in beside.velocity(time_ns)]
    return velocity


def _grid(places: Array) -> tuple[Array, Array]:
    """Return the cell centres along both axes around places, shape (n, 2) [m]."""
    low, size = places.min(axis=0), np.ptp(places, axis=0)
    apart = np.hypot(*(places[:, None] - places).T)
    np.fill_diagonal(apart, np.inf)
    cell = max(0.5 * np.median(apart.min(axis=0)), np.sqrt(size.prod() / _MOST_CELLS))
    east, north = (
        begin + cell * np.arange(max(2, round(along / cell) + 1))
        for begin, along in zip(low, size, strict=True)
    )
    return east, north
