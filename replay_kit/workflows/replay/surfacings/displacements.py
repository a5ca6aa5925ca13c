"""Predicted surfacings for a log without DACs, from the displacements between fixes of earlier dives.

A dive's mean velocity over ground is the sum of its velocity through the water and the current, which no flight model separates here. The
estimate predicts the current before the dive, halfway along a dive like the last one. The remainder of earlier dives is their velocity
through the water, assumed to persist unless the pilot steers elsewhere. Outside the estimate's region the velocity over ground persists
instead.

A dive is concluded when the next one begins, as its DAC may be logged until then.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.as_flown import FlownDive, flown_dive
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, Profiles, VehicleState
from replay_kit.core.surfacing import Basis, DiveForecast, DiveOutcome, forecast_place
from replay_kit.estimator.next_dive.process import FIXES_STD, DiveMean, MeanCurrentProcess
from replay_kit.measurements.means import Path, Spot, begun, extended, path_mean
from replay_kit.measurements.track.surfacings import SurfacingState, detect_surfacing
from replay_kit.workflows.replay.events import Track
from replay_kit.workflows.replay.surfacings.outcomes import Before

_NO_DEPTH = np.empty(0)
_NOWHERE = {
    "time": np.empty(0, np.int64),
    "longitude": _NO_DEPTH,
    "latitude": _NO_DEPTH,
    "depth": _NO_DEPTH,
}
_PROCESS = MeanCurrentProcess(n_backgrounds=1)
#: Returns the estimate for a time [ns, UTC].
FlowAt = Callable[[int], FlowEstimate]


@dataclass(frozen=True, slots=True, eq=False)
class Ahead:
    """Predicted current of the next dive.

    Attributes:
        depth: shape (Z,) [m], increasing levels.
        velocity: shape (Z, 2) [m/s], true east and north.
    """

    depth: Array
    velocity: Array

    def mean(self, depth: Array, weight: Array) -> Array:
        """Return the mean current over depths, shape (2,) [m/s]; constant beyond the levels.

        Args:
            depth: shape (m,) [m].
            weight: shape (m,), sums to one.
        """
        return np.array(
            [weight @ np.interp(depth, self.depth, component) for component in self.velocity.T]
        )


@dataclass(frozen=True, slots=True, eq=False)
class LastDive:
    """Last dive of a vehicle.

    Attributes:
        mean: The dive in the form of the model.
        depth: shape (m,) [m], along its path.
        weight: shape (m,), fraction of time around each depth; sums to one.
        number: Number of the dive.
        basis: Basis of its prediction.
        flown: Flight through the water; None if the estimate does not cover it.
    """

    mean: DiveMean
    depth: Array
    weight: Array
    number: int
    basis: Basis
    flown: FlownDive | None = None


@dataclass(frozen=True, slots=True, eq=False)
class GroundState:
    """State of the predictions from displacements.

    Attributes:
        before: Knowledge before the next dive.
        detection: Detection of surfacings.
        latest: Last fix at the surface; None before the first.
        path: Path since the fix before the dive; None at the surface.
        ahead: Current predicted before the dive; None outside the estimate.
        surfaced: Path of a dive, its last fix and its number, 0 if unknown, until all observations of that time have arrived.
        last: Last dive; None before the first.
        concluded: Outcome of the last dive, until the next one begins.
    """

    before: Before = field(default_factory=lambda: Before(_PROCESS))
    detection: SurfacingState = field(default_factory=SurfacingState)
    latest: VehicleState | None = None
    path: Path | None = None
    ahead: Ahead | None = None
    surfaced: tuple[Path, VehicleState, int] | None = None
    last: LastDive | None = None
    concluded: DiveOutcome | None = None


def ground_step(
    state: GroundState,
    event: Any,
    flow_at: FlowAt,
    surface_depth: float,
) -> tuple[GroundState, tuple[DiveOutcome, ...]]:
    """Return the state after an event, and the outcome of the last dive when the next one begins.

    Args:
        state: State before it.
        event: Position or observation, in log order.
        flow_at: Estimate before the event.
        surface_depth: Depth above which the vehicle is at the surface [m].
    """
    if not isinstance(event, VehicleState | Profiles):
        return state, ()
    first_ns = int(event["time"][0]) if isinstance(event, Profiles) else event.time_ns
    if state.surfaced is not None and first_ns > state.surfaced[1].time_ns:
        state = concluded(state)
    detection, end = detect_surfacing(state.detection, event, surface_depth)
    begins = _in_dive(detection) and (end is not None or not _in_dive(state.detection))
    if end is not None:
        # a dive's profiles may have waited for the fix after it
        number = detection.dive if first_ns <= end.time_ns else state.detection.dive
        surfaced = (
            None
            if state.path is None or end.time_ns <= state.path.start.time
            else (state.path, end, number)
        )
        state = replace(state, path=None, surfaced=surfaced)
    outcomes: tuple[DiveOutcome, ...] = ()
    if begins:
        state = concluded(state)
        outcomes = () if state.concluded is None else (state.concluded,)
        state = _begun(state, flow_at)
    latest, path = _moved(state, event, surface_depth)
    return replace(state, detection=detection, latest=latest, path=path), outcomes


def adrift(state: GroundState, track: Track, surface_depth: float) -> GroundState | None:
    """Return the state after fixes at the surface between dives, see ``ground_step``; None for other events."""
    below = track.columns["dead_reckoned"].any() or (track.columns["depth"] > surface_depth).any()
    if below or state.surfaced is not None or _in_dive(state.detection):
        return None
    return replace(state, detection=replace(state.detection, fix=track[-1]), latest=track[-1])


def concluded(state: GroundState) -> GroundState:
    """Return the state after the last dive, if ended, with its outcome and the updated model."""
    if state.surfaced is None:
        return state
    path, end, number = state.surfaced
    mean = path_mean(path, _spot(end), (0.0, 0.0), 0.0)
    depth, weight = mean["path_depth"], mean["weight"]
    start, fix = (Fix(at.time, at.longitude, at.latitude) for at in (path.start, _spot(end)))
    seconds, velocity = over_ground(start, fix)
    current = _current(state, depth, weight)
    dive = DiveMean(
        time_ns=(start.time_ns + fix.time_ns) // 2,
        seconds=seconds,
        way=np.zeros(2),
        velocity=velocity,
        backgrounds=current[None],
        position_std=FIXES_STD,
    )
    basis = _basis(state)
    flown = (
        flown_dive(seconds, velocity - current, depth, path.deepest)
        if state.ahead is not None
        else None
    )
    number = number or state.before.known.dives + 1
    before, outcome = state.before.after(dive, (start, fix), number, basis)
    return replace(
        state,
        before=before,
        surfaced=None,
        ahead=None,
        last=LastDive(dive, depth, weight, number, basis, flown),
        concluded=outcome,
    )


def over_ground(start: Fix, end: Fix) -> tuple[float, Array]:
    """Return the time between two fixes [s], and the mean velocity, shape (2,) [m/s]."""
    seconds = (end.time_ns - start.time_ns) * 1e-9
    frame = Projection(start.longitude, start.latitude)
    return seconds, np.array(to_local(frame, end.longitude, end.latitude)) / seconds


def next_ground_surfacing(
    state: GroundState, flow: FlowEstimate, longer: float = 1.0
) -> DiveForecast | None:
    """Return the predicted next surfacing after a dive like the last one; None before the first dive.

    Args:
        state: State after all dives.
        flow: Estimate.
        longer: Duration and depth relative to the last dive.
    """
    if state.last is None or state.latest is None:
        return None
    last, fix = state.last, state.latest
    state = replace(state, ahead=_ahead(state, flow))
    current, seconds = _current(state, longer * last.depth, last.weight), longer * last.mean.seconds
    coming = replace(
        last.mean,
        time_ns=fix.time_ns + int(0.5e9 * seconds),
        seconds=seconds,
        backgrounds=current[None],
    )
    return state.before.forecast(
        coming, Fix(fix.time_ns, fix.longitude, fix.latitude), last.number + 1, _basis(state)
    )


def _row(position: VehicleState) -> Iterator[tuple[str, float]]:
    spot = _spot(position)
    yield from zip(_NOWHERE, (spot.time, spot.longitude, spot.latitude, spot.depth), strict=True)


def _spot(position: VehicleState) -> Spot:
    return Spot(position.time_ns, position.longitude, position.latitude, position.depth)


def _in_dive(detection: SurfacingState) -> bool:
    return detection.submerged or not detection.reported


def _begun(state: GroundState, flow_at: FlowAt) -> GroundState:
    """Return the state at the beginning of a dive from the last fix."""
    state = replace(state, concluded=None, path=None)
    if (fix := state.latest) is None:
        return state
    return replace(state, path=begun(_spot(fix)), ahead=_ahead(state, flow_at(fix.time_ns)))


def _moved(
    state: GroundState, event: VehicleState | Profiles, surface_depth: float
) -> tuple[VehicleState | None, Path | None]:
    """Return fix and path after a position, or after the depth of a profile's first bin if positions have none."""
    latest, path = state.latest, state.path
    if isinstance(event, Profiles):
        if path is not None and not path.reckoned:
            known = event["depth"][0][np.isfinite(event["depth"][0])]
            path = extended(path, _NOWHERE, known.min(keepdims=True)) if known.size else path
    elif not event.dead_reckoned and not event.depth > surface_depth:
        latest = event
    elif path is not None:
        path = extended(path, {name: np.array([part]) for name, part in _row(event)}, _NO_DEPTH)
    return latest, path


def _ahead(state: GroundState, flow: FlowEstimate) -> Ahead | None:
    """Return the current predicted halfway along a dive like the last one from the last fix; None outside the estimate."""
    assert state.latest is not None
    place = state.latest.longitude, state.latest.latitude
    if state.last is not None:
        place = forecast_place(
            Fix(0, *place), 0.5 * state.last.mean.seconds, state.last.mean.velocity
        )
    east, north = to_local(flow.grid.projection, *place)
    if not inside_grid(flow.grid, east, north):
        return None
    return Ahead(flow.levels, flow.velocity(east, north, flow.levels, true_axes=True))


def _current(state: GroundState, depth: Array, weight: Array) -> Array:
    """Return the predicted mean current over depths, shape (2,) [m/s].

    Outside the estimate it is the current of the last dive, or NaN before the first.
    """
    if state.ahead is not None:
        return state.ahead.mean(depth, weight)
    return np.full(2, np.nan) if state.last is None else np.asarray(state.last.mean.backgrounds[0])


def _basis(state: GroundState) -> Basis:
    return "displacements" if state.ahead is None else "estimate"
