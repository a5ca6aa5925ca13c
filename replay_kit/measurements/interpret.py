"""The measurement step: state in, message in; state, and what the message meant, out.

A ping waits until a position at or after its own time is known, then takes the position interpolated between its neighbours.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from replay_kit.config import MeasurementConfig
from replay_kit.errors import MeasurementError
from replay_kit.geodesy import to_geographic
from replay_kit.measurements import mavlink_ping, mavlink_vehicle, vehicle
from replay_kit.measurements.adcp import depth_of_pressure, number, why_not_used
from replay_kit.measurements.attitude import Orientation, with_attitude
from replay_kit.measurements.dac import Dives, MeanCurrent, passed, stated_mean, sunk
from replay_kit.measurements.earth import earth_referenced
from replay_kit.measurements.events import MALFORMED, NOT_A_KIND, Event, Skipped, Used, malformed
from replay_kit.measurements.kinds import statement
from replay_kit.measurements.mapped import mapped
from replay_kit.measurements.profile_kinds import Ping
from replay_kit.measurements.vehicle import Depth, Pose, Position, Pressure, checked
from replay_kit.measurements.waiting import WaitingPing, add, observe, split
from replay_kit.types import Measurement, Message, Projection, Source, VehicleState

PING_SCHEMA = "replay_kit.AdcpPing"
# What a MAVLink reader needs to decode for this module.
MAVLINK_NAMES = mavlink_vehicle.NAMES | {mavlink_ping.SCHEMA}
# Frames of a ping follow one another at once; when this many pings stand open the oldest has lost a frame.
_OPEN_PINGS = 8
_INCOMPLETE = "part of an incomplete ping"
_NO_REFERENCE = (
    "ping: expected reference to be one of earth, platform, got none; state it in the message, or as measurements.reference "
    "when the message has no place for it"
)
_ALSO_INVERTED = "its dive's computed profile has it; measurements.use_inverted = false uses this instead"
_INVERTED = "computed from the dive's pings and mean current, which are used instead (measurements.use_inverted)"
_ATTITUDE = "attitude: kept for pings that do not state theirs"
_MAX_DIVE = 2**32 - 1
# 146 years: a position may be as old as the configuration likes, and ages stay int64
_FOREVER_NS = 2.0**62


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
        frames: Frames of MAVLink pings that are not complete yet.
        fixes: What the GPS of each MAVLink system last said.
        dives: The way since the last fixes, for mean currents.
        system: Number of the MAVLink system whose position and depth count: the one asked for, or the first that states a position.
    """

    fix: VehicleState | None = None
    depth: float = float("nan")
    dive: int = 0
    submerged: bool = False
    origins: Mapping[str, tuple[VehicleState, Pose]] = field(default_factory=dict)
    waiting: tuple[WaitingPing, ...] = ()
    orientation: tuple[int, Orientation] | None = None
    frames: tuple[tuple[mavlink_ping.Key, dict[str, Message]], ...] = ()
    fixes: tuple[mavlink_vehicle.LastFix, ...] = ()
    dives: Dives = field(default_factory=Dives)
    system: str | None = None


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
    return events + [event for ping in state.waiting for event in observe(ping, state.fix, None, config)]


