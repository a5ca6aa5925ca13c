"""Terrain-following levels (ROMS, CROCO, sigma, heights at each node): depths, and interpolation of velocities to fixed depths.

A level lies at a share of the water: z = zeta + (h + zeta) share, with z upwards from the surface at rest, h the depth of the sea bed and
zeta the surface. ROMS' share follows from s and C, the stretched coordinate and its stretching, and hc, the critical depth. Transform 1:
(hc (s - C) + C h) / h. Transform 2: (hc s + C h) / (hc + h) (Shchepetkin and McWilliams, Ocean Modelling, 2005).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.words.text import count_text, span_text
from replay_kit.forecast.field import Field
from replay_kit.forecast.grids.depths import Levels, at_depths, depth_reach, depths_text, reach_of
from replay_kit.forecast.grids.layout import CENTRE, Layout
from replay_kit.forecast.members.rules import WARNING, no_water
from replay_kit.forecast.names import SHARE
from replay_kit.forecast.variables import read_variable

#: Begins the note on water that no level is near.
LEFT_DRY = "left dry: "

_NAMES = {
    "s": ("s_rho", "sc_r"),
    "C": ("Cs_r", "Cs_rho", "Cs"),
    "hc": ("hc",),
    "h": ("h",),
    "Vtransform": ("Vtransform",),
}


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Depths of terrain-following levels.

    Attributes:
        name: Variable of the sea bed.
        bed: Depth of the sea bed [m], shape (J, I).
        share: Share of the water above each level, from -1 at the sea bed to 0, shape (E or 1, Z, J, I).
        surface: Sea surface height of each member or of all [m], shape (E or 1, J, I); None for a surface at rest.
        how: Origin of the share as text.
    """

    name: str
    bed: Array
    share: Array
    surface: Array | None
    how: str

    @property
    def at_rest(self) -> Array:
        """Depth of each level below a surface at rest, shape (Z, J, I) [m]."""
        return np.asarray(-self.bed * self.share[0])

    def of_member(self, k: int) -> tuple[Array, Array]:
        """Return the depth of each level, shape (Z, J, I) [m], and the surface's height, shape (J, I), of a member."""
        surface = np.zeros((1, *self.bed.shape)) if self.surface is None else self.surface
        height, share = (each[min(k, len(each) - 1)] for each in (surface, self.share))
        return -(height + (self.bed + height) * share), height


def follows_terrain(ds: xr.Dataset, dim: str | None) -> bool:
    """Return whether a dimension numbers terrain-following levels."""
    stated = [name for name in (*_NAMES["C"], SHARE) if name in ds.variables]
    return any(dim in ds[name].dims for name in stated) or (not stated and dim in _NAMES["s"])


def read_terrain(field: Field, layout: Layout, surface: Array | None) -> Terrain:
    """Return the depths of the levels in the used part of a file.

    Args:
        field: Members of the file.
        layout: Used part of the file.
        surface: Sea surface height [m], shape (E or 1, J, I); None if absent.

    Raises:
        ForecastError: A variable that defines the depths is missing.
    """
    ds, names = field.ds, _NAMES
    if SHARE in ds.variables:
        names = {"h": _NAMES["h"]}
    found = {
        key: next((name for name in some if name in ds.variables), "")
        for key, some in names.items()
    }
    missing = [names[key][0] for key, name in found.items() if not name]
    if missing:
        dim, _ = layout.levels[CENTRE]
        raise ForecastError(
            f"{field.where}: {dim} numbers terrain-following levels, whose depths need {', '.join(missing)} too; give the grid: --ensemble"
        )
    name = found.pop("h")
    bed = read_variable(field, layout, name)[0, 0].astype(np.float64)
    surface = None if surface is None else np.nan_to_num(surface)
    if SHARE in ds.variables:
        share = read_variable(field, layout, SHARE).astype(np.float64)
        return Terrain(name, bed, share, surface, "sigma")
    s, c, hc, transform = (
        np.asarray(ds[variable].values, np.float64).reshape(-1, 1, 1) for variable in found.values()
    )
    number, hc = int(transform[0, 0, 0]), hc[:1]
    if number not in (1, 2):
        raise ForecastError(f"{field.where}: Vtransform is {number}; expected 1 or 2")
    # columns on land may have a depth of 0
    with np.errstate(invalid="ignore", divide="ignore"):
        first, second = (hc * (s - c) + c * bed) / bed, (hc * s + c * bed) / (hc + bed)
    share = (first if number == 1 else second)[None]
    return Terrain(name, bed, share, surface, f"transform {number}")


