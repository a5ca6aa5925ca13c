"""Pings that wait for a position, and what becomes of them: an observation, or the reason why not.

The profiles of a block of messages are made and tested together.
The waiting pings are one tuple in the order of their times: to add a ping costs a copy of the tuple and no more.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import replace
from replay_kit.core.geodesy import to_geographic, to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.observation import NO_RAW_VALUES, Observation, RawValues, Source, VehicleState
from replay_kit.measurements.events import NO_POSITION, Event, Skipped, Used
from replay_kit.measurements.ping.adcp_ping import AdcpPing
from replay_kit.measurements.ping.earth import added_velocity, earth_referenced
from replay_kit.measurements.ping.profile import profiles_of, transducer_depths
from replay_kit.measurements.quality.ping import PingBlock, checks, flags_of, is_nortek
from replay_kit.measurements.vehicle.dead_reckoning import Fixes, fixes_around, vessel_velocity

# m/s; by which a glider's velocity on one leg departs from its mean over the dive: the place at a share s of a dive of T seconds, taken on
# the straight way between its ends, is off by this times T s (1 - s)
_SPEED_STD = 0.1
#: The reason of a ping that is no absolute profile, where these alone are wanted.
RELATIVE = "velocity relative to the platform, whose motion is unknown"
_time = attrgetter("source.time_ns")


@dataclass(frozen=True, slots=True)
class WaitingPing:
    """A ping that was understood and has no position yet.

    Attributes:
        ping: The ping.
        source: Its message.
        depth: The vehicle's when it came [m]; NaN when unknown.
        dive: The dive it belongs to.
        n_messages: Messages that carried it: more than one in MAVLink.
        until_ns: When the fixes are there that give its place, and its platform's velocity [ns, UTC].
        raw: Of its velocities before any rotation.
        in_dive: Whether the vehicle was in a dive, and a position before it is known.
    """

    ping: AdcpPing
    source: Source
    depth: float
    dive: int
    n_messages: int
    until_ns: int
    raw: RawValues = NO_RAW_VALUES
    in_dive: bool = False

    def longest_wait(self, config: MeasurementConfig) -> float:
        """Return how long it waits for a position [s]."""
        return (
            max(config.position_max_gap, config.position_max_age)
            if self.in_dive
            else config.position_max_age
        )


@dataclass(frozen=True, slots=True)
class PlacedPing:
    """A ping whose place is known, before its profile is tested.

    Attributes:
        waiting: The ping as it waited.
        position: Longitude and latitude [degrees].
        position_std: Standard error of its place [m]; 0 for a place that is near a known position.
    """

    waiting: WaitingPing
    position: tuple[float, float]
    position_std: float

    @property
    def vehicle_depth(self) -> float:
        """Depth of the vehicle [m]; a log that never states a depth is a surface vessel's."""
        depth = self.waiting.depth
        return depth if math.isfinite(depth) or self.waiting.ping.needs_vehicle_depth else 0.0


def add(waiting: tuple[WaitingPing, ...], ping: WaitingPing) -> tuple[WaitingPing, ...]:
    """Return the waiting pings with one more, in the order of their times."""
    at = bisect_right(waiting, ping.source.time_ns, key=_time)
    return (*waiting[:at], ping, *waiting[at:])


def split(
    waiting: tuple[WaitingPing, ...], time_ns: int
) -> tuple[tuple[WaitingPing, ...], tuple[WaitingPing, ...]]:
    """Return the pings before a time, and the others."""
    at = bisect_left(waiting, time_ns, key=_time)
    return waiting[:at], waiting[at:]


def ready(
    waiting: tuple[WaitingPing, ...], now_ns: int
) -> tuple[tuple[WaitingPing, ...], tuple[WaitingPing, ...]]:
    """Return the pings that wait no longer than a time, and the others."""
    if not waiting or waiting[0].source.time_ns > now_ns:
        return (), waiting
    return tuple(ping for ping in waiting if ping.until_ns <= now_ns), tuple(
        ping for ping in waiting if ping.until_ns > now_ns
    )


