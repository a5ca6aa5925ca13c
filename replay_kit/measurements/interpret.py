"""The measurement step: state in, message in; state, and what the message meant, out.

A ping waits until a position at or after its own time is known, then takes the position interpolated between its neighbours.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from replay_kit.config import MeasurementConfig
from replay_kit.errors import MeasurementError
from replay_kit.geodesy import to_geographic, to_local, unwrap_longitude
from replay_kit.measurements import mavlink_ping, vehicle
from replay_kit.measurements.adcp import number, read_profile, why_not_used
from replay_kit.types import Message, Observation, Projection, Source, VehicleState

PING_SCHEMA = "replay_kit.AdcpPing"
# What a MAVLink reader needs to decode for this module.
MAVLINK_NAMES = frozenset({"GLOBAL_POSITION_INT", mavlink_ping.SCHEMA})
_POSITION_SCHEMAS = MappingProxyType(
    {
        "foxglove.LocationFix": vehicle.location_fix,
        "sensor_msgs/msg/NavSatFix": vehicle.nav_sat_fix,
        "sensor_msgs/NavSatFix": vehicle.nav_sat_fix,
        "GLOBAL_POSITION_INT": vehicle.global_position_int,
    }
)
_PRESSURE_SCHEMAS = ("sensor_msgs/msg/FluidPressure", "sensor_msgs/FluidPressure")
_ODOMETRY_SCHEMAS = ("nav_msgs/msg/Odometry", "nav_msgs/Odometry")
# Frames of a ping follow one another at once; when this many pings stand open the oldest has lost a frame.
_OPEN_PINGS = 8


@dataclass(frozen=True, slots=True)
class Used:
    """A message was understood and used.

    Attributes:
        topic: Its topic.
    """

    topic: str


@dataclass(frozen=True, slots=True)
class Skipped:
    """A message was not used.

    Attributes:
        topic: Its topic.
        reason: Why, in a few words that are the same for all such messages.
    """

    topic: str
    reason: str


Event = VehicleState | Observation | Used | Skipped


@dataclass(frozen=True, slots=True)
class MeasurementState:
    """What the step remembers.

    Attributes:
        fix: Last position known.
        depth: Last depth known [m], with its time [ns]; NaN before the first.
        depth_time_ns: Time of ``depth``.
        dive: Dives begun so far.
        submerged: Whether the vehicle is in a dive.
        odometry_origin: Odometry's east and north [m] at its first message after a measured fix, with that fix.
        waiting: Pings that wait for a position, oldest first.
        frames: Frames of MAVLink pings that are not complete yet.
    """

    fix: VehicleState | None = None
    depth: float = float("nan")
    depth_time_ns: int = 0
    dive: int = 0
    submerged: bool = False
    odometry_origin: tuple[VehicleState, float, float] | None = None
    waiting: tuple[tuple[Message, float, int], ...] = ()
    frames: tuple[tuple[mavlink_ping.Key, dict[str, Message]], ...] = ()


def initial_state() -> MeasurementState:
    """Return the state before the first message."""
    return MeasurementState()


def observations(messages: Iterable[Message], config: MeasurementConfig | None = None) -> Iterator[Observation]:
    """Yield the observations in a stream of messages: what a post-mission script loops over."""
    config = config or MeasurementConfig()
    state = initial_state()
    for message in messages:
        state, events = interpret(state, message, config)
        yield from (event for event in events if isinstance(event, Observation))
    yield from (event for event in finish(state, config) if isinstance(event, Observation))


def interpret(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Return the state after a message and the events it completes.

    Each message gives exactly one ``Used`` or ``Skipped``, at once or, for a ping, when its position is known.
    """
    if state.waiting and message.time_ns - state.waiting[0][0].time_ns > config.position_max_age * 1e9:
        # no position will come that is near enough: do not let pings pile up
        (ping, depth, dive), *rest = state.waiting
        state, events = interpret(replace(state, waiting=tuple(rest)), message, config)
        return state, [*_observe(ping, depth, dive, state.fix, None, config), *events]
    if message.schema == PING_SCHEMA:
        return _ping(state, message, config)
    if mavlink_ping.is_ping_frame(message):
        return _ping_frame(state, message, config)
    if message.schema in _POSITION_SCHEMAS:
        position = _POSITION_SCHEMAS[message.schema](message.payload)
        return (state, [Skipped(message.topic, position)]) if isinstance(position, str) else _position(state, message, position, config)
    if message.schema in _ODOMETRY_SCHEMAS:
        return _odometry(state, message, config)
    if message.schema in _PRESSURE_SCHEMAS:
        depth = vehicle.fluid_pressure(message.payload, state.fix.latitude if state.fix else 0.0)
        if not np.isfinite(depth):
            return state, [Skipped(message.topic, "pressure is not a number")]
        return _at_depth(state, depth, message.time_ns, config), [Used(message.topic)]
    return state, [Skipped(message.topic, "not a kind of message the estimator uses")]


def finish(state: MeasurementState, config: MeasurementConfig) -> list[Event]:
    """Return the events of what still waits when the log ends."""
    events: list[Event] = [Skipped(frame.topic, "part of an incomplete ping") for _, frames in state.frames for frame in frames.values()]
    for message, depth, dive in state.waiting:
        events += _observe(message, depth, dive, state.fix, None, config)
    return events


