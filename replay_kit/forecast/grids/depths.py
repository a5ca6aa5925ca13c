"""Levels of a forecast: conversion of the depth axis to metres, selection, and interpolation between levels."""

from collections.abc import Iterable
from dataclasses import dataclass

import gsw
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Array, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.words.quantities import decibars, metres
from replay_kit.core.words.text import some_text, span_text

# Units and standard names (CF conventions, appendix D) of axes that number or scale the levels and hold no depth.
_DIMENSIONLESS = (
    "1",
    "level",
    "levels",
    "layer",
    "layers",
    "sigma",
    "sigma_level",
    "model_level",
    "model_levels",
)
_PARAMETRIC = (
    "model_level_number",
    "ocean_sigma_coordinate",
    "ocean_sigma_z_coordinate",
    "ocean_double_sigma_coordinate",
    "ocean_s_coordinate",
    "ocean_s_coordinate_g1",
    "ocean_s_coordinate_g2",
)
# Water this near to a level that has no other beside it, or above the first, has its current [m].
_NEAR = 15.0
_WANTED = "expected m, km, cm, ft or dbar"
_CONVERT = "convert the axis to metres, and set its attribute units to m"


def in_metres(axis: xr.DataArray, latitude: float, where: str) -> tuple[Array, tuple[str, ...]]:
    """Return the values of a depth axis in metres, with the file's own sign, and notes on their conversion.

    Args:
        axis: Coordinate, shape (Z,). Pressures are converted with TEOS-10 (``gsw.z_from_p``); an axis without a unit is taken to be
            in metres.
        latitude: Latitude of the region's centre [degrees north], for pressures.
        where: Name of the file, for messages.

    Raises:
        ForecastError: The unit is unknown, or the axis numbers levels or scales them by the water depth.
    """
    values = axis.values.astype(np.float64)
    unit = str(axis.attrs.get("units", "")).strip()
    if (length := metres(unit)) is not None:
        return values * length, ()
    if decibars(unit) == 1.0:
        # a file that counts upwards has negative pressures; TEOS-10 counts heights
        depths = np.sign(values) * np.abs(gsw.z_from_p(np.abs(values), latitude))
        note = f"coordinate {axis.name} is in {unit}: converted to metres with TEOS-10 at latitude {latitude:.2f}"
        return np.asarray(depths, dtype=np.float64), (note,)
    standard_name = str(axis.attrs.get("standard_name", ""))
    if (
        unit.lower() in _DIMENSIONLESS
        or standard_name in _PARAMETRIC
        or (not unit and "formula_terms" in axis.attrs)
    ):
        stated = f"units '{unit}'" if unit else "no units"
        if standard_name:
            stated += f" and standard name {standard_name}"
        raise ForecastError(
            f"{where}: coordinate {axis.name} has {stated}, so it holds model levels and no depths; {_WANTED}: interpolate the current to "
            "fixed depths in metres"
        )
    if unit:
        raise ForecastError(
            f"{where}: coordinate {axis.name} is in '{unit}'; {_WANTED}: {_CONVERT}"
        )
    return values, (f"coordinate {axis.name} states no unit, metres assumed",)


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Levels used of a file.

    Attributes:
        depth: Depths, increasing, shape (Z,) [m].
        position: Positions in the file.
        within: Range of depths that the levels of the file represent [m]; see ``depth_reach``.
        notes: Choices and assumptions.
    """

    depth: Array
    position: NDArray[np.int64]
    within: tuple[float, float]
    notes: tuple[str, ...]


def choose_levels(
    ds: xr.Dataset,
    dims: tuple[str | None, ...],
    config: ForecastConfig,
    latitude: float,
    where: str,
) -> Levels:
    """Return the levels to use; one at 0 m without a depth dimension.

    Args:
        ds: Dataset of the file.
        dims: Depth dimensions of u and v; None if absent.
        config: Requested levels; the nearest are used.
        latitude: Latitude of the region's centre [degrees north], for pressures.
        where: Name of the file, for messages.

    Raises:
        ForecastError: The file states no depths, other ones for u and v, or depths that are not distinct.
    """
    if dims[0] is None:
        return Levels(np.zeros(1), np.zeros(1, dtype=np.int64), reach_of(np.zeros(1)), ())
    values, notes = _depths(ds, dims[0], latitude, where)
    if (
        dims[1] is not None
        and dims[1] != dims[0]
        and not np.allclose(_depths(ds, dims[1], latitude, where)[0], values, rtol=1e-3)
    ):
        raise ForecastError(
            f"{where}: the depths of u ({dims[0]}) and v ({dims[1]}) differ; interpolate them to the same levels"
        )
    order = np.argsort(values, kind="stable")
    within = reach_of(values[order])
    if config.levels is not None:
        nearest = [int(np.argmin(np.abs(values[order] - wanted))) for wanted in config.levels]
        far = [wanted for wanted in sorted(config.levels) if not within[0] <= wanted <= within[1]]
        if far and values.size == np.isfinite(values).sum():
            notes += (
                f"no level of the file ({span_text(values + 0.0)} m) is near {depths_text(far)}: nearest level used",
            )
        order = order[np.unique(nearest)]
    levels = values[order]
    if not np.isfinite(levels).all() or levels[0] < 0.0 or np.any(np.diff(levels) <= 0.0):
        raise ForecastError(
            f"{where}: depths must be finite, distinct and below the surface, got {depths_text(levels)}; "
            "correct them or their attribute positive"
        )
    return Levels(levels, order, within, notes)


def reach_of(levels: Array) -> tuple[float, float]:
    """Return the range of depths [m] that levels represent, shape (Z,)."""
    least, greatest = depth_reach(levels)
    return float(least), float(greatest)


def depths_text(depths: Iterable[float]) -> str:
    """Return depths as text, such as ``500, 1000 m``."""
    return f"{some_text([f'{depth:.4g}' for depth in depths])} m"


_DEPTH_VARIABLES = ("depth", "Z", "zt", "z", "deptht", "lev", "RC", "z_t", "st_ocean")


def _depths(ds: xr.Dataset, dim: str, latitude: float, where: str) -> tuple[Array, tuple[str, ...]]:
    """Return the depths of a dimension [m], positive down, from its coordinate or a variable along it, and notes."""
    name = (
        dim
        if dim in ds.coords
        else next(
            (name for name in _DEPTH_VARIABLES if name in ds.variables and ds[name].dims == (dim,)),
            None,
        )
    )
    if (
        name is None
        and (
            edges := next((name for name in ds.variables if _bounds(ds[name], ds.sizes[dim])), None)
        )
        is not None
    ):
        values, notes = in_metres(ds[edges].astype(np.float64), latitude, where)
        return np.abs(values[:-1] + values[1:]) / 2.0, (
            *notes,
            f"levels of {dim} assumed midway between the interfaces {edges}",
        )
    if name is None:
        raise ForecastError(
            f"{where}: dimension {dim} has no coordinate values; add a depth coordinate in metres, or give the file of the grid"
        )
    values, notes = in_metres(ds[name], latitude, where)
    if ds[name].attrs.get("positive", "").lower() == "up" or np.all(values <= 0.0):
        values = -values
    return values, notes


def _bounds(variable: xr.DataArray, levels: int) -> bool:
    """Return whether a variable holds the depths of the interfaces between ``levels`` levels."""
    return (
        variable.ndim == 1
        and variable.size == levels + 1
        and "dep" in str(variable.name).lower()
        and variable.dtype.kind in "iuf"
    )


def depth_reach(depths: Array, surface: Array | float = 0.0) -> tuple[Array, Array]:
    """Return the least and greatest depth that levels represent [m], each of the shape of one level.

    One level represents 15 m on either side. Several begin at the surface if the first lies within 15 m or half the first spacing of it,
    otherwise at the first; they end half the last spacing below the last.

    Args:
        depths: Depths, increasing, shape (Z, ...) [m].
        surface: Sea surface height [m]; levels that move with it also represent their depths at rest.
    """
    moved = np.abs(surface) + 1e-6 * depths[-1]
    if len(depths) == 1:
        return depths[0] - _NEAR - moved, depths[0] + _NEAR + moved
    first, last = 0.5 * (depths[1] - depths[0]), 0.5 * (depths[-1] - depths[-2])
    # levels in the middle of layers of one thickness lie at half the spacing but for rounding
    to_surface = depths[0] + surface <= np.maximum(1.001 * first, _NEAR)
    return np.where(to_surface, -np.inf, depths[0] - moved), depths[-1] + last + moved


def at_depths(
    values: Values, depths: Values, within: tuple[Array | float, Array | float], wanted: Array
) -> Values:
    """Return values at fixed depths, shape (..., L, J, I): linear between levels, constant beyond the ends, NaN out of reach.

    Args:
        values: Values on levels, shape (..., Z, J, I).
        depths: Depths of the levels [m], shape (Z, J, I) or (Z, 1, 1), increasing.
        within: Least and greatest depth that the levels represent [m], shape (J, I) each or a number; see ``depth_reach``.
        wanted: Fixed depths, shape (L,) [m].
    """
    depths = np.broadcast_to(depths, values.shape[-3:])
    found, last = [], len(depths) - 1
    for depth in wanted:
        upper = np.clip((depths <= depth).sum(axis=0) - 1, 0, max(last - 1, 0))
        pair = [np.minimum(upper + k, last)[None] for k in (0, 1)]
        above, below = (np.take_along_axis(depths, index, axis=0)[0] for index in pair)
        share = np.clip((depth - above) / np.where(below > above, below - above, 1.0), 0.0, 1.0)
        low, high = (
            np.take_along_axis(
                values, np.broadcast_to(index, (*values.shape[:-3], *index.shape)), axis=-3
            )[..., 0, :, :]
            for index in pair
        )
        # a weight of zero on a dry level leaves the other as it is
        mixed = np.where(
            share == 0.0, low, np.where(share == 1.0, high, (1.0 - share) * low + share * high)
        )
        found.append(np.where((within[0] <= depth) & (depth <= within[1]), mixed, np.nan))
    return np.stack(found, axis=-3).astype(values.dtype, copy=False)
