"""The measurement step: state in, message in; state, and what the message meant, out.

A ping waits until a position at or after its own time is known, then takes the position interpolated between its neighbours.
"""

# keeps the signature in help() short
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import filterfalse
from types import MappingProxyType
from typing import Any

from replay_kit.config.mapping import TopicMap
from replay_kit.config.quality import rules_for
from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.observation import LinearMeasurement, Measurement, PathMean, Source, kind_of
from replay_kit.measurements.events import (
    MALFORMED,
    NOT_A_KIND,
    Event,
    Skipped,
    Used,
    left_out_reason,
    malformed,
)
from replay_kit.measurements.messages import mavlink
from replay_kit.measurements.messages.kinds import Statement, statement
from replay_kit.measurements.messages.mapped import mapped
from replay_kit.measurements.messages.mavlink import PingFrame
from replay_kit.measurements.messages.profiles import StatedPing
from replay_kit.measurements.messages.vehicle import Depth, Dvl, Pose, Position, Pressure
from replay_kit.measurements.messages.water import Ctd, DrifterFix, RadarCurrents
from replay_kit.measurements.ping.adcp_ping import Orientation
from replay_kit.measurements.steps.pings import (
    duplicate_reason,
    incomplete,
    read_pings,
    take_dvl,
    take_ping_frame,
    take_stated_ping,
)
from replay_kit.measurements.steps.position_matching import (
    PlacedPing,
    WaitingPing,
    observed,
    place,
    split,
)
from replay_kit.measurements.steps.state import (
    MeasurementState,
    Step,
    record_depth,
    record_gps_status,
    record_mean_current,
    record_navigation,
    record_orientation,
    record_origin,
    record_pose,
    record_position,
    record_pressure,
)
from replay_kit.measurements.steps.water import (
    record_ctd,
    record_drifter,
    record_measurement,
    record_radar,
    surfaced,
    unfinished,
)
from replay_kit.measurements.vehicle.mean_current import MeanCurrent

# What a MAVLink reader needs to decode for this module.
MAVLINK_NAMES = mavlink.NAMES | {mavlink.SCHEMA}
# 146 years: a position may be as old as the configuration likes, and ages stay int64
_FOREVER_NS = 2.0**62

#: What each kind of statement changes.
_STEPS: Mapping[type, Callable[[MeasurementState, Any, Source, MeasurementConfig], Step]] = (
    MappingProxyType(
        {
            StatedPing: take_stated_ping,
            PingFrame: take_ping_frame,
            Dvl: take_dvl,
            Position: record_position,
            mavlink.NavigationPosition: record_navigation,
            mavlink.GpsStatus: record_gps_status,
            mavlink.LocalOrigin: record_origin,
            Pose: record_pose,
            Orientation: record_orientation,
            Depth: record_depth,
            Pressure: record_pressure,
            MeanCurrent: record_mean_current,
            Ctd: record_ctd,
            RadarCurrents: record_radar,
            DrifterFix: record_drifter,
            LinearMeasurement: record_measurement,
        }
    )
)
# what tells which MAVLink system counts, in a log that holds several
_STATES_POSITION = (Position, mavlink.NavigationPosition, Pose)


def initial_state(system: int | None = None, component: int | None = None) -> MeasurementState:
    """Return the state before the first message; ``system`` and ``component`` are those of MAVLink asked for, in logs that hold several."""
    asked = (None if number is None else str(number) for number in (system, component))
    return MeasurementState(sender=(next(asked), next(asked)))


def observations(
    messages: Iterable[Message], config: MeasurementConfig | None = None
) -> Iterator[Measurement]:
    """Yield the profiles and mean currents in a stream of messages: what a post-mission script loops over.

    A mean current beside profiles that were computed from it is left out: without the flight model's bias it would count twice.
    """
    for events in events_of(messages, config or MeasurementConfig()):
        for event in events:
            if isinstance(event, Measurement) and not (
                isinstance(event, PathMean) and event.beside_profiles
            ):
                yield event


def events_of(
    messages: Iterable[Message],
    config: MeasurementConfig,
    system: int | None = None,
    component: int | None = None,
) -> Iterator[list[Event]]:
    """Yield the events that each message of a stream completes, and last those of what still waits at its end.

    Args:
        messages: In order of time; one is taken when its events are asked for.
        config: How messages become observations.
        system: The MAVLink system that counts; None for the first that states a position.
        component: The component of it that counts; None for the first that states a position.
    """
    state = initial_state(system, component)
    for message in messages:
        state, events = interpret(state, message, config)
        yield events
    yield finish(state, config)


