"""Pings that wait for a position, and what becomes of them: an observation, or the reason why not.

The waiting pings are one tuple in the order of their times: to add a ping costs a copy of the tuple and no more.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.geodesy import to_geographic, to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation, Source, VehicleState
from replay_kit.measurements.events import MALFORMED, Event, Skipped, Used, malformed
from replay_kit.measurements.ping.earth import added_velocity
from replay_kit.measurements.ping.payload import number, read_profile
from replay_kit.measurements.quality.ping import Check, checks, flags_of


@dataclass(frozen=True, slots=True)
class WaitingPing:
    """A ping that was understood and has no position yet.

    Attributes:
        message: The ping.
        depth: The vehicle's when it came [m]; NaN when unknown.
        dive: The dive it belongs to.
        n_messages: Messages that carried it: more than one in MAVLink.
        until_ns: When the fixes are there that give its place, and its platform's velocity [ns, UTC].
    """

    message: Message
    depth: float
    dive: int
    n_messages: int
    until_ns: int


def add(waiting: tuple[WaitingPing, ...], ping: WaitingPing) -> tuple[WaitingPing, ...]:
    """Return the waiting pings with one more, in the order of their times."""
    at = bisect_right(waiting, ping.message.time_ns, key=_time)
    return (*waiting[:at], ping, *waiting[at:])


def split(waiting: tuple[WaitingPing, ...], time_ns: int) -> tuple[tuple[WaitingPing, ...], tuple[WaitingPing, ...]]:
    """Return the pings before a time, and the others."""
    at = bisect_left(waiting, time_ns, key=_time)
    return waiting[:at], waiting[at:]


def ready(waiting: tuple[WaitingPing, ...], now_ns: int) -> tuple[tuple[WaitingPing, ...], tuple[WaitingPing, ...]]:
    """Return the pings that wait no longer than a time, and the others."""
    if not waiting or waiting[0].message.time_ns > now_ns:
        return (), waiting
    return tuple(ping for ping in waiting if ping.until_ns <= now_ns), tuple(ping for ping in waiting if ping.until_ns > now_ns)


def observe(ping: WaitingPing, before: VehicleState | None, after: VehicleState | None, config: MeasurementConfig) -> list[Event]:
    """Return the events of a ping whose neighbouring positions are known, one for each message that carried it.

    Args:
        ping: The ping.
        before: Last position before the ping, or at its time.
        after: First position after it; None when none came.
        config: How messages become observations.
    """
    topic = ping.message.topic
    place = _interpolate(ping.message.time_ns, before, after, config.position_max_age)
    if place is None:
        return [Skipped(topic, f"no position within {config.position_max_age:g} s")] * ping.n_messages
    try:
        observation, found = _observation(ping, place, config)
    except MeasurementError as error:
        return [Skipped(topic, str(error))] * ping.n_messages
    # a ping is read long after it came: what is wrong with it must not be blamed on the position that released it
    except MALFORMED as error:
        return [Skipped(topic, malformed(error))] * ping.n_messages
    return [*[Used(topic)] * (ping.n_messages - 1), Used(topic, found), observation]


def _time(ping: WaitingPing) -> int:
    return ping.message.time_ns


def _observation(ping: WaitingPing, place: tuple[float, float], config: MeasurementConfig) -> tuple[Observation, tuple[Check, ...]]:
    longitude, latitude = place
    message = ping.message
    # a log that never states a depth is a surface vessel's
    as_it_is = np.isfinite(ping.depth) or message.payload.get("vehicle_depth_needed") is True
    profile = read_profile(message.payload, ping.depth if as_it_is else 0.0, latitude, config)
    found = checks(message.payload, profile, ping.depth, ping.dive, config)
    flags, reasons = flags_of(profile, found, config.quality.use_suspect)
    added, common_std = added_velocity(message.payload, config)
    observation = Observation(
        message.time_ns,
        longitude,
        latitude,
        profile.depth,
        profile.velocity,
        profile.error_std,
        profile.reference,
        flags,
        reasons,
        ping.dive,
        Source(message.input, message.topic, message.position, message.time_ns),
        common_std,
        _correlation_depth(message.payload, config),
        added,
    )
    return observation, found


def _correlation_depth(payload: Mapping[str, Any], config: MeasurementConfig) -> float:
    """Return what the ping states, or else the configuration's [m]."""
    stated = number(payload.get("correlation_depth"))
    return stated if stated >= 0.0 else config.correlation_depth


def _interpolate(time_ns: int, before: VehicleState | None, after: VehicleState | None, max_age_s: float) -> tuple[float, float] | None:
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
