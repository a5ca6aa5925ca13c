"""What the measurement step remembers from one message to the next, and what positions, depths and attitudes change in it.

A position completes the pings that waited for it, and the mean current that it ends.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import replace
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Source, VehicleState
from replay_kit.measurements.events import Event, Skipped, Used
from replay_kit.measurements.messages.mavlink import (
    GpsStatus,
    Key,
    LocalOrigin,
    NavigationPosition,
    PingFrame,
    is_dead_reckoned,
)
from replay_kit.measurements.messages.vehicle import Depth, Pose, Position, Pressure, checked
from replay_kit.measurements.messages.water import DrifterFix
from replay_kit.measurements.ping.adcp_ping import Orientation, PlatformVelocity
from replay_kit.measurements.steps.position_matching import PlacedPing, WaitingPing, place, ready
from replay_kit.measurements.vehicle.dead_reckoning import Fixes, append_fix
from replay_kit.measurements.vehicle.dives import depth_of_pressure, is_submerged
from replay_kit.measurements.vehicle.mean_current import Dives, MeanCurrent, stated_mean
from replay_kit.measurements.vehicle.mean_current import record_depth as record_depth_of_dive
from replay_kit.measurements.vehicle.mean_current import record_position as record_place_of_dive

if TYPE_CHECKING:
    from replay_kit.measurements.section.lines import SectionLine


@dataclass(frozen=True, slots=True)
class MeasurementState:
    """What the step remembers.

    Attributes:
        fix: Last position known.
        depth: Last depth known [m]; NaN before the first.
        dive: Dives begun so far.
        submerged: Whether the vehicle is in a dive.
        origins: By topic of poses, its first pose since the last measured fix, and the position known then.
        waiting: Pings that wait for a position, in the order of their times.
        orientation: Last one of a message that is no ping, after its time [ns, UTC].
        frames: Frames by name of MAVLink pings that are not complete yet.
        gps_fix_ns: Time of the last three-dimensional fix of each MAVLink system's GPS [ns, UTC]; None while it had none.
        dives: The way since the last fixes, for mean currents; None where these are not wanted.
        bottom: Last velocity over the ground by a DVL, after its time [ns, UTC].
        track: Latest fixes at the surface.
        line: Of the CTD; None before its first sample.
        drifters: By name, the fix of each drifter from which its displacement is counted.
        sender: Numbers of the MAVLink system and component whose position and depth count: those asked for, or the first that state a
            position.
        local_origins: Longitude and latitude of the origins of local frames [degrees], by MAVLink system.
        navigated: The MAVLink systems that have stated a position on the Earth.
    """

    fix: VehicleState | None = None
    depth: float = float("nan")
    dive: int = 0
    submerged: bool = False
    origins: Mapping[str, tuple[VehicleState, Pose]] = field(default_factory=dict)
    waiting: tuple[WaitingPing, ...] = ()
    orientation: tuple[int, Orientation] | None = None
    frames: Mapping[Key, Mapping[str, PingFrame]] = field(default_factory=dict)
    gps_fix_ns: Mapping[str, int | None] = field(default_factory=dict)
    dives: Dives | None = field(default_factory=Dives)
    bottom: tuple[int, PlatformVelocity] | None = None
    track: Fixes = ()
    sender: tuple[str | None, str | None] = (None, None)
    local_origins: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    navigated: frozenset[str] = frozenset()
    line: "SectionLine | None" = None
    drifters: Mapping[str, tuple[Source, DrifterFix]] = field(default_factory=dict)

    @property
    def latitude(self) -> float | None:
        """Of the last position known [degrees north]; None before the first."""
        return None if self.fix is None else self.fix.latitude


#: The state after a message, and the events that it completes, among them pings that are still to be tested.
Step = tuple[MeasurementState, list[Event | PlacedPing]]


def at_depth(state: MeasurementState, depth: float, config: MeasurementConfig) -> MeasurementState:
    """Return the state with a depth noted; see ``is_submerged`` for where dives begin and end."""
    submerged, dives = (
        is_submerged(depth, config.surface_depth, state.submerged),
        state.dives and record_depth_of_dive(state.dives, depth),
    )
    if depth == state.depth and submerged == state.submerged and dives is state.dives:
        return state
    begun = submerged and not state.submerged
    return replace(state, depth=depth, submerged=submerged, dive=state.dive + begun, dives=dives)


_NO_ORIGIN = "local position without an origin: state it with --origin LON,LAT"
_NAVIGATED = "local position beside the system's position on the Earth, which is used"
_ATTITUDE = "attitude: kept for pings without their own"


def record_position(
    state: MeasurementState, position: Position, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a position, and with it the pings that waited for it and the mean current that it ends."""
    if math.isfinite(position.depth):
        state = at_depth(state, position.depth, config)
    fix = VehicleState(
        source.time_ns,
        position.longitude,
        position.latitude,
        state.depth,
        position.dead_reckoned,
        source,
    )
    track = state.track if fix.dead_reckoned or state.submerged else append_fix(state.track, fix)
    origins = state.origins if fix.dead_reckoned else {}
    released, left = ready(state.waiting, fix.time_ns)
    events = [event for ping in released for event in place(ping, state.fix, fix, track, config)]
    if (dives := state.dives) is not None:
        dives, means = record_place_of_dive(dives, fix, state.submerged, state.dive, config)
        events += means
    return replace(state, fix=fix, waiting=left, dives=dives, track=track, origins=origins), [
        Used(source.topic),
        fix,
        *events,
    ]


