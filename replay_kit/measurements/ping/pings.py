"""A ping's way through the measurement step: whether it counts, what makes it absolute, where it was."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.observation import Source, VehicleState
from replay_kit.measurements.events import MALFORMED, Event, Skipped, malformed
from replay_kit.measurements.ping.earth import earth_referenced
from replay_kit.measurements.ping.foreign import Ping
from replay_kit.measurements.ping.ground import around, under_way, waits_until, with_bottom_track
from replay_kit.measurements.ping.payload import depth_of_pressure, number, why_not_used
from replay_kit.measurements.ping.waiting import WaitingPing, add, observe
from replay_kit.measurements.state import MeasurementState, at_depth

PING_SCHEMA = "replay_kit.AdcpPing"
_ALSO_INVERTED = "its dive's computed profile has it; measurements.use_inverted = false uses this instead"
_INVERTED = "computed from the dive's pings and mean current, which are used instead (measurements.use_inverted)"
_MAX_DIVE = 2**32 - 1


def twice(payload: Mapping[str, Any], config: MeasurementConfig) -> str:
    """Return why a message would count what another message of the log holds a second time; empty when it would not."""
    if config.use_inverted:
        return _ALSO_INVERTED if payload.get("also_in") else ""
    return _INVERTED if payload.get("computed_from") else ""


def with_reference(payload: Mapping[str, Any], config: MeasurementConfig) -> Mapping[str, Any]:
    """Return a ping that states what its velocities are relative to, if the message or the configuration says so."""
    if payload.get("reference") is None and config.reference is not None:
        return {**payload, "reference": config.reference}
    return payload


def take_ping(
    state: MeasurementState, message: Message, n_messages: int, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    """Take in a whole ping, which gives as many ``Used`` or ``Skipped`` as messages carried it.

    A vessel's ping that does not state its motion waits for the fixes after it, too.
    """
    try:
        payload = with_bottom_track(message.payload, state.bottom, message.time_ns)
        until_ns = waits_until(payload, message.time_ns, () if state.submerged else state.track)
        message = message._replace(payload=earth_referenced(payload, config))
        refused = None if until_ns > message.time_ns else _refused(message, config)
    except MeasurementError as error:
        return state, [Skipped(message.topic, str(error))] * n_messages
    except MALFORMED as error:
        return state, [Skipped(message.topic, malformed(error))] * n_messages
    if refused is not None:
        return state, [Skipped(message.topic, refused)] * n_messages
    depth = depth_of_pressure(number(message.payload.get("pressure")), state.latitude)
    if not np.isfinite(state.depth) and np.isfinite(depth):
        # a log whose only depth is the ping's own pressure still has dives
        state = replace(at_depth(state, depth, config), depth=float("nan"))
    ping = WaitingPing(message, state.depth, dive_of(message.payload.get("dive"), state.dive), n_messages, until_ns)
    if state.fix is not None and state.fix.time_ns == message.time_ns == until_ns:
        return state, observe(ping, state.fix, None, config)
    return replace(state, waiting=add(state.waiting, ping)), []


def placed(
    ping: WaitingPing, before: VehicleState | None, after: VehicleState | None, track: tuple[VehicleState, ...], config: MeasurementConfig
) -> list[Event]:
    """Return the events of a ping that waits no longer.

    Args:
        ping: The ping.
        before: Last position before the one that released it.
        after: The position that released it; None when none did.
        track: Latest fixes at the surface, that one among them.
        config: How messages become observations.
    """
    time_ns = ping.message.time_ns
    if ping.until_ns == time_ns:
        return observe(ping, before, after, config)
    message = under_way(ping.message, track, config)
    refused = _refused(message, config)
    if refused is not None:
        return [Skipped(message.topic, refused)] * ping.n_messages
    return observe(replace(ping, message=message), *around(track, time_ns), config)


def _refused(message: Message, config: MeasurementConfig) -> str | None:
    """Return why a ping is not used although it was understood; None when it is."""
    reason = None if config.use_relative else why_not_used(message.payload)
    return None if reason is None else reason[0]


def elsewhere(message: Message, stated: Ping, config: MeasurementConfig) -> list[Event]:
    """Return the events of a measurement with a place of its own, which says nothing of the vehicle."""
    assert stated.position is not None
    here = stated.position
    whole = message._replace(schema=PING_SCHEMA, payload=earth_referenced(stated.payload, config))
    at = VehicleState(message.time_ns, here.longitude, here.latitude, here.depth, False, source_of(message))
    return observe(WaitingPing(whole, here.depth, 0, 1, message.time_ns), at, None, config)


def dive_of(stated: Any, counted: int) -> int:
    """Return the dive that a ping states, or the one counted when it states none that can be."""
    return stated if isinstance(stated, int) and not isinstance(stated, bool) and 0 <= stated <= _MAX_DIVE else counted


def source_of(message: Message) -> Source:
    """Return the pointer to a message."""
    return Source(message.input, message.topic, message.position, message.time_ns)
