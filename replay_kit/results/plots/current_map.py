"""The map: the current and its standard error at a depth, the track, surfacings, the plan."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic, unwrap_longitude
from replay_kit.core.text import time_text
from replay_kit.results.plots.panel import Panel, Panels, missing
from replay_kit.results.plots.style import FIRST, FOURTH, INK, LAND, SECOND, colorbar, colormap
from replay_kit.results.report.sections.map_frame import coastline
from replay_kit.results.report.sections.map_hazards import contour_step
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.series import typical_depth
from replay_kit.results.views.slices import CurrentSlices, slices_of
from replay_kit.results.views.surfacings import outlines_of

#: A place: longitude, latitude [degrees] and depth [m].
At = tuple[float, float, float]
# Most arrows along the longer side of a map; degrees between meridians; the least width of a map [degrees of latitude].
_ARROWS, _LEAST = 24, 0.02
# Of fewer arrows side by side each is still no longer than this share of the width.
_FEW = 10.0
_HALO: Any = {"color": "white", "linewidth": 2.2, "solid_capstyle": "round"}


def map_panels(contents: Contents, at: At | None) -> Panels:
    """Return the current and its standard error on a map, with the track.

    Args:
        contents: Of the result.
        at: Its depth is that of the map, and its place is marked; None for a depth that is typical of the measurements.
    """
    slices = slices_at(contents, at)
    notes = list(contents.notes)
    if contents.estimate is None and slices is not None:
        notes.append("The result holds no estimate: the map shows the last published current.")
    if slices is None and contents.track.time_ns.size == 0:
        also = "; the figure plan shows its plan." if contents.last_plan is not None else "."
        return Panels(
            [missing("Map", f"The result holds neither a current nor a position{also}")],
            notes=notes,
        )
    if slices is None:
        notes.append("The result holds no current: the map shows positions alone.")
        return Panels([Panel("track", partial(_marks, contents, None, at), 0.8)], 1, notes)
    depth, time = f"{slices.depths[0]:g} m", time_text(int(slices.time_ns[-1]))[:16]
    panels = [Panel(f"{depth}, {time}", partial(_current, contents, slices, at), _height(slices))]
    if np.isfinite(slices.fields[0, -1, 2:]).any():
        panels.append(
            Panel("standard error", partial(_error, contents, slices, at), panels[0].height)
        )
    else:
        notes.append("The current has no standard error.")
    if not np.isfinite(slices.fields[0, -1]).all():
        notes.append("Grey: land, below the bottom, or not known.")
    return Panels(panels, 2, notes)


def slices_at(contents: Contents, at: At | None) -> CurrentSlices | None:
    """Return the last current at one depth: that of the estimate, or without one the published slice nearest in depth."""
    published = contents.slices
    depth = (
        typical_depth(published, contents.result.innovations["depth"].to_numpy(np.float64))
        if at is None
        else at[2]
    )
    if contents.estimate is not None:
        return slices_of(contents.estimate, np.array([depth]))
    if published is None:
        return None
    k = int(np.argmin(np.abs(published.depths - depth)))
    return CurrentSlices(
        published.depths[k : k + 1],
        published.time_ns[-1:],
        published.east,
        published.north,
        published.fields[k : k + 1, -1:],
    )


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
        "color": INK,
        "edgecolor": "white",
        "linewidth": 0.3,
        "width": 0.0045,
        "minlength": 0.5,
        "pivot": "mid",
    }
    at = (longitude[half], latitude[half], true_u[half], true_v[half])
    arrows = axes.quiver(*at, scale=0.75 * cells * max(typical, 1e-6), zorder=2.0, **look)
    shown = _nice(0.6 * typical)
    key = {"labelpos": "W", "labelsep": 0.04, "fontproperties": {"size": 6.0}}
    axes.quiverkey(arrows, 0.95, 1.05, shown, f"{shown:g} m s$^{{-1}}$", **key)


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


def draw_track(contents: Contents, axes: Axes) -> None:
    """Draw the track with its begin and end; nothing without a position."""
    track = contents.track
    if track.time_ns.size == 0:
        return
    x, y = degrees(contents, track.east, track.north)
    axes.plot(x, y, **_HALO)
    axes.plot(x, y, color=SECOND, linewidth=1.1, label="track")
    for k, marker, name in ((0, "o", "begin"), (-1, "s", "end")):
        axes.plot(
            x[k],
            y[k],
            marker,
            color=SECOND,
            markeredgecolor="white",
            markersize=4.5,
            markeredgewidth=0.7,
            linestyle="none",
            label=name,
        )


def draw_surfacings(contents: Contents, axes: Axes) -> None:
    """Draw predicted and actual surfacings with the ellipses; nothing without any."""
    table = contents.result.surfacings
    if not len(table):
        return
    for kind, marker, color in (("predicted", "D", FOURTH), ("actual", "x", INK)):
        x = unwrap_longitude(
            table[f"{kind}_longitude"].to_numpy(np.float64), contents.projection.longitude
        )
        y = table[f"{kind}_latitude"].to_numpy(np.float64)
        axes.plot(
            x, y, marker, color=color, markersize=3.0, linestyle="none", label=f"surfacing, {kind}"
        )
    for k, outline in enumerate(outlines_of(table, contents.projection)):
        label = "90 % ellipse" if k == 0 else None
        axes.plot(
            *degrees(contents, outline[:, 0], outline[:, 1]),
            color=FOURTH,
            linewidth=0.7,
            label=label,
        )


def draw_hazards(contents: Contents, axes: Axes) -> None:
    """Draw the depth of the bottom as contours, the areas that the last plan keeps out of, and the ellipses of its surfacings.

    Args:
        contents: Of the result.
        axes: In degrees, with their limits.
    """
    seabed, plan = contents.seabed, contents.last_plan
    if seabed is not None:
        x, y = degrees(contents, *np.meshgrid(seabed.east, seabed.north))
        (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
        # only of what is seen, so that labels are in sight
        shown = np.where(
            (x >= west) & (x <= east) & (y >= south) & (y <= north), seabed.depth, np.nan
        )
        span = float(np.ptp(shown[np.isfinite(shown)])) if np.isfinite(shown).any() else 0.0
        if span > 0.0:
            step = contour_step(span)
            levels = np.arange(
                np.ceil(np.nanmin(shown) / step) * step, float(np.nanmax(shown)), step
            )
            lines = axes.contour(
                x,
                y,
                np.ma.masked_invalid(shown),
                levels=levels[levels > 0.0],
                colors=INK,
                linewidths=0.4,
                alpha=0.7,
            )
            axes.clabel(lines, fontsize=5.0, fmt="%g m")
    for k, area in enumerate(plan.areas if plan is not None else ()):
        longitude, latitude = np.array([*area.corners, area.corners[0]]).T
        x = unwrap_longitude(longitude, contents.projection.longitude)
        axes.fill(x, latitude, facecolor="#d5301a", alpha=0.2, zorder=2.5)
        axes.plot(
            x, latitude, color="#a02010", linewidth=1.0, label="no-go area" if k == 0 else None
        )
    for k, outline in enumerate(plan.ellipses if plan is not None else ()):
        label = "90 % of planned surfacings" if k == 0 else None
        axes.plot(
            *degrees(contents, outline[:, 0], outline[:, 1]),
            color=FIRST,
            linewidth=0.6,
            label=label,
        )


def legend(axes: Axes) -> None:
    """Draw the legend below the axes, where it has entries."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            loc="upper left",
            bbox_to_anchor=(-0.03, -0.1),
            ncols=3,
            handletextpad=0.4,
            columnspacing=1.0,
        )