def _ping(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    try:
        refused = why_not_used(message.payload)
    except MeasurementError as error:
        return state, [Skipped(message.topic, str(error))]
    if refused is not None:
        return state, [Skipped(message.topic, refused[0])]
    pressure = number(message.payload.get("pressure"))
    if np.isfinite(pressure) and not np.isfinite(state.depth):
        # a log whose only depth is the ping's own pressure still has dives
        state = replace(_at_depth(state, pressure, message.time_ns, config), depth=float("nan"))
    dive = message.payload.get("dive")
    state = replace(state, waiting=(*state.waiting, (message, state.depth, dive if isinstance(dive, int) else state.dive)))
    return _release(state, None, config)


def _ping_frame(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    key, pings = mavlink_ping.frame_key(message), dict(state.frames)
    pings[key] = {**pings.get(key, {}), str(message.payload["name"]): message}
    events: list[Event] = []
    if mavlink_ping.is_complete(pings[key]):
        frames = pings.pop(key)
        state = replace(state, frames=tuple(pings.items()))
        whole = replace(message, schema=PING_SCHEMA, payload=mavlink_ping.assemble(frames))
        state, events = _ping(state, whole, config)
        events += [Used(frame.topic) for frame in list(frames.values())[1:]]
        return state, events
    if len(pings) > _OPEN_PINGS:
        oldest = pings.pop(next(iter(pings)))
        events = [Skipped(frame.topic, "part of an incomplete ping") for frame in oldest.values()]
    return replace(state, frames=tuple(pings.items())), events


def _position(
    state: MeasurementState, message: Message, position: vehicle.Position, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    if np.isfinite(position.depth):
        state = _at_depth(state, position.depth, message.time_ns, config)
    source = Source(message.input, message.topic, message.position, message.time_ns)
    fix = VehicleState(message.time_ns, position.longitude, position.latitude, state.depth, position.dead_reckoned, source)
    if not position.dead_reckoned:
        state = replace(state, odometry_origin=None)
    state, events = _release(state, fix, config)
    return replace(state, fix=fix), [Used(message.topic), fix, *events]


def _odometry(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Place an odometry pose relative to the last measured fix, where the log has one."""
    pose = vehicle.odometry(message.payload)
    if isinstance(pose, str):
        return state, [Skipped(message.topic, pose)]
    east, north, depth = pose
    if state.odometry_origin is None:
        if state.fix is None:
            return _at_depth(state, depth, message.time_ns, config), [Used(message.topic)]
        state = replace(state, odometry_origin=(state.fix, east, north))
    assert state.odometry_origin is not None
    fix, east0, north0 = state.odometry_origin
    longitude, latitude = to_geographic(Projection(fix.longitude, fix.latitude), east - east0, north - north0)
    return _position(state, message, vehicle.Position(float(longitude), float(latitude), depth, True), config)


def _at_depth(state: MeasurementState, depth: float, time_ns: int, config: MeasurementConfig) -> MeasurementState:
    """Return the state with a depth noted; a dive begins at twice the surface depth and ends above it."""
    submerged = depth > 2.0 * config.surface_depth or (state.submerged and depth > config.surface_depth)
    begun = submerged and not state.submerged
    return replace(state, depth=depth, depth_time_ns=time_ns, submerged=submerged, dive=state.dive + begun)


def _release(state: MeasurementState, after: VehicleState | None, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Turn waiting pings into observations where the position after them is known."""
    events: list[Event] = []
    left = []
    for message, depth, dive in state.waiting:
        exact = state.fix is not None and state.fix.time_ns == message.time_ns
        if exact or (after is not None and after.time_ns >= message.time_ns):
            events += _observe(message, depth, dive, state.fix, after, config)
        else:
            left.append((message, depth, dive))
    return replace(state, waiting=tuple(left)), events


def _observe(
    message: Message, depth: float, dive: int, before: VehicleState | None, after: VehicleState | None, config: MeasurementConfig
) -> list[Event]:
    place = _interpolate(message.time_ns, before, after, config.position_max_age)
    if place is None:
        return [Skipped(message.topic, f"no position within {config.position_max_age:g} s")]
    longitude, latitude = place
    try:
        # a log that never states a depth is a surface vessel's
        profile = read_profile(message.payload, depth if np.isfinite(depth) else 0.0, latitude, config.velocity_std)
    except MeasurementError as error:
        return [Skipped(message.topic, str(error))]
    source = Source(message.input, message.topic, message.position, message.time_ns)
    observation = Observation(
        message.time_ns,
        longitude,
        latitude,
        profile.depth,
        profile.velocity,
        profile.error_std,
        profile.reference,
        profile.flags,
        profile.reasons,
        dive,
        source,
    )
    return [Used(message.topic), observation]


def _interpolate(time_ns: int, before: VehicleState | None, after: VehicleState | None, max_age_s: float) -> tuple[float, float] | None:
    """Return longitude and latitude at a time, or None when neither neighbour is near enough in time."""
    known = [fix for fix in (before, after) if fix is not None]
    if not known or min(abs(fix.time_ns - time_ns) for fix in known) > max_age_s * 1e9:
        return None
    if before is None or after is None or not before.time_ns < time_ns < after.time_ns:
        nearest = min(known, key=lambda fix: abs(fix.time_ns - time_ns))
        return nearest.longitude, nearest.latitude
    projection = Projection(before.longitude, before.latitude)
    east, north = to_local(projection, after.longitude, after.latitude)
    share = (time_ns - before.time_ns) / (after.time_ns - before.time_ns)
    longitude, latitude = to_geographic(projection, share * east, share * north)
    return float(unwrap_longitude(longitude, before.longitude)), float(latitude)
