"""The map: the current and its standard error at a depth, the track, surfacings, the plan."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.colors import PRINT
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic, unwrap_longitude
from replay_kit.core.text import time_text
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.history import typical_depth
from replay_kit.results.views.slices import CurrentSlices, slices_of
from replay_kit.show.figures.in_print import draw_mark
from replay_kit.show.figures.map_layers import (
    contour_step,
    drawn_layers,
    dry_text,
)
from replay_kit.show.figures.on_canvas import Extent
from replay_kit.show.figures.values import Layer, Mark
from replay_kit.show.numbers import nice
from replay_kit.show.plots.panel import (
    CONTOUR_LABEL,
    Chosen,
    Panel,
    Panels,
    colorbar,
    colormap,
    missing,
)

# Most arrows along the longer side of a map.
_ARROWS = 24
# Of fewer arrows side by side each is still no longer than this share of the width.
_FEW = 10.0
#: Between the axes and the title of a map with a key of its arrows [points]; of that the gap below the title.
ABOVE_KEY, _TITLE = 13.0, 3.0


def map_panels(contents: Contents, chosen: Chosen) -> Panels:
    """Return the current and its standard error on a map, with the track.

    Args:
        contents: Of the result.
        chosen: Place, depth and time.

    Raises:
        ConfigError: Nothing was published before the time.
    """
    slices = slices_at(contents, chosen)
    notes = list(contents.notes)
    if contents.estimate is None and chosen.time_ns is None and slices is not None:
        notes.append("The result holds no estimate: the map shows the last published current.")
    if slices is None and contents.track.time_ns.size == 0:
        also = "; the figure plan shows its plan." if contents.last_plan is not None else "."
        return Panels(
            [missing("Map", f"The result holds neither a current nor a position{also}")],
            notes=notes,
        )
    if slices is None:
        notes.append("The result holds no current: the map shows only positions.")
        return Panels(
            [Panel("track", partial(_marks, contents, None, chosen), 0.8, shares_legend=True)],
            1,
            notes,
        )
    asked, shown = chosen.depth if chosen.at is None else chosen.at[2], float(slices.depths[0])
    if asked not in (None, shown):
        notes.append(f"Requested depth: {asked:g} m; nearest published depth: {shown:g} m.")
    depth, time = f"{shown:g} m", time_text(int(slices.time_ns[-1]))[:16]
    panels = [
        Panel(
            f"{depth}, {time}",
            partial(_current, contents, slices, chosen),
            _height(slices),
            True,
            ABOVE_KEY,
        )
    ]
    if np.isfinite(slices.fields[0, -1, 2:]).any():
        panels.append(
            replace(
                panels[0], title="standard error", draw=partial(_error, contents, slices, chosen)
            )
        )
    else:
        notes.append("The current has no standard error.")
    notes += without_current(slices)
    return Panels(panels, 2, notes)


def slices_at(contents: Contents, chosen: Chosen) -> CurrentSlices | None:
    """Return the current at one depth, last or at a time: that of the estimate, or the published slice nearest in depth.

    Raises:
        ConfigError: Nothing was published before the time.
    """
    published, time_ns = contents.slices, chosen.time_ns
    depth = chosen.at[2] if chosen.at is not None else chosen.depth
    if depth is None:
        measured = contents.measured.innovations["depth"].to_numpy(np.float64)
        depth = typical_depth(published, measured)
    if contents.estimate is not None and time_ns is None:
        return slices_of(contents.estimate, np.array([depth]))
    if published is None:
        return None
    k, times = int(np.argmin(np.abs(published.depths - depth))), published.time_ns
    end = times.size if time_ns is None else int(np.searchsorted(times, time_ns, "right"))
    if time_ns is not None and end == 0:
        said = f"{time_text(time_ns)}; the first is of {time_text(int(times[0]))}"
        raise ConfigError(f"--time: no current was published before {said}")
    return replace(
        published,
        depths=published.depths[k : k + 1],
        time_ns=times[end - 1 : end],
        fields=published.fields[k : k + 1, end - 1 : end],
    )


def without_current(slices: CurrentSlices, around: tuple[Array, Array] | None = None) -> list[str]:
    """Return what is grey on a map of slices and what is hatched, as sentences.

    Args:
        slices: The slices.
        around: Ends in east and in north [m] of what is shown; None for the slices alone.
    """
    axes, shown, beyond = (slices.east, slices.north), [], False
    for axis, ends in zip(axes, axes if around is None else around, strict=True):
        half = 0.5 * (axis[1] - axis[0])
        shown.append((axis > ends[0] - half) & (axis < ends[-1] + half))
        beyond |= bool(ends[0] < axis[0] - half or ends[-1] > axis[-1] + half)
    grey, hatched = (cells[np.ix_(shown[1], shown[0])].any() for cells in _blank(slices))
    return [
        *([f"Grey: {dry_text(slices)}."] if grey else []),
        *(["Hatched: outside the forecast."] if hatched or beyond else []),
    ]


def degrees(contents: Contents, east: Array, north: Array) -> tuple[Array, Array]:
    """Return longitude, continuous about the centre of the region, and latitude [degrees] of local points [m]."""
    longitude, latitude = to_geographic(contents.projection, east, north)
    return unwrap_longitude(longitude, contents.projection.longitude), latitude


def draw_speed(
    contents: Contents, slices: CurrentSlices, axes: Axes, across: float | None = None
) -> None:
    """Draw speed, arrows, land and coast of one slice.

    Args:
        contents: Of the result.
        slices: The slice, at one depth.
        axes: In degrees.
        across: Width of what is shown [m]; None for the whole slice.
    """
    u, v = slices.fields[0, -1, :2]
    _field(contents, slices, np.hypot(u, v), axes, ("speed", "speed [m s$^{-1}$]"))
    step = -(-max(u.shape) // _ARROWS)
    half = (slice((step - 1) // 2, None, step),) * 2
    east, north = np.meshgrid(slices.east, slices.north)
    longitude, latitude = degrees(contents, east, north)
    true_u, true_v = rotate_to_geographic(contents.projection, longitude, latitude, u, v)
    typical = float(np.nanquantile(np.hypot(u, v), 0.95)) if np.isfinite(u).any() else 1.0
    width = slices.east[-1] - slices.east[0] if across is None else across
    cells = max(width / (step * (slices.east[1] - slices.east[0])), _FEW)
    look: Any = {
        "color": PRINT["ink"],
        "edgecolor": "white",
        "linewidth": 0.3,
        "width": 0.0045,
        "minlength": 0.5,
        "pivot": "mid",
    }
    at = (longitude[half], latitude[half], true_u[half], true_v[half])
    look["scale"] = 0.75 * cells * max(typical, 1e-6)
    axes.quiver(*at, zorder=2.0, **look)
    # the key, between the axes and the title however high the axes are
    shown, above = (
        nice(0.6 * max(typical, 1e-6)),
        ScaledTranslation(0.0, 0.5 * (ABOVE_KEY - _TITLE) / 72.0, axes.figure.dpi_scale_trans),
    )
    place: Any = {"transform": axes.transAxes + above, "clip_on": False}
    axes.quiver([1.0], [1.0], [shown], [0.0], **place, **(look | {"pivot": "tip"}))
    axes.text(
        0.985 - shown / look["scale"],
        1.0,
        f"{shown:g} m s$^{{-1}}$",
        ha="right",
        va="center",
        fontsize=6.0,
        **place,
    )


def frame(axes: Axes) -> None:
    """Give a map axes in degrees, at the scale of its middle latitude."""
    south, north = axes.get_ylim()
    axes.set_aspect(
        1.0 / max(np.cos(np.deg2rad(np.clip(0.5 * (south + north), -89.0, 89.0))), 0.02)
    )
    axes.locator_params(axis="x", nbins=4)
    axes.locator_params(axis="y", nbins=3)
    axes.xaxis.set_major_formatter(
        lambda value, _: _degrees_text((value + 180.0) % 360.0 - 180.0, "EW")
    )
    axes.yaxis.set_major_formatter(lambda value, _: _degrees_text(value, "NS"))


def draw_layers(contents: Contents, axes: Axes, *layers: Layer) -> None:
    """Draw layers of marks.

    Args:
        contents: Of the result.
        axes: In degrees.
        layers: From the lowest to the highest.
    """

    def place(east: Array, north: Array) -> tuple[Array, Array]:
        return degrees(contents, 1e3 * east, 1e3 * north)

    for layer in layers:
        for mark in layer.marks:
            draw_mark(axes, mark, layer.tables, place)


def draw_seabed(contents: Contents, axes: Axes) -> None:
    """Draw contours of the depth of the bottom into axes in degrees that have their limits; nothing without a bathymetry."""
    seabed = contents.seabed
    if seabed is None:
        return
    x, y = degrees(contents, *np.meshgrid(seabed.east, seabed.north))
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    # only of what is seen, so that labels are in sight
    shown = np.where((x >= west) & (x <= east) & (y >= south) & (y <= north), seabed.depth, np.nan)
    span = float(np.ptp(shown[np.isfinite(shown)])) if np.isfinite(shown).any() else 0.0
    if span > 0.0:
        step = contour_step(span)
        levels = np.arange(np.ceil(np.nanmin(shown) / step) * step, float(np.nanmax(shown)), step)
        lines = axes.contour(
            x,
            y,
            np.ma.masked_invalid(shown),
            levels=levels[levels > 0.0],
            colors=PRINT["ink"],
            linewidths=0.4,
            alpha=0.7,
        )
        for text in axes.clabel(lines, fontsize=5.0, fmt="%g m"):
            text.set_gid(CONTOUR_LABEL)


def _current(contents: Contents, slices: CurrentSlices, chosen: Chosen, axes: Axes) -> None:
    draw_speed(contents, slices, axes)
    _marks(contents, slices, chosen, axes)


def _error(contents: Contents, slices: CurrentSlices, chosen: Chosen, axes: Axes) -> None:
    error = np.sqrt(0.5 * (slices.fields[0, -1, 2] ** 2 + slices.fields[0, -1, 3] ** 2))
    _field(contents, slices, error, axes, ("amp", "standard error [m s$^{-1}$]"))
    _marks(contents, slices, chosen, axes)


def _marks(contents: Contents, slices: CurrentSlices | None, chosen: Chosen, axes: Axes) -> None:
    at, end = chosen.at, chosen.time_ns
    if slices is None:
        _widen(contents, axes)
    draw_seabed(contents, axes)
    layers = drawn_layers(contents, end_ns=end)
    draw_layers(contents, axes, *(layer for _, layer in layers))
    if at is not None:
        x = np.array([float(unwrap_longitude(at[0], contents.projection.longitude))])
        star: Any = {"color": "#ffffff", "symbol": "star", "size": 18.0, "edge": "ink"}
        draw_mark(axes, Mark("points", x, np.array([at[1]]), "requested place", **star), {})
    frame(axes)


def _field(
    contents: Contents, slices: CurrentSlices, values: Array, axes: Axes, look: tuple[str, str]
) -> None:
    """Draw values of cells, with land and coast, and a colour bar."""
    east, north = np.meshgrid(_edges(slices.east), _edges(slices.north))
    longitude, latitude = degrees(contents, east, north)
    known = values[np.isfinite(values)]
    most = float(known.max()) if known.size and known.max() > 0.0 else 1.0
    # where nothing is drawn is outside the forecast, also beyond the cells
    axes.patch.set(facecolor="white", edgecolor=PRINT["soft"], hatch="//////", linewidth=0.0)
    axes.pcolormesh(
        longitude,
        latitude,
        np.where(_blank(slices)[0], 1.0, np.nan),
        cmap=ListedColormap([PRINT["land"]]),
        rasterized=True,
    )
    colors: Any = {"cmap": colormap(look[0]), "vmin": 0.0, "vmax": most, "rasterized": True}
    centres = degrees(contents, *np.meshgrid(slices.east, slices.north))
    # beside missing cells there is nothing to interpolate with
    if known.size == values.size:
        mesh = axes.pcolormesh(*centres, values, shading="gouraud", **colors)
    else:
        mesh = axes.pcolormesh(longitude, latitude, np.ma.masked_invalid(values), **colors)
    colorbar(axes, mesh, look[1])
    axes.set(xlim=(centres[0].min(), centres[0].max()), ylim=(centres[1].min(), centres[1].max()))


def _blank(slices: CurrentSlices) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which cells without a current are dry, or not known to be anything else, and which lie off the forecast's grid."""
    missing = ~np.isfinite(slices.fields[0, -1, 0])
    outside = np.zeros_like(missing) if slices.outside is None else slices.outside
    return missing & ~outside, outside