def record_gps_status(
    state: MeasurementState, status: GpsStatus, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after what a MAVLink system's GPS says of its fix: whether later positions of the system are measured."""
    del config
    known = state.gps_fix_ns.get(status.system)
    state = replace(
        state,
        gps_fix_ns={**state.gps_fix_ns, status.system: known if status.no_fix else source.time_ns},
    )
    return state, [Skipped(source.topic, status.no_fix) if status.no_fix else Used(source.topic)]


def record_navigation(
    state: MeasurementState, stated: NavigationPosition, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a position by a MAVLink system's filter, which goes on when GPS is lost: it is then dead-reckoned."""
    dead_reckoned = is_dead_reckoned(state.gps_fix_ns, stated.system, source.time_ns)
    if stated.system not in state.navigated:
        state = replace(state, navigated=state.navigated | {stated.system})
    return record_position(
        state, replace(stated.position, dead_reckoned=dead_reckoned), source, config
    )


def record_origin(
    state: MeasurementState, stated: LocalOrigin, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after the origin of a MAVLink system's local frame."""
    del config
    origin = stated.longitude, stated.latitude
    if state.local_origins.get(stated.system) != origin:
        origins = {**state.local_origins, stated.system: origin}
        state = replace(state, local_origins=origins)
    return state, [Used(source.topic)]


def record_pose(
    state: MeasurementState, pose: Pose, source: Source, config: MeasurementConfig
) -> Step:
    """Place a pose relative to the position known when its topic's first pose since the last measured fix came, or to a stated origin."""
    if pose.orientation is not None:
        state = replace(state, orientation=(source.time_ns, pose.orientation))
    if pose.system and pose.system in state.navigated:
        return state, [Skipped(source.topic, _NAVIGATED)]
    if source.topic not in state.origins:
        fix, first = None if pose.system else state.fix, pose
        stated = config.origin or state.local_origins.get(pose.system)
        if fix is None and stated is not None:
            fix = VehicleState(source.time_ns, *stated, 0.0, True, source)
            first = replace(pose, east=0.0, north=0.0)
        if fix is None:
            said = Skipped(source.topic, _NO_ORIGIN) if pose.system else Used(source.topic)
            return at_depth(state, pose.depth, config), [said]
        state = replace(state, origins={**state.origins, source.topic: (fix, first)})
    fix, origin = state.origins[source.topic]
    longitude, latitude = to_geographic(
        Projection(fix.longitude, fix.latitude), pose.east - origin.east, pose.north - origin.north
    )
    position = checked(longitude, latitude, pose.depth, True)
    return (
        (state, [Skipped(source.topic, position)])
        if isinstance(position, str)
        else record_position(state, position, source, config)
    )


def record_orientation(
    state: MeasurementState, orientation: Orientation, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state with an orientation for the pings after it."""
    del config
    return replace(state, orientation=(source.time_ns, orientation)), [
        Skipped(source.topic, _ATTITUDE)
    ]


def record_depth(
    state: MeasurementState, stated: Depth, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a depth."""
    if not math.isfinite(stated.depth):
        return state, [Skipped(source.topic, "depth is not a number")]
    return at_depth(state, stated.depth, config), [Used(source.topic)]


def record_pressure(
    state: MeasurementState, stated: Pressure, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a pressure, at the depth that it has at the last latitude."""
    depth = depth_of_pressure(stated.pressure_dbar, state.latitude)
    if not math.isfinite(depth):
        return state, [Skipped(source.topic, "pressure is not a number")]
    return at_depth(state, depth, config), [Used(source.topic)]


def record_mean_current(
    state: MeasurementState, stated: MeanCurrent, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a stated mean current, and the current with its path."""
    dive = state.dive if stated.dive is None else stated.dive
    if state.dives is None:
        return state, [Used(source.topic)]
    dives, mean = stated_mean(state.dives, stated, dive, source, config)
    events: list[Event | PlacedPing] = (
        [Skipped(source.topic, mean)] if isinstance(mean, str) else [Used(source.topic), mean]
    )
    return replace(state, dives=dives), events