def interpret(
    state: MeasurementState, message: Message, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    """Return the state after a message and the events it completes.

    Each message gives exactly one ``Used`` or ``Skipped``, at once or, for a ping, when its position is known. A message that is
    not what its schema says is skipped and leaves no trace in the state.
    """
    return interpret_block(state, [message], config)[0]


def interpret_block(
    state: MeasurementState, messages: Sequence[Message], config: MeasurementConfig
) -> list[tuple[MeasurementState, list[Event]]]:
    """Return the state after each message and the events that it completes, as ``interpret`` does one by one.

    The pings of a block are read together, and its profiles tested together, which takes a tenth of the time; what is found does not
    depend on how messages are cut into blocks.

    Args:
        state: Before the first message.
        messages: In order of time.
        config: How messages become observations.
    """
    states, blocks = [], []
    for message, stated in zip(messages, _stated(messages, config), strict=True):
        state, events = _step(state, message, stated, config)
        states.append(state)
        blocks.append(events)
    return list(zip(states, _kept(observed(blocks, config), config), strict=True))


def _kept(blocks: list[list[Event]], config: MeasurementConfig) -> list[list[Event]]:
    """Return the events of messages without the measurements that the settings leave out."""
    return [without(events, config.without) for events in blocks] if config.without else blocks


def _stated(messages: Sequence[Message], config: MeasurementConfig) -> list[Statement]:
    """Return what each message of a block states, whatever was before it; pings are read together."""
    found = [_statement(message, config) for message in messages]
    read = iter(read_pings([one for one in found if isinstance(one, StatedPing)], config))
    return [next(read) if isinstance(one, StatedPing) else one for one in found]


def _statement(message: Message, config: MeasurementConfig) -> Statement:
    """Return what a message states, or why it is not used; a mapping goes before a known kind."""
    try:
        if (entry := _entry(message, config)) is not None:
            return mapped(message.payload, entry)
        repeated = duplicate_reason(message.payload, config)
        return repeated or statement(message) or NOT_A_KIND
    except MeasurementError as error:
        return str(error)
    except MALFORMED as error:
        return malformed(error)


def _entry(message: Message, config: MeasurementConfig) -> TopicMap | None:
    return next((entry for entry in config.map if _covers(entry, message)), None)


def _step(
    state: MeasurementState,
    message: Message,
    stated: Statement,
    config: MeasurementConfig,
) -> Step:
    state, events = _expire(state, message.time_ns, config)
    try:
        after, more = _interpret(state, message, stated, config)
    except MeasurementError as error:
        after, more = state, [Skipped(message.topic, str(error))]
    except MALFORMED as error:
        after, more = state, [Skipped(message.topic, malformed(error))]
    return after, [*events, *more] if events else more


def finish(state: MeasurementState, config: MeasurementConfig) -> list[Event]:
    """Return the events of what still waits when the log ends."""
    waiting = _ended(state, state.waiting, config)
    line = [] if state.line is None else unfinished(state, config)
    events = [*incomplete(state.frames), *waiting, *line]
    return _kept(observed([events], config), config)[0]


def _expire(state: MeasurementState, now_ns: int, config: MeasurementConfig) -> Step:
    """Let go of the pings for which no position will come that is near enough: they must not pile up."""
    if not state.waiting:
        return state, []
    # of pings in a dive the fix after it may come hours later; while one of them waits, so do those after it
    first = state.waiting[0]
    oldest_ns = now_ns - int(min(first.longest_wait(config) * 1e9, _FOREVER_NS))
    if first.source.time_ns >= oldest_ns:
        return state, []
    older, newer = split(state.waiting, oldest_ns)

    def waits(ping: WaitingPing) -> bool:
        return now_ns - ping.source.time_ns <= ping.longest_wait(config) * 1e9

    events = _ended(state, filterfalse(waits, older), config)
    return replace(state, waiting=(*filter(waits, older), *newer)), events


def _ended(
    state: MeasurementState, pings: Iterable[WaitingPing], config: MeasurementConfig
) -> list[Event | PlacedPing]:
    """Return the events of pings for which no further position comes."""
    return [event for ping in pings for event in place(ping, state.fix, None, state.track, config)]


def _interpret(
    state: MeasurementState,
    message: Message,
    stated: Statement,
    config: MeasurementConfig,
) -> Step:
    sender = mavlink.sender_of(message)
    if sender is not None and _entry(message, config) is not None:
        sender = None
    for what, own, used in zip(("system", "component"), sender or (), state.sender, strict=False):
        if used not in (None, own):
            return state, [
                Skipped(
                    message.topic,
                    f"MAVLink {what} {own}, but {what} {used} is used; choose with {what} in [logs]",
                )
            ]
    if isinstance(stated, str):
        return state, [Skipped(message.topic, stated)]
    if sender is not None and None in state.sender and type(stated) in _STATES_POSITION:
        state = replace(state, sender=sender)
    source = Source(message.input, message.topic, message.position, message.time_ns)
    events: list[Event | PlacedPing] = []
    if isinstance(stated, StatedPing) and stated.position is not None:
        # it counts even where the profile does not; the message counts once, as the ping that it is
        state, (_, *events) = record_position(state, stated.position, source, config)
    state, more = _STEPS[type(stated)](state, stated, source, config)
    if state.line is not None and not state.submerged and isinstance(stated, Position):
        state, of_dive = surfaced(state, config)
        more = [*more, *of_dive]
    return state, [*events, *more]


def _covers(entry: TopicMap, message: Message) -> bool:
    return entry.topic == message.topic and entry.name in (None, message.payload.get("name"))


def without(events: Sequence[Event], rules: Sequence[str]) -> list[Event]:
    """Return the events of a message without the measurements that rules leave out.

    Args:
        events: Of the message.
        rules: As configured; without any, all events are kept.
    """
    kept = list(events)
    for event in events:
        if not isinstance(event, Measurement):
            continue
        applied = rules_for(rules, kind_of(event), event.dive)
        if not applied:
            continue
        kept = [other for other in kept if other is not event]
        topic = event.source.topic
        for k, other in enumerate(kept):
            if isinstance(other, Used) and other.topic == topic:
                kept[k] = Skipped(topic, left_out_reason(applied))
                break
    return kept