def is_unwanted(ping: AdcpPing, config: MeasurementConfig) -> bool:
    """Return whether a ping is not used although it was understood: it is no absolute profile and these alone are wanted."""
    return ping.reference == "platform" and not config.use_relative


def place(
    ping: WaitingPing,
    before: VehicleState | None,
    after: VehicleState | None,
    track: Fixes,
    config: MeasurementConfig,
) -> list[Event | PlacedPing]:
    """Return the events of a ping that waits no longer.

    Args:
        ping: The ping.
        before: Last position before the one that released it.
        after: The position that released it; None when none did.
        track: Latest fixes at the surface, that one among them.
        config: How messages become observations.
    """
    time_ns = ping.source.time_ns
    if ping.until_ns == time_ns:
        return observe(ping, before, after, config)
    motion = vessel_velocity(time_ns, track)
    absolute = (
        ping.ping
        if motion is None
        else earth_referenced(replace(ping.ping, platform_velocity=motion), config)
    )
    if is_unwanted(absolute, config):
        return refuse(ping, RELATIVE)
    # the ping was passed by positions while it waited
    earlier, later = fixes_around(track, time_ns)
    return observe(replace(ping, ping=absolute), earlier or before, later or after, config)


def observe(
    waiting: WaitingPing,
    before: VehicleState | None,
    after: VehicleState | None,
    config: MeasurementConfig,
) -> list[Event | PlacedPing]:
    """Return the ping with its place, when its neighbouring positions are known, or why it is not used.

    ``observed`` makes events of it: many pings are tested together in little more time than one.

    Args:
        waiting: The ping.
        before: Last position before the ping, or at its time.
        after: First position after it; None when none came.
        config: How messages become observations.
    """
    position, position_std = _place(waiting, before, after, config)
    if position is None:
        return refuse(waiting, f"{NO_POSITION} {config.position_max_age:g} s")
    return [PlacedPing(waiting, position, position_std)]


def refuse(ping: WaitingPing, reason: str) -> list[Event | PlacedPing]:
    """Return the events of a ping that is not used, one for each message that carried it."""
    return [Skipped(ping.source.topic, reason)] * ping.n_messages


def _place(
    waiting: WaitingPing,
    before: VehicleState | None,
    after: VehicleState | None,
    config: MeasurementConfig,
) -> tuple[tuple[float, float] | None, float]:
    """Return longitude and latitude of a ping, or None, and the standard deviation of a place that lies far from both positions [m]."""
    time_ns = waiting.source.time_ns
    near = _interpolate(time_ns, before, after, config.position_max_age)
    if near is not None or not waiting.in_dive or before is None or after is None:
        return near, 0.0
    gap_s, since_s = (after.time_ns - before.time_ns) * 1e-9, (time_ns - before.time_ns) * 1e-9
    if gap_s > config.position_max_gap:
        return None, 0.0
    return _interpolate(time_ns, before, after, math.inf), _SPEED_STD * since_s * (
        1.0 - since_s / gap_s
    )


def _interpolate(
    time_ns: int, before: VehicleState | None, after: VehicleState | None, max_age_s: float
) -> tuple[float, float] | None:
    """Return longitude and latitude at a time, or None when neither neighbour is near enough in time."""
    known = [fix for fix in (before, after) if fix is not None]
    if not known or min(abs(fix.time_ns - time_ns) for fix in known) > max_age_s * 1e9:
        return None
    if before is not None and after is not None and before.time_ns < time_ns < after.time_ns:
        projection = Projection(before.longitude, before.latitude)
        east, north = to_local(projection, after.longitude, after.latitude)
        share = (time_ns - before.time_ns) / (after.time_ns - before.time_ns)
        longitude, latitude = to_geographic(projection, share * east, share * north)
        # between opposite sides of the Earth there is no way that is the shortest
        if np.isfinite(longitude) and np.isfinite(latitude):
            return float(unwrap_longitude(longitude, before.longitude)), float(latitude)
    nearest = min(known, key=lambda fix: abs(fix.time_ns - time_ns))
    return nearest.longitude, nearest.latitude


