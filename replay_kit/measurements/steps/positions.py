"""Positions, depths and attitudes of the vehicle: what they change, and the pings and mean currents that a position completes."""

from dataclasses import replace

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Source, VehicleState
from replay_kit.measurements.current import mean as currents
from replay_kit.measurements.current.mean import MeanCurrent
from replay_kit.measurements.events import Event, Skipped, Used
from replay_kit.measurements.messages.mavlink_vehicle import (
    GpsStatus,
    NavigationPosition,
    is_dead_reckoned,
)
from replay_kit.measurements.messages.position import Depth, Pose, Position, Pressure, checked
from replay_kit.measurements.ping.attitude import Orientation
from replay_kit.measurements.steps.position_matching import PlacedPing, place, ready
from replay_kit.measurements.steps.state import MeasurementState, Step, at_depth
from replay_kit.measurements.vehicle.pressure import depth_of_pressure
from replay_kit.measurements.vehicle.vessel_velocity import append_fix

_ATTITUDE = "attitude: kept for pings that do not state theirs"


def record_position(
    state: MeasurementState, position: Position, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a position, and with it the pings that waited for it and the mean current that it ends."""
    if np.isfinite(position.depth):
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
    dives, means = currents.record_position(state.dives, fix, state.submerged, state.dive, config)
    return replace(state, fix=fix, waiting=left, dives=dives, track=track, origins=origins), [
        Used(source.topic),
        fix,
        *events,
        *means,
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
    return record_position(
        state, replace(stated.position, dead_reckoned=dead_reckoned), source, config
    )


def record_pose(
    state: MeasurementState, pose: Pose, source: Source, config: MeasurementConfig
) -> Step:
    """Place a pose relative to the position known when its topic's first pose since the last measured fix came."""
    state = replace(state, orientation=(source.time_ns, pose.orientation))
    if source.topic not in state.origins:
        if state.fix is None:
            return at_depth(state, pose.depth, config), [Used(source.topic)]
        state = replace(state, origins={**state.origins, source.topic: (state.fix, pose)})
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
    if not np.isfinite(stated.depth):
        return state, [Skipped(source.topic, "depth is not a number")]
    return at_depth(state, stated.depth, config), [Used(source.topic)]


def record_pressure(
    state: MeasurementState, stated: Pressure, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a pressure, at the depth that it has at the last latitude."""
    depth = depth_of_pressure(stated.pressure_dbar, state.latitude)
    if not np.isfinite(depth):
        return state, [Skipped(source.topic, "pressure is not a number")]
    return at_depth(state, depth, config), [Used(source.topic)]


def record_mean_current(
    state: MeasurementState, stated: MeanCurrent, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a stated mean current, and the current with its path."""
    dive = state.dive if stated.dive is None else stated.dive
    dives, mean = currents.stated_mean(state.dives, stated, dive, source, config)
    events: list[Event | PlacedPing] = (
        [Skipped(source.topic, mean)] if isinstance(mean, str) else [Used(source.topic), mean]
    )
    return replace(state, dives=dives), events
