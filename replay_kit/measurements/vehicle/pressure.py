"""Pressure to depth."""

import gsw
import numpy as np

from replay_kit.core.arrays import Array

# degrees; gravity there is the mean of the equator's and the pole's, so that a depth is off by 0.27 % at most
_LATITUDE_ASSUMED = 45.0


def depths_of_pressures(pressure_dbar: Array, latitude: Array) -> Array:
    """Return the depths at sea pressures, shape (n,) [m], as ``depth_of_pressure`` gives each.

    Args:
        pressure_dbar: shape (n,) [dbar].
        latitude: shape (n,) [degrees north].
    """
    with np.errstate(all="ignore"):
        depth = -gsw.z_from_p(pressure_dbar, latitude)
    return np.where(np.isfinite(depth), depth, np.nan)


def depth_of_pressure(pressure_dbar: float, latitude: float | None) -> float:
    """Return the depth at a sea pressure [m]; NaN for a pressure that has none.

    Args:
        pressure_dbar: Sea pressure [dbar], 0 at the surface.
        latitude: [degrees north]; None when none is known yet, for which 45 degrees are taken.

    References:
        TEOS-10, through gsw, for standard salinity and 0 degrees Celsius.
    """
    with np.errstate(all="ignore"):
        depth = float(
            -gsw.z_from_p(pressure_dbar, _LATITUDE_ASSUMED if latitude is None else latitude)
        )
    return depth if np.isfinite(depth) else float("nan")