def observed(
    blocks: Sequence[Sequence[Event | PlacedPing]], config: MeasurementConfig
) -> list[list[Event]]:
    """Return the events of messages, with those of each ping in its place.

    These are that its messages were used, with the tests' results, and the observation; or that they were skipped.

    Args:
        blocks: The events of each message.
        config: How pings become observations.
    """
    placed = [event for events in blocks for event in events if isinstance(event, PlacedPing)]
    if not placed:
        return [
            [event for event in events if not isinstance(event, PlacedPing)] for events in blocks
        ]
    pings = [each.waiting.ping for each in placed]
    tops = transducer_depths(
        pings, [each.vehicle_depth for each in placed], [each.position[1] for each in placed]
    )
    alike: dict[tuple[int, bool], list[int]] = {}
    for i, (ping, top) in enumerate(zip(pings, tops, strict=True)):
        if not isinstance(top, str):
            alike.setdefault((len(ping.velocity), is_nortek(ping)), []).append(i)
    made: dict[int, list[Event]] = {
        i: [Skipped(each.waiting.source.topic, top)] * each.waiting.n_messages
        for i, (each, top) in enumerate(zip(placed, tops, strict=True))
        if isinstance(top, str)
    }
    for at in alike.values():
        made |= zip(
            at,
            _together([placed[i] for i in at], [float(tops[i]) for i in at], config),
            strict=True,
        )
    in_order = iter([made[i] for i in range(len(placed))])
    return [
        [
            event
            for given in events
            for event in (next(in_order) if isinstance(given, PlacedPing) else (given,))
        ]
        for events in blocks
    ]


def _with_sensors(raw: RawValues, ping: AdcpPing, top: float) -> RawValues:
    """Return what is remembered of a ping with its heading, its depth by its pressure, and its mean error velocity, of solved beams."""
    error, known = ping.quality.error_velocity, np.empty(0)
    if ping.measured_system == "beam" and not isinstance(error, str):
        known = error[np.isfinite(error)]
    depth = top if math.isfinite(ping.pressure) else math.nan
    if not (known.size or math.isfinite(depth) or math.isfinite(ping.attitude.heading)):
        return raw
    return replace(
        raw,
        depth=depth,
        error_velocity=float(known.mean()) if known.size else math.nan,
        heading=ping.attitude.heading,
    )


def _together(
    placed: Sequence[PlacedPing], tops: Sequence[float], config: MeasurementConfig
) -> Iterator[list[Event]]:
    """Yield the events of pings of as many cells and of one convention."""
    pings = [each.waiting.ping for each in placed]
    profiles = profiles_of(pings, tops, config)
    tested = PingBlock(
        pings,
        profiles,
        [each.waiting.depth for each in placed],
        [each.waiting.dive for each in placed],
    )
    found = checks(tested, config)
    flags, reasons = flags_of(profiles, found, config.quality.use_suspect)
    for i, each in enumerate(placed):
        waiting, ping, source = each.waiting, each.waiting.ping, each.waiting.source
        platform_velocity, common_std = added_velocity(ping, config)
        observation = Observation(
            source.time_ns,
            *each.position,
            profiles.depth[i],
            profiles.velocity[i],
            profiles.error_std[i],
            ping.reference,
            flags[i],
            reasons[i],
            waiting.dive,
            source,
            common_std,
            ping.correlation_depth if ping.correlation_depth >= 0.0 else config.correlation_depth,
            platform_velocity,
            raw=_with_sensors(waiting.raw, ping, tops[i]),
            position_std=each.position_std,
        )
        carriers = [Used(source.topic)] * (waiting.n_messages - 1)
        yield [*carriers, Used(source.topic, found, i), observation]
