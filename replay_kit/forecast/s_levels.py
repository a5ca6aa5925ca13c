"""Terrain-following levels (ROMS, CROCO): their depths, and velocities at fixed depths.

With s and C the stretched coordinate and its stretching, h the depth of the sea bed, hc the critical depth and zeta the surface,
transform 1 is z0 = hc (s - C) + C h, z = z0 + zeta (1 + z0 / h), and transform 2 is S = (hc s + C h) / (hc + h), z = zeta + (zeta + h) S,
with z upwards from the resting surface (Shchepetkin and McWilliams, Ocean Modelling, 2005).
"""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError

_NAMES = {
    "s": ("s_rho", "sc_r"),
    "c": ("Cs_r", "Cs_rho", "Cs"),
    "hc": ("hc",),
    "h": ("h",),
    "transform": ("Vtransform",),
}


@dataclass(frozen=True, slots=True, eq=False)
class SCoordinate:
    """What the depths of terrain-following levels follow from.

    Attributes:
        s: shape (Z,), -1 at the sea bed to 0.
        c: shape (Z,), the stretching.
        hc: Critical depth [m].
        h: Name of the variable of the sea bed's depth.
        transform: 1 or 2.
    """

    s: Array
    c: Array
    hc: float
    h: str
    transform: int

    def depths(self, h: Array, surface: Array) -> Array:
        """Return the depth of each level, shape (Z, J, I) [m], positive down.

        Args:
            h: Depth of the sea bed [m], shape (J, I).
            surface: Height of the surface [m], shape (J, I).
        """
        s, c = self.s[:, None, None], self.c[:, None, None]
        if self.transform == 1:
            at_rest = self.hc * (s - c) + c * h
            return -(at_rest + surface * (1.0 + at_rest / h))
        return -(surface + (surface + h) * (self.hc * s + c * h) / (self.hc + h))


def find_s_coordinate(ds: xr.Dataset, dim: str, where: str) -> SCoordinate | None:
    """Return the coordinate of a dimension of terrain-following levels; None for another dimension.

    Raises:
        ForecastError: It is one, but something is missing that its depths follow from.
    """
    found = {
        key: next((name for name in names if name in ds.variables), None)
        for key, names in _NAMES.items()
    }
    if found["c"] is None and dim not in _NAMES["s"]:
        return None
    if found["c"] is not None and dim not in ds[found["c"]].dims:
        return None
    missing = [_NAMES[key][0] for key, name in found.items() if name is None]
    if missing:
        raise ForecastError(
            f"{where}: {dim} numbers terrain-following levels, whose depths need {', '.join(missing)} too; give the file of the grid with "
            "--ensemble, or a file that holds them"
        )
    values = {
        key: np.asarray(ds[name].values, dtype=np.float64)
        for key, name in found.items()
        if name is not None and key != "h"
    }
    transform = int(values["transform"].ravel()[0])
    if transform not in (1, 2):
        raise ForecastError(f"{where}: Vtransform is {transform}; expected 1 or 2")
    return SCoordinate(
        values["s"].ravel(),
        values["c"].ravel(),
        float(values["hc"].ravel()[0]),
        str(found["h"]),
        transform,
    )


def at_depths(values: Array, depths: Array, bottom: Array, levels: Array) -> Array:
    """Return values at fixed depths, linear between levels, constant above the first and below the last down to the sea bed.

    Args:
        values: shape (..., Z, J, I).
        depths: Of the levels [m], shape (Z, J, I), in either order.
        bottom: Depth of the sea bed [m], shape (J, I); below it the result is NaN.
        levels: shape (L,) [m].
    """
    if depths[0].mean() > depths[-1].mean():
        values, depths = values[..., ::-1, :, :], depths[::-1]
    found = []
    for level in levels:
        above = np.clip((depths <= level).sum(axis=0) - 1, 0, depths.shape[0] - 2)
        upper, lower = (np.take_along_axis(depths, (above + k)[None], axis=0)[0] for k in (0, 1))
        share = np.clip((level - upper) / (lower - upper), 0.0, 1.0)
        index = np.broadcast_to(above, (*values.shape[:-3], 1, *above.shape))
        low, high = (np.take_along_axis(values, index + k, axis=-3)[..., 0, :, :] for k in (0, 1))
        found.append(np.where(level <= bottom, (1.0 - share) * low + share * high, np.nan))
    return np.stack(found, axis=-3)
