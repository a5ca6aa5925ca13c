"""ADCP pings in earth coordinates to the bins of profiles of the current."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.measurements.ping.adcp_ping import AdcpPing
from replay_kit.measurements.vehicle.dives import depths_of_pressures

_NO_DEPTH = "ping: instrument depth is not a number, and no earlier message gives the vehicle depth"
_NO_DEPTH_OF_PRESSURE = "ping: the stated pressure [dbar] corresponds to no depth"


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


def profiles_of(
    pings: Sequence[AdcpPing], transducer_depths: Sequence[float], config: MeasurementConfig
) -> Profiles:
    """Return the profiles that earth-coordinates pings hold.

    Args:
        pings: The pings, of as many cells each.
        transducer_depths: As ``transducer_depths`` gives them [m].
        config: The error of bins whose ping states none.
    """
    distance = np.array([ping.distance for ping in pings])
    sign = np.array([-1.0 if ping.orientation == "up" else 1.0 for ping in pings])
    with np.errstate(over="ignore", invalid="ignore"):
        depth = np.array(transducer_depths)[:, None] + sign[:, None] * distance
    depth = np.where(np.isfinite(depth), depth, np.nan)
    stated = np.array([ping.velocity_std for ping in pings])
    velocity = np.array([ping.velocity[:, :2] for ping in pings])
    return Profiles(
        depth,
        distance,
        transducer_depths,
        velocity,
        np.where(np.isfinite(stated), stated, config.velocity_std),
    )


def transducer_depths(
    pings: Sequence[AdcpPing], vehicle_depth: Sequence[float], latitude: Sequence[float]
) -> list[float | str]:
    """Return the depths of transducers [m], or why one is not known.

    A transducer is at the depth of the ping's pressure, or at the vehicle's where it has none, plus ``transducer_depth``.

    Args:
        pings: The pings.
        vehicle_depth: Of each [m], from other messages; used when the ping has no pressure. NaN when unknown.
        latitude: Of each [degrees north], for pressure to depth.
    """
    by_pressure = depths_of_pressures(
        np.array([ping.pressure for ping in pings]), np.array(latitude)
    ).tolist()

    def of(ping: AdcpPing, below: float, vehicle: float) -> float | str:
        stated = math.isfinite(ping.pressure)
        top = below if stated else vehicle
        if math.isfinite(top):
            return float(top) + (
                ping.transducer_depth if math.isfinite(ping.transducer_depth) else 0.0
            )
        return _NO_DEPTH_OF_PRESSURE if stated else _NO_DEPTH

    return [of(*one) for one in zip(pings, by_pressure, vehicle_depth, strict=True)]
