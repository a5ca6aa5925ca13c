"""A ping's way through the measurement step: whether it counts, what makes it absolute, where it was."""

import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import replace
from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation import RawValues, Source, VehicleState
from replay_kit.core.quantities import metres_per_second
from replay_kit.measurements.consistency.raw import raw_values
from replay_kit.measurements.events import Event, Skipped, Used
from replay_kit.measurements.messages.adcp_ping import parse_ping, parse_pings
from replay_kit.measurements.messages.mavlink import Key, PingFrame, assemble, is_complete
from replay_kit.measurements.messages.profiles import StatedPing
from replay_kit.measurements.messages.vehicle import Dvl, horizontal, water_track
from replay_kit.measurements.ping.adcp_ping import (
    AdcpPing,
    PlatformVelocity,
    attitude_within,
    with_attitude,
)
from replay_kit.measurements.ping.earth import earth_referenced, with_bottom_track
from replay_kit.measurements.steps.position_matching import (
    RELATIVE,
    PlacedPing,
    WaitingPing,
    add,
    is_unwanted,
    observe,
    refuse,
)
from replay_kit.measurements.steps.state import MeasurementState, Step, at_depth
from replay_kit.measurements.vehicle.dead_reckoning import waits_until
from replay_kit.measurements.vehicle.dives import depth_of_pressure

# Frames of a ping follow one another at once; when this many pings stand open the oldest has lost a frame.
_OPEN_PINGS = 8
_INCOMPLETE = "part of an incomplete ping"
_ALSO_INVERTED = (
    "already in the dive's inverted profile; measurements.use_inverted = false uses this instead"
)
_INVERTED = "inverted from the dive's pings and mean current, which are used instead (measurements.use_inverted)"
_NO_ATTITUDE = "DVL: no attitude within 1 s"
_NO_DECLINATION = "DVL heading: true or magnetic north unknown; set measurements.magnetic_declination (0 for true north)"
_NO_LAYER = "DVL water track does not state its layer depth; set measurements.water_track_distance"
_NO_BOTTOM = "DVL water track without a bottom track gives no current"


def duplicate_reason(payload: Mapping[str, Any], config: MeasurementConfig) -> str:
    """Return why a message would count what another message of the log holds a second time; empty when it would not."""
    if config.use_inverted:
        return _ALSO_INVERTED if payload.get("also_in") else ""
    return _INVERTED if payload.get("computed_from") else ""


def read_pings(stated: Sequence[StatedPing], config: MeasurementConfig) -> list[StatedPing]:
    """Return pings with their payloads read: many take little more time than one."""
    # in no dive where a mooring measured
    payloads = [one.payload if one.place is None else {**one.payload, "dive": 0} for one in stated]
    pings = parse_pings(payloads, config.reference)
    good = [in_metres_per_second(ping, config) for ping in pings if isinstance(ping, AdcpPing)]
    raw = list[RawValues]()
    for (_, along_beams), alike in groupby(good, _form):
        raw += raw_values(np.array([ping.velocity for ping in alike]), along_beams)
    read = zip(good, raw, strict=True)
    return [
        replace(one, read=next(read) if isinstance(ping, AdcpPing) else str(ping))
        for one, ping in zip(stated, pings, strict=True)
    ]


def _form(ping: AdcpPing) -> tuple[tuple[int, ...], bool]:
    return ping.velocity.shape, ping.coordinate_system == "beam"


def take_stated_ping(
    state: MeasurementState,
    stated: StatedPing,
    source: Source,
    config: MeasurementConfig,
    n_messages: int = 1,
) -> Step:
    """Return the state after the messages, mostly one, that carry a profile, and the events."""
    read = stated.read or read_pings([stated], config)[0].read
    if not isinstance(read, tuple):
        return state, [Skipped(source.topic, str(read))] * n_messages
    known, place = state, stated.place
    if place is not None:
        # where a mooring measured tells nothing of the vehicle: its ping is taken as if nothing else were known
        where = place.longitude, place.latitude, place.depth
        fix = VehicleState(source.time_ns, *where, False, source)
        known = MeasurementState(fix=fix, depth=place.depth)
    try:
        after, events = resolve_ping(known, read, source, n_messages, config)
    except MeasurementError as error:
        return state, [Skipped(source.topic, str(error))] * n_messages
    return after if place is None else state, events


