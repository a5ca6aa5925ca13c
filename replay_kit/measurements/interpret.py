"""The measurement step: state in, message in; state, and what the message meant, out.

A ping waits until a position at or after its own time is known, then takes the position interpolated between its neighbours.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.message import Message
from replay_kit.core.observation import Measurement, VehicleState
from replay_kit.measurements.current.mean import MeanCurrent, passed, stated_mean
from replay_kit.measurements.events import MALFORMED, NOT_A_KIND, Event, Skipped, Used, malformed
from replay_kit.measurements.kinds import statement
from replay_kit.measurements.mapping.mapped import mapped
from replay_kit.measurements.ping import mavlink as mavlink_ping
from replay_kit.measurements.ping.attitude import Orientation, attitude_within, with_attitude
from replay_kit.measurements.ping.foreign import Ping
from replay_kit.measurements.ping.ground import GroundVelocity, lacks_motion, sailed, with_bottom_track
from replay_kit.measurements.ping.payload import depth_of_pressure
from replay_kit.measurements.ping.pings import PING_SCHEMA, dive_of, elsewhere, placed, source_of, take_ping, twice, with_reference
from replay_kit.measurements.ping.waiting import ready, split
from replay_kit.measurements.state import MeasurementState, at_depth
from replay_kit.measurements.vehicle import mavlink as mavlink_vehicle
from replay_kit.measurements.vehicle import position as vehicle
from replay_kit.measurements.vehicle.motion import Dvl, horizontal, water_track
from replay_kit.measurements.vehicle.position import Depth, Pose, Position, Pressure, checked

# What a MAVLink reader needs to decode for this module.
MAVLINK_NAMES = mavlink_vehicle.NAMES | {mavlink_ping.SCHEMA}
# Frames of a ping follow one another at once; when this many pings stand open the oldest has lost a frame.
_OPEN_PINGS = 8
_INCOMPLETE = "part of an incomplete ping"
_NO_REFERENCE = (
    "ping: expected reference to be one of earth, platform, got none; state it in the message, or as measurements.reference "
    "when the message has no place for it"
)
_ATTITUDE = "attitude: kept for pings that do not state theirs"
_NO_DAC = "depth-averaged current: not used (measurements.use_dac)"
_NO_ATTITUDE = "DVL: no attitude within a second"
_NO_DECLINATION = "DVL: whether its heading is true or magnetic is not known; state measurements.magnetic_declination, 0 for a true one"
_NO_LAYER = "DVL: water track, whose layer's depth it does not say; state measurements.water_track_distance"
_NO_BOTTOM = "DVL: water track without a bottom track, which says nothing of the current"
# 146 years: a position may be as old as the configuration likes, and ages stay int64
_FOREVER_NS = 2.0**62


def initial_state(system: int | None = None) -> MeasurementState:
    """Return the state before the first message; ``system`` is the MAVLink system asked for, in logs that hold several."""
    return MeasurementState(system=None if system is None else str(system))


def observations(messages: Iterable[Message], config: MeasurementConfig | None = None) -> Iterator[Measurement]:
    """Yield the profiles and mean currents in a stream of messages: what a post-mission script loops over."""
    config = config or MeasurementConfig()
    state = initial_state()
    for message in messages:
        state, events = interpret(state, message, config)
        yield from (event for event in events if isinstance(event, Measurement))
    yield from (event for event in finish(state, config) if isinstance(event, Measurement))


def interpret(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Return the state after a message and the events it completes.

    Each message gives exactly one ``Used`` or ``Skipped``, at once or, for a ping, when its position is known. A message that is
    not what its schema says is skipped and leaves no trace in the state.
    """
    state, events = _expire(state, message.time_ns, config)
    try:
        after, more = _interpret(state, message, config)
    except MeasurementError as error:
        after, more = state, [Skipped(message.topic, str(error))]
    except MALFORMED as error:
        after, more = state, [Skipped(message.topic, malformed(error))]
    return after, [*events, *more]