def _current(contents: Contents, slices: CurrentSlices, at: At | None, axes: Axes) -> None:
    draw_speed(contents, slices, axes)
    _marks(contents, slices, at, axes)


def _error(contents: Contents, slices: CurrentSlices, at: At | None, axes: Axes) -> None:
    error = np.sqrt(0.5 * (slices.fields[0, -1, 2] ** 2 + slices.fields[0, -1, 3] ** 2))
    _field(contents, slices, error, axes, ("amp", "standard error [m s$^{-1}$]"))
    _marks(contents, slices, at, axes)


def _marks(contents: Contents, slices: CurrentSlices | None, at: At | None, axes: Axes) -> None:
    if slices is None:
        _widen(contents, axes)
    draw_hazards(contents, axes)
    draw_track(contents, axes)
    draw_surfacings(contents, axes)
    if at is not None:
        x = float(unwrap_longitude(at[0], contents.projection.longitude))
        axes.plot(
            x,
            at[1],
            "*",
            color="white",
            markeredgecolor=INK,
            markersize=8.0,
            linestyle="none",
            label="place asked for",
        )
    frame(axes)
    legend(axes)


def _field(
    contents: Contents, slices: CurrentSlices, values: Array, axes: Axes, look: tuple[str, str]
) -> None:
    """Draw values of cells, with land and coast, and a colour bar."""
    east, north = np.meshgrid(_edges(slices.east), _edges(slices.north))
    longitude, latitude = degrees(contents, east, north)
    known = values[np.isfinite(values)]
    most = float(known.max()) if known.size and known.max() > 0.0 else 1.0
    axes.set_facecolor(LAND)
    colors: Any = {"cmap": colormap(look[0]), "vmin": 0.0, "vmax": most, "rasterized": True}
    centres = degrees(contents, *np.meshgrid(slices.east, slices.north))
    # beside missing cells there is nothing to interpolate with
    if known.size == values.size:
        mesh = axes.pcolormesh(*centres, values, shading="gouraud", **colors)
    else:
        mesh = axes.pcolormesh(longitude, latitude, np.ma.masked_invalid(values), **colors)
    colorbar(axes, mesh, look[1])
    x, y = (1e3 * np.array(line, dtype=np.float64) for line in coastline(slices))
    if x.size:
        axes.plot(*degrees(contents, x, y), color=INK, linewidth=0.8)
    axes.set(xlim=(centres[0].min(), centres[0].max()), ylim=(centres[1].min(), centres[1].max()))


def _widen(contents: Contents, axes: Axes) -> None:
    """Give a map of positions alone a least width: one position has none."""
    x, y = degrees(contents, contents.track.east, contents.track.north)
    wide = _LEAST / max(float(np.cos(np.deg2rad(y.mean()))), 0.02)
    for middle, reach, least, put in (
        (x, np.ptp(x), wide, axes.set_xlim),
        (y, np.ptp(y), _LEAST, axes.set_ylim),
    ):
        centre, half = 0.5 * (middle.min() + middle.max()), 0.55 * max(float(reach), least)
        put(centre - half, centre + half)


def _height(slices: CurrentSlices) -> float:
    """Return the height of a map over its width, with room for its legend and without its colour bar."""
    shape = (slices.north[-1] - slices.north[0]) / (slices.east[-1] - slices.east[0])
    return float(np.clip(0.68 * shape + 0.2, 0.4, 1.2))


def _edges(centres: Array) -> Array:
    half = 0.5 * (centres[1] - centres[0])
    return np.append(centres - half, centres[-1] + half)


def _nice(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, not above a value."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-6)))
    return float(
        f"{max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-9)) * power:.3g}"
    )


def _degrees_text(value: float, letters: str) -> str:
    letter = "" if abs(value) < 1e-9 else letters[0] if value > 0.0 else letters[1]
    return f"{abs(float(f'{value:.6g}')):g}°{letter}"
