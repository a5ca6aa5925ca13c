"""ADCP pings in earth coordinates to the bins of profiles of the current."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.measurements.ping.adcp_ping import AdcpPing
from replay_kit.measurements.vehicle.pressure import depth_of_pressure


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """The bins of s pings that have n cells each.

    Attributes:
        depth: shape (s, n) [m], positive down.
        distance: shape (s, n) [m], vertical, from the transducer to the bins' centres.
        transducer_depth: Of each ping [m], positive down.
        velocity: shape (s, n, 2) [m/s], true east and north; NaN where missing.
        error_std: shape (s, n) [m/s].
    """

    depth: Array
    distance: Array
    transducer_depth: Sequence[float]
    velocity: Array
    error_std: Array


def profiles_of(pings: Sequence[AdcpPing], transducer_depths: Sequence[float], config: MeasurementConfig) -> Profiles:
    """Return the profiles that earth-coordinates pings hold.

    Args:
        pings: The pings, of as many cells each.
        transducer_depths: As ``transducer_depth`` gives them [m].
        config: The error of bins whose ping states none.
    """
    distance = np.array([ping.distance for ping in pings])
    sign = np.array([-1.0 if ping.orientation == "up" else 1.0 for ping in pings])
    with np.errstate(over="ignore", invalid="ignore"):
        depth = np.array(transducer_depths)[:, None] + sign[:, None] * distance
    depth = np.where(np.isfinite(depth), depth, np.nan)
    stated = np.array([ping.velocity_std for ping in pings])
    velocity = np.array([ping.velocity[:, :2] for ping in pings])
    return Profiles(depth, distance, transducer_depths, velocity, np.where(np.isfinite(stated), stated, config.velocity_std))


def transducer_depth(ping: AdcpPing, vehicle_depth: float, latitude: float) -> float:
    """Return the depth of the transducer [m]: of the ping's pressure, or the vehicle's where it has none, plus ``transducer_depth``.

    Args:
        ping: The ping.
        vehicle_depth: [m], from other messages; used when the ping has no pressure. NaN when unknown.
        latitude: [degrees north], for pressure to depth.

    Raises:
        MeasurementError: It is not known.
    """
    stated = math.isfinite(ping.pressure)
    top = depth_of_pressure(ping.pressure, latitude) if stated else vehicle_depth
    if not math.isfinite(top):
        if not stated:
            raise MeasurementError("ping: its instrument's depth is not a number, and no earlier message gives the vehicle's depth")
        raise MeasurementError("ping: no depth has the pressure it states [dbar]")
    return top + (ping.transducer_depth if math.isfinite(ping.transducer_depth) else 0.0)
