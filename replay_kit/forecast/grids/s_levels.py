"""Terrain-following levels (ROMS, CROCO): depths, and interpolation of velocities to fixed depths.

Symbols: s and C the stretched coordinate and its stretching, h the depth of the sea bed, hc the critical depth, zeta the surface, z
upwards from the surface at rest. Transform 1: z0 = hc (s - C) + C h, z = z0 + zeta (1 + z0 / h). Transform 2:
S = (hc s + C h) / (hc + h), z = zeta + (zeta + h) S (Shchepetkin and McWilliams, Ocean Modelling, 2005).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.text import count_text, span_text
from replay_kit.forecast.grids.depths import Levels, at_depths, depths_text, reach, reach_of
from replay_kit.forecast.members.rules import WARNING, no_water

#: Begins the note on water that no level is near.
LEFT_DRY = "left dry: "

_NAMES = {
    "s": ("s_rho", "sc_r"),
    "c": ("Cs_r", "Cs_rho", "Cs"),
    "hc": ("hc",),
    "h": ("h",),
    "transform": ("Vtransform",),
}


@dataclass(frozen=True, slots=True, eq=False)
class SCoordinate:
    """Vertical coordinate of terrain-following levels.

    Attributes:
        s: Stretched coordinate, from -1 at the sea bed to 0, shape (Z,).
        c: Stretching, shape (Z,).
        hc: Critical depth [m].
        h: Name of the variable of the sea bed's depth.
        transform: Number of the transform, 1 or 2.
    """

    s: Array
    c: Array
    hc: float
    h: str
    transform: int

    @property
    def ends_at_sea_bed(self) -> bool:
        """Whether the deepest level represents the water down to the sea bed."""
        s = np.sort(self.s)
        return bool(s.size > 1 and 1.0 + s[0] < 1.001 * (s[1] - s[0]))

    def depths(self, h: Array, surface: Array) -> Array:
        """Return the depth of each level, shape (Z, J, I) [m], positive down, in the order of s.

        Args:
            h: Depth of the sea bed [m], shape (J, I).
            surface: Sea surface height [m], shape (J, I).
        """
        s, c = self.s[:, None, None], self.c[:, None, None]
        if self.transform == 1:
            at_rest = self.hc * (s - c) + c * h
            return -(at_rest + surface * (1.0 + at_rest / h))
        return -(surface + (surface + h) * (self.hc * s + c * h) / (self.hc + h))


def find_s_coordinate(ds: xr.Dataset, dim: str, where: str) -> SCoordinate | None:
    """Return the coordinate of a dimension of terrain-following levels; None for another dimension.

    Raises:
        ForecastError: A variable that defines the depths of its levels is missing.
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


def from_s_levels(
    velocity: Values,
    coordinate: SCoordinate,
    h: Array,
    sea_level: Array | None,
    wanted: Sequence[float] | None,
    where: str,
) -> tuple[Values, Levels]:
    """Return velocities at fixed depths, shape (E, 2, L, J, I), and these depths.

    Args:
        velocity: Velocities on levels, shape (E, 2, Z, J, I); NaN on land.
        coordinate: Coordinate of the levels.
        h: Depth of the sea bed [m], shape (J, I); ignored on land.
        sea_level: Sea surface height [m], shape (E or 1, J, I); None for a surface at rest.
        wanted: Fixed depths [m]; None for those of the deepest column.
        where: The file, for messages.

    Raises:
        ForecastError: No column has a current and a sea bed, or no level is near the first depth.
    """
    # what stands for the depth of land differs: NaN, 0, the least depth of the water, a fill value
    water = np.isfinite(velocity).any(axis=(0, 1, 2))
    if not water.any():
        raise no_water(where)
    water &= h > 0.0
    if not water.any():
        raise ForecastError(
            f"{where}: no column has both a current and a depth of the sea bed ({coordinate.h}) above 0; check the region and the "
            "variables' missing values"
        )
    h = np.where(water, h, np.nan)
    at_rest = np.sort(
        coordinate.depths(h, np.zeros_like(h)).reshape(coordinate.s.size, -1)[:, np.nanargmax(h)]
    )
    levels = at_rest if wanted is None else np.unique(np.asarray(wanted, dtype=np.float64))
    surface = np.zeros((1, *h.shape)) if sea_level is None else np.nan_to_num(sea_level)
    found, beyond = _at_depths(velocity, coordinate, h, surface, levels)
    span = f"those of the file ({span_text(at_rest)} m in the deepest column)"
    if beyond[0].any() and not np.isfinite(found[:, :, 0]).any():
        raise ForecastError(
            f"{where}: no level is near {levels[0]:g} m, the first asked for; choose --levels from {span}"
        )
    chosen = "those of the deepest column at rest" if wanted is None else "the levels asked for"
    own = (
        "its own surface"
        if sea_level is not None
        else "a surface at rest, as the file holds no zeta"
    )
    notes = [
        f"terrain-following levels (transform {coordinate.transform}) interpolated to fixed depths, {chosen}; each member with {own}"
    ]
    if beyond.any():
        dry = count_text(int(beyond.sum()), "point")
        warning = WARNING if reach_of(at_rest)[0] > 0.0 else ""
        notes.append(
            f"{warning}{LEFT_DRY}{dry} in the water at {depths_text(levels[beyond.any(axis=(1, 2))])}: no level is near, of {span}"
        )
    return found, Levels(levels, np.arange(coordinate.s.size), reach_of(at_rest), tuple(notes))


def _at_depths(
    velocity: Values, coordinate: SCoordinate, h: Array, surface: Array, levels: Array
) -> tuple[Values, NDArray[np.bool_]]:
    """Return velocities at fixed depths, and the mask of water without a near level, shape (L, J, I)."""
    # s says which level is the upper one, as the depths of columns on land may be none
    down = slice(None, None, -1) if coordinate.s[0] < coordinate.s[-1] else slice(None)
    found, at, beyond = [], levels[:, None, None], np.zeros((levels.size, *h.shape), dtype=bool)
    for k, field in enumerate(velocity):
        height = surface[min(k, surface.shape[0] - 1)]
        depths = coordinate.depths(h, height)[down]
        top, bottom = reach(depths, height)
        bottom = h if coordinate.ends_at_sea_bed else np.minimum(bottom, h)
        found.append(at_depths(field[:, down], depths, (top, bottom), levels))
        beyond |= (at <= h) & ~((top <= at) & (at <= bottom))
    return np.stack(found), beyond
