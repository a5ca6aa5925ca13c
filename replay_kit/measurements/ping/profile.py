"""An ADCP ping in earth coordinates to the bins of a profile of the current."""

from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation import Reference
from replay_kit.measurements.ping.adcp_ping import AdcpPing
from replay_kit.measurements.vehicle.pressure import depth_of_pressure


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """A ping's bins, before its position is known.

    Attributes:
        depth: shape (n,) [m], positive down.
        distance: shape (n,) [m], vertical, from the transducer to the bins' centres.
        transducer_depth: [m], positive down.
        velocity: shape (n, 2) [m/s], true east and north; NaN where missing.
        error_std: shape (n,) [m/s].
        reference: What the velocity is relative to.
    """

    depth: Array
    distance: Array
    transducer_depth: float
    velocity: Array
    error_std: Array
    reference: Reference


def profile_of(ping: AdcpPing, vehicle_depth: float, latitude: float, config: MeasurementConfig) -> Profile:
    """Return the profile that an earth-coordinates ping holds.

    The transducer is at the depth of the ping's pressure, or at the vehicle's where the ping has none, plus
    ``transducer_depth``.

    Args:
        ping: The ping.
        vehicle_depth: [m], from other messages; used when the ping has no pressure. NaN when unknown.
        latitude: [degrees north], for pressure to depth.
        config: The error of bins whose ping states none.

    Raises:
        MeasurementError: The depth of the transducer is not known.
    """
    top = _transducer_depth(ping, vehicle_depth, latitude)
    with np.errstate(over="ignore", invalid="ignore"):
        depth = top + (-1.0 if ping.orientation == "up" else 1.0) * ping.distance
    depth = np.where(np.isfinite(depth), depth, np.nan)
    error_std = np.where(np.isfinite(ping.velocity_std), ping.velocity_std, config.velocity_std)
    return Profile(depth, ping.distance, top, ping.velocity[:, :2], error_std, ping.reference)


def _transducer_depth(ping: AdcpPing, vehicle_depth: float, latitude: float) -> float:
    """Return the depth of the transducer [m]."""
    stated = np.isfinite(ping.pressure)
    top = depth_of_pressure(ping.pressure, latitude) if stated else vehicle_depth
    if not np.isfinite(top):
        if not stated:
            raise MeasurementError("ping: its instrument's depth is not a number, and no earlier message gives the vehicle's depth")
        raise MeasurementError("ping: no depth has the pressure it states [dbar]")
    return top + (ping.transducer_depth if np.isfinite(ping.transducer_depth) else 0.0)