def from_s_levels(
    velocity: Values, terrain: Terrain, wanted: Sequence[float] | None, where: str
) -> tuple[Values, Levels]:
    """Return velocities at fixed depths, shape (E, 2, L, J, I), and these depths.

    Args:
        velocity: Velocities on levels, shape (E, 2, Z, J, I); NaN on land.
        terrain: Depths of the levels.
        wanted: Fixed depths [m]; None for those of the deepest column.
        where: The file, for messages.

    Raises:
        ForecastError: No column has a current and a sea bed, or no level is near the first depth.
    """
    # what stands for the depth of land differs: NaN, 0, the least depth of the water, a fill value
    water = np.isfinite(velocity).any(axis=(0, 1, 2))
    if not water.any():
        raise no_water(where)
    water &= terrain.bed > 0.0
    if not water.any():
        raise ForecastError(
            f"{where}: no column has both a current and a depth of the sea bed ({terrain.name}) above 0; check the region and the "
            "variables' missing values"
        )
    bed = np.where(water, terrain.bed, np.nan)
    terrain = replace(terrain, bed=bed)
    at_rest = np.sort(terrain.at_rest.reshape(velocity.shape[2], -1)[:, np.nanargmax(bed)])
    levels = at_rest if wanted is None else np.unique(np.asarray(wanted, dtype=np.float64))
    ends = at_rest.size > 1 and np.nanmax(bed) - at_rest[-1] < 1.001 * (at_rest[-1] - at_rest[-2])
    found, beyond = _at_depths(velocity, terrain, levels, bool(ends))
    span = f"those of the file ({span_text(at_rest)} m in the deepest column)"
    if beyond[0].any() and not np.isfinite(found[:, :, 0]).any():
        raise ForecastError(
            f"{where}: no level is near {levels[0]:g} m, the first asked for; choose --levels from {span}"
        )
    chosen = "those of the deepest column at rest" if wanted is None else "the levels asked for"
    levels_of_member = (
        "a surface at rest, as the file holds no zeta"
        if terrain.surface is None
        else "its own surface"
    )
    notes = [
        f"terrain-following levels ({terrain.how}) interpolated to fixed depths, {chosen}; each member with {levels_of_member}"
    ]
    if beyond.any():
        dry = count_text(int(beyond.sum()), "point")
        warning = WARNING if reach_of(at_rest)[0] > 0.0 else ""
        notes.append(
            f"{warning}{LEFT_DRY}{dry} in the water at {depths_text(levels[beyond.any(axis=(1, 2))])}: no level is near, of {span}"
        )
    return found, Levels(levels, np.arange(at_rest.size), reach_of(at_rest), tuple(notes))


def _at_depths(
    velocity: Values, terrain: Terrain, levels: Array, ends_at_bed: bool
) -> tuple[Values, NDArray[np.bool_]]:
    """Return velocities at fixed depths, and the mask of water without a near level, shape (L, J, I)."""
    h, at = terrain.bed, levels[:, None, None]
    found, beyond = [], np.zeros((levels.size, *h.shape), dtype=bool)
    means = np.nanmean(terrain.at_rest, axis=(1, 2))
    down = slice(None, None, -1 if means[0] > means[-1] else 1)
    for k, field in enumerate(velocity):
        depths, height = terrain.of_member(k)
        top, bottom = depth_reach(depths[down], height)
        bottom = h if ends_at_bed else np.minimum(bottom, h)
        found.append(at_depths(field[:, down], depths[down], (top, bottom), levels))
        beyond |= (at <= h) & ~((top <= at) & (at <= bottom))
    return np.stack(found), beyond