def take_ping_frame(
    state: MeasurementState, frame: PingFrame, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after a MAVLink frame, and the events of the ping that it completes."""
    pings = dict(state.frames)
    if frame.name in pings.get(frame.key, {}):
        return state, [Skipped(source.topic, "repeated frame of a ping")]
    pings[frame.key] = {**pings.get(frame.key, {}), frame.name: frame}
    if is_complete(pings[frame.key]):
        frames = pings.pop(frame.key)
        whole = StatedPing(assemble(frames))
        return take_stated_ping(replace(state, frames=pings), whole, source, config, len(frames))
    events: list[Event | PlacedPing] = []
    if len(pings) > _OPEN_PINGS:
        oldest = next(iter(pings))
        events = incomplete({oldest: pings.pop(oldest)})
    return replace(state, frames=pings), events


def incomplete(frames: Mapping[Key, Mapping[str, PingFrame]]) -> list[Event | PlacedPing]:
    """Return the events of frames whose pings have lost others."""
    return [Skipped(topic, _INCOMPLETE) for (topic, _, _), parts in frames.items() for _ in parts]


def take_dvl(
    state: MeasurementState, stated: Dvl, source: Source, config: MeasurementConfig
) -> Step:
    """Keep a bottom track for pings that lack one; a water track beside it is the current at one depth."""
    attitude = attitude_within(state.orientation, source.time_ns)
    if attitude is None or config.magnetic_declination is None:
        return state, [Skipped(source.topic, _NO_ATTITUDE if attitude is None else _NO_DECLINATION)]
    east, north = horizontal(stated, attitude, config.magnetic_declination, config.dvl_axes)
    if stated.mode == "bottom":
        velocity = PlatformVelocity(east, north, stated.error_std, "dvl")
        return replace(state, bottom=(source.time_ns, velocity)), [Used(source.topic)]
    if config.water_track_distance is None:
        return state, [Skipped(source.topic, _NO_LAYER)]
    ping = parse_ping(water_track(east, north, stated.error_std, config.water_track_distance))
    if (
        with_bottom_track(ping, state.bottom, source.time_ns, config.max_speed).platform_velocity
        is None
    ):
        return state, [Skipped(source.topic, _NO_BOTTOM)]
    (raw,) = raw_values(ping.velocity[None])
    return resolve_ping(state, (ping, raw), source, 1, config)


def in_metres_per_second(ping: AdcpPing, config: MeasurementConfig) -> AdcpPing:
    """Return a ping whose velocities are in a unit that its message does not state, with all of them in m/s.

    Args:
        ping: The ping; errors and the platform's velocity that it states are in m/s.
        config: The unit.
    """
    if config.velocity_unit in (None, "m/s"):
        return ping
    factor = metres_per_second(config.velocity_unit)
    assert factor is not None, "the configuration takes no other unit"
    return replace(ping, velocity=ping.velocity * factor)


def resolve_ping(
    state: MeasurementState,
    read: tuple[AdcpPing, RawValues],
    source: Source,
    n_messages: int,
    config: MeasurementConfig,
) -> Step:
    """Take in a whole ping with the values before any rotation: as many ``Used`` or ``Skipped`` as messages carried it.

    A vessel's ping that does not state its motion waits for the fixes after it, too.

    Raises:
        MeasurementError: The ping does not say what turns its velocities to the earth's axes.
    """
    ping = with_attitude(read[0], state.orientation, source.time_ns)
    ping = with_bottom_track(ping, state.bottom, source.time_ns, config.max_speed)
    ping = earth_referenced(ping, config)
    absolute = ping.reference == "earth"
    until_ns = (
        source.time_ns if absolute or state.submerged else waits_until(source.time_ns, state.track)
    )
    if until_ns == source.time_ns and is_unwanted(ping, config):
        return state, refuse(
            WaitingPing(ping, source, state.depth, 0, n_messages, until_ns, read[1]), RELATIVE
        )
    last_depth = state.depth
    if not math.isfinite(state.depth) and math.isfinite(
        depth := depth_of_pressure(ping.pressure, state.latitude)
    ):
        # a log whose only depth is the pressure of its pings still has dives
        state = replace(at_depth(state, depth, config), depth=float("nan"))
    dive = state.dive if ping.dive is None else ping.dive
    in_dive = state.submerged and state.fix is not None
    waiting = WaitingPing(ping, source, last_depth, dive, n_messages, until_ns, read[1], in_dive)
    if state.fix is not None and state.fix.time_ns == source.time_ns == until_ns:
        return state, observe(waiting, state.fix, None, config)
    return replace(state, waiting=add(state.waiting, waiting)), []