def _expire(state: MeasurementState, now_ns: int, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Let go of the pings for which no position will come that is near enough: they must not pile up."""
    oldest_ns = now_ns - int(min(config.position_max_age * 1e9, _FOREVER_NS))
    if not state.waiting or state.waiting[0].message.time_ns >= oldest_ns:
        return state, []
    expired, left = split(state.waiting, oldest_ns)
    return replace(state, waiting=left), [event for ping in expired for event in observe(ping, state.fix, None, config)]


def _interpret(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    entry = next((entry for entry in config.map if entry.topic == message.topic), None) if config.map else None
    if entry is None and mavlink_ping.is_ping_frame(message):
        return _ping_frame(state, message, config)
    if entry is None and message.schema in mavlink_vehicle.NAMES:
        return _mavlink_vehicle(state, message, config)
    if entry is None and (twice := _twice(message.payload, config)):
        return state, [Skipped(message.topic, twice)]
    stated = statement(message) if entry is None else mapped(message.payload, entry)
    if isinstance(stated, Ping):
        events: list[Event] = []
        if stated.position is not None:
            # the message counts once, as the ping that it is
            state, (_, *events) = _position(state, message, stated.position, config)
        payload = _with_reference(stated.payload, config)
        if state.orientation is not None:
            payload = with_attitude(payload, state.orientation[1], message.time_ns - state.orientation[0])
        if payload.get("reference") is None:
            return state, [*events, Skipped(message.topic, _NO_REFERENCE)]
        whole = message._replace(schema=PING_SCHEMA, payload=payload)
        state, more = _ping(state, whole, 1, config)
        return state, [*events, *more]
    if isinstance(stated, Position):
        return _position(state, message, stated, config)
    if isinstance(stated, Pose):
        return _pose(state, message, stated, config)
    if isinstance(stated, Orientation):
        return replace(state, orientation=(message.time_ns, stated)), [Skipped(message.topic, _ATTITUDE)]
    if isinstance(stated, Depth | Pressure):
        return _depth(state, message, stated, config)
    if isinstance(stated, MeanCurrent):
        return _mean_current(state, message, stated, config)
    return state, [Skipped(message.topic, stated or NOT_A_KIND)]


def _twice(payload: Mapping[str, Any], config: MeasurementConfig) -> str:
    """Return why a message would count what another message of the log holds a second time; empty when it would not."""
    if config.use_inverted:
        return _ALSO_INVERTED if payload.get("also_in") else ""
    return _INVERTED if payload.get("computed_from") else ""


def _with_reference(payload: Mapping[str, Any], config: MeasurementConfig) -> Mapping[str, Any]:
    """Return a ping that states what its velocities are relative to, if the message or the configuration says so."""
    if payload.get("reference") is None and config.reference is not None:
        return {**payload, "reference": config.reference}
    return payload


def _ping(state: MeasurementState, message: Message, n_messages: int, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Take in a whole ping, which gives as many ``Used`` or ``Skipped`` as messages carried it."""
    try:
        message = message._replace(payload=earth_referenced(message.payload, config))
        refused = None if config.use_relative else why_not_used(message.payload)
    except MeasurementError as error:
        return state, [Skipped(message.topic, str(error))] * n_messages
    except MALFORMED as error:
        return state, [Skipped(message.topic, malformed(error))] * n_messages
    if refused is not None:
        return state, [Skipped(message.topic, refused[0])] * n_messages
    pressure = number(message.payload.get("pressure"))
    if not np.isfinite(state.depth) and np.isfinite(depth_of_pressure(pressure, 0.0)):
        # a log whose only depth is the ping's own pressure still has dives
        state = replace(_at_depth(state, pressure, config), depth=float("nan"))
    ping = WaitingPing(message, state.depth, _dive(message.payload.get("dive"), state.dive), n_messages)
    if state.fix is not None and state.fix.time_ns == message.time_ns:
        return state, observe(ping, state.fix, None, config)
    return replace(state, waiting=add(state.waiting, ping)), []


def _dive(stated: Any, counted: int) -> int:
    """Return the dive that a ping states, or the one counted when it states none that can be."""
    return stated if isinstance(stated, int) and not isinstance(stated, bool) and 0 <= stated <= _MAX_DIVE else counted


def _ping_frame(state: MeasurementState, message: Message, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    key, pings, name = mavlink_ping.frame_key(message), dict(state.frames), str(message.payload["name"])
    if name in pings.get(key, {}):
        return state, [Skipped(message.topic, "repeated frame of a ping")]
    pings[key] = {**pings.get(key, {}), name: message}
    if mavlink_ping.is_complete(pings[key]):
        frames = pings.pop(key)
        state = replace(state, frames=tuple(pings.items()))
        whole = message._replace(schema=PING_SCHEMA, payload=mavlink_ping.assemble(frames))
        return _ping(state, whole, len(frames), config)
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
    state = replace(state, fixes=fixes)
    if isinstance(said, str):
        return state, [Skipped(message.topic, said)]
    if isinstance(said, vehicle.Position):
        return _position(replace(state, system=system or state.system), message, said, config)
    return state if said is None else _at_depth(state, said, config), [Used(message.topic)]


def _position(
    state: MeasurementState, message: Message, position: Position, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    if np.isfinite(position.depth):
        state = _at_depth(state, position.depth, config)
    fix = VehicleState(message.time_ns, position.longitude, position.latitude, state.depth, position.dead_reckoned, _source(message))
    if not position.dead_reckoned:
        state = replace(state, origins={})
    released, left = split(state.waiting, fix.time_ns + 1)
    events = [event for ping in released for event in observe(ping, state.fix, fix, config)]
    dives, means = passed(state.dives, fix, state.submerged, state.dive, config)
    return replace(state, fix=fix, waiting=left, dives=dives), [Used(message.topic), fix, *events, *means]


def _mean_current(
    state: MeasurementState, message: Message, stated: MeanCurrent, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    dives, mean = stated_mean(state.dives, stated, _dive(stated.dive, state.dive), _source(message), config)
    said: list[Event] = [Skipped(message.topic, mean)] if isinstance(mean, str) else [Used(message.topic), mean]
    return replace(state, dives=dives), said


def _source(message: Message) -> Source:
    return Source(message.input, message.topic, message.position, message.time_ns)


def _pose(state: MeasurementState, message: Message, pose: Pose, config: MeasurementConfig) -> tuple[MeasurementState, list[Event]]:
    """Place a pose relative to the position known when its topic's first pose since the last measured fix came."""
    state = replace(state, orientation=(message.time_ns, pose.orientation))
    if message.topic not in state.origins:
        if state.fix is None:
            return _at_depth(state, pose.depth, config), [Used(message.topic)]
        state = replace(state, origins={**state.origins, message.topic: (state.fix, pose)})
    fix, origin = state.origins[message.topic]
    longitude, latitude = to_geographic(Projection(fix.longitude, fix.latitude), pose.east - origin.east, pose.north - origin.north)
    position = checked(longitude, latitude, pose.depth, True)
    return (state, [Skipped(message.topic, position)]) if isinstance(position, str) else _position(state, message, position, config)


def _depth(
    state: MeasurementState, message: Message, stated: Depth | Pressure, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    latitude = state.fix.latitude if state.fix else 0.0
    depth = stated.depth if isinstance(stated, Depth) else depth_of_pressure(stated.pressure_dbar, latitude)
    if not np.isfinite(depth):
        what = "depth" if isinstance(stated, Depth) else "pressure"
        return state, [Skipped(message.topic, f"{what} is not a number")]
    return _at_depth(state, depth, config), [Used(message.topic)]


def _at_depth(state: MeasurementState, depth: float, config: MeasurementConfig) -> MeasurementState:
    """Return the state with a depth noted; a dive begins at twice the surface depth and ends above it."""
    submerged = depth > 2.0 * config.surface_depth or (state.submerged and depth > config.surface_depth)
    begun = submerged and not state.submerged
    return replace(state, depth=depth, submerged=submerged, dive=state.dive + begun, dives=sunk(state.dives, depth))