def finish(state: MeasurementState, config: MeasurementConfig) -> list[Event]:
    """Return the events of what still waits when the log ends."""
    events: list[Event] = [Skipped(frame.topic, _INCOMPLETE) for _, frames in state.frames for frame in frames.values()]
    return events + [event for ping in state.waiting for event in placed(ping, state.fix, None, state.track, config)]


def _expire(state: MeasurementState, now_ns: int, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Let go of the pings for which no position will come that is near enough: they must not pile up."""
    oldest_ns = now_ns - int(min(config.position_max_age * 1e9, _FOREVER_NS))
    if not state.waiting or state.waiting[0].message.time_ns >= oldest_ns:
        return state, []
    expired, left = split(state.waiting, oldest_ns)
    return replace(state, waiting=left), [event for ping in expired for event in placed(ping, state.fix, None, state.track, config)]


def _interpret(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    entry = next((entry for entry in config.map if entry.topic == message.topic), None) if config.map else None
    if entry is None and mavlink_ping.is_ping_frame(message):
        return _ping_frame(state, message, config)
    if entry is None and message.schema in mavlink_vehicle.NAMES:
        return _mavlink_vehicle(state, message, config)
    if entry is None and (repeated := twice(message.payload, config)):
        return state, [Skipped(message.topic, repeated)]
    stated = statement(message) if entry is None else mapped(message.payload, entry)
    if isinstance(stated, Ping):
        events: list[Event] = []
        if stated.position is not None and stated.elsewhere:
            return state, elsewhere(message, stated, config)
        if stated.position is not None:
            # the message counts once, as the ping that it is
            state, (_, *events) = _position(state, message, stated.position, config)
        payload = with_attitude(with_reference(stated.payload, config), state.orientation, message.time_ns)
        if payload.get("reference") is None:
            return state, [*events, Skipped(message.topic, _NO_REFERENCE)]
        whole = message._replace(schema=PING_SCHEMA, payload=payload)
        state, more = take_ping(state, whole, 1, config)
        return state, [*events, *more]
    if isinstance(stated, Position):
        return _position(state, message, stated, config)
    if isinstance(stated, Pose):
        return _pose(state, message, stated, config)
    if isinstance(stated, Orientation):
        return replace(state, orientation=(message.time_ns, stated)), [Skipped(message.topic, _ATTITUDE)]
    if isinstance(stated, Depth | Pressure):
        return _depth(state, message, stated, config)
    if isinstance(stated, Dvl):
        return _dvl(state, message, stated, config)
    if isinstance(stated, MeanCurrent):
        return _mean_current(state, message, stated, config)
    return state, [Skipped(message.topic, stated or NOT_A_KIND)]


def _ping_frame(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    key, pings, name = mavlink_ping.frame_key(message), dict(state.frames), str(message.payload["name"])
    if name in pings.get(key, {}):
        return state, [Skipped(message.topic, "repeated frame of a ping")]
    pings[key] = {**pings.get(key, {}), name: message}
    if mavlink_ping.is_complete(pings[key]):
        frames = pings.pop(key)
        state = replace(state, frames=tuple(pings.items()))
        whole = message._replace(schema=PING_SCHEMA, payload=mavlink_ping.assemble(frames))
        return take_ping(state, whole, len(frames), config)
    events: list[Event] = []
    if len(pings) > _OPEN_PINGS:
        oldest = pings.pop(next(iter(pings)))
        events = [Skipped(frame.topic, _INCOMPLETE) for frame in oldest.values()]
    return replace(state, frames=tuple(pings.items())), events


def _mavlink_vehicle(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    system = mavlink_vehicle.system_of(message.topic)
    if state.system is not None and system not in (None, state.system):
        return state, [Skipped(message.topic, f"of MAVLink system {system}, where {state.system} counts; system in [logs] chooses")]
    said, fixes = mavlink_vehicle.read(state.fixes, message)
    if fixes is not state.fixes:
        state = replace(state, fixes=fixes)
    if isinstance(said, str):
        return state, [Skipped(message.topic, said)]
    if isinstance(said, vehicle.Position):
        if state.system is None:
            state = replace(state, system=system)
        return _position(state, message, said, config)
    return state if said is None else at_depth(state, said, config), [Used(message.topic)]


def _position(
    state: MeasurementState, message: Message, position: Position, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    if np.isfinite(position.depth):
        state = at_depth(state, position.depth, config)
    fix = VehicleState(message.time_ns, position.longitude, position.latitude, state.depth, position.dead_reckoned, source_of(message))
    track = state.track if fix.dead_reckoned or state.submerged else sailed(state.track, fix)
    origins = state.origins if fix.dead_reckoned else {}
    released, left = ready(state.waiting, fix.time_ns)
    events = [event for ping in released for event in placed(ping, state.fix, fix, track, config)]
    dives, means = passed(state.dives, fix, state.submerged, state.dive, config)
    return replace(state, fix=fix, waiting=left, dives=dives, track=track, origins=origins), [Used(message.topic), fix, *events, *means]


def _dvl(state: MeasurementState, message: Message, stated: Dvl, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Keep a bottom track for pings that lack one; a water track beside it is the current at one depth."""
    attitude = attitude_within(state.orientation, message.time_ns)
    if attitude is None or config.magnetic_declination is None:
        return state, [Skipped(message.topic, _NO_ATTITUDE if attitude is None else _NO_DECLINATION)]
    east, north = horizontal(stated, attitude, config.magnetic_declination)
    if stated.mode == "bottom":
        return replace(state, bottom=GroundVelocity(message.time_ns, east, north, stated.error_std)), [Used(message.topic)]
    if config.water_track_distance is None:
        return state, [Skipped(message.topic, _NO_LAYER)]
    payload = with_bottom_track(water_track(east, north, stated.error_std, config.water_track_distance), state.bottom, message.time_ns)
    if lacks_motion(payload):
        return state, [Skipped(message.topic, _NO_BOTTOM)]
    return take_ping(state, message._replace(schema=PING_SCHEMA, payload=payload), 1, config)


def _mean_current(
    state: MeasurementState, message: Message, stated: MeanCurrent, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    if not config.use_dac:
        return state, [Skipped(message.topic, _NO_DAC)]
    dives, mean = stated_mean(state.dives, stated, dive_of(stated.dive, state.dive), source_of(message), config)
    said: list[Event] = [Skipped(message.topic, mean)] if isinstance(mean, str) else [Used(message.topic), mean]
    return replace(state, dives=dives), said


def _pose(state: MeasurementState, message: Message, pose: Pose, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Place a pose relative to the position known when its topic's first pose since the last measured fix came."""
    state = replace(state, orientation=(message.time_ns, pose.orientation))
    if message.topic not in state.origins:
        if state.fix is None:
            return at_depth(state, pose.depth, config), [Used(message.topic)]
        state = replace(state, origins={**state.origins, message.topic: (state.fix, pose)})
    fix, origin = state.origins[message.topic]
    longitude, latitude = to_geographic(Projection(fix.longitude, fix.latitude), pose.east - origin.east, pose.north - origin.north)
    position = checked(longitude, latitude, pose.depth, True)
    return (state, [Skipped(message.topic, position)]) if isinstance(position, str) else _position(state, message, position, config)


def _depth(
    state: MeasurementState, message: Message, stated: Depth | Pressure, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    depth = stated.depth if isinstance(stated, Depth) else depth_of_pressure(stated.pressure_dbar, state.latitude)
    if not np.isfinite(depth):
        what = "depth" if isinstance(stated, Depth) else "pressure"
        return state, [Skipped(message.topic, f"{what} is not a number")]
    return at_depth(state, depth, config), [Used(message.topic)]