def _widen(contents: Contents, axes: Axes) -> None:
    """Give a map of positions alone a least width: one position has none."""
    show_extent(
        contents, axes, Extent.around(contents.track.east / 1e3, contents.track.north / 1e3, 0.05)
    )


def show_extent(contents: Contents, axes: Axes, extent: Extent) -> None:
    """Give a map in degrees the limits of an extent."""
    west, east, south, north = (1e3 * end for end in extent.ends)
    x, y = degrees(contents, *np.meshgrid([west, east], [south, north]))
    axes.set(xlim=(x.min(), x.max()), ylim=(y.min(), y.max()))


def _height(slices: CurrentSlices) -> float:
    """Return the height of a panel over its width, with room for a map's labels, key and colour bar."""
    shape = (slices.north[-1] - slices.north[0]) / (slices.east[-1] - slices.east[0])
    return float(np.clip(0.72 * shape + 0.18, 0.4, 1.2))


def _edges(centres: Array) -> Array:
    half = 0.5 * (centres[1] - centres[0])
    return np.append(centres - half, centres[-1] + half)


def _degrees_text(value: float, letters: str) -> str:
    letter = "" if abs(value) < 1e-9 else letters[0] if value > 0.0 else letters[1]
    return f"{abs(float(f'{value:.6g}')):g}°{letter}"
