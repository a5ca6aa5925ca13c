"""Sections of profiles along the track, DACs of dives, time series at a position, depth profiles and surfacings of plans."""

from typing import Any

import numpy as np
import pandas as pd

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import nearest_node
from replay_kit.core.plan import Plan
from replay_kit.core.words.text import place_text
from replay_kit.results.innovations import thinned
from replay_kit.results.views.along_track import BinsAlongTrack, distance_along
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.current import At, typical_depth
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel, missing_panel

#: Most columns and rows of the section, and profiles that a column averages where there are enough.
_COLUMNS, _ROWS, _PROFILES_A_COLUMN = 160, 40, 3
# The least width of a section [ns]: one profile has none.
_LEAST_NS = 600_000_000_000
COMPONENTS = {"u": "eastward", "v": "northward"}
_TIME = Axis("time (UTC)")
#: Quantities of a section: key in ``BinsAlongTrack.values``, name, name in a smoothed result, and what it shares its colours with.
_TABLE = """
measured|measured|measured|velocity
replayed||estimated before smoothing|velocity
estimated|estimated|smoothed|velocity
before||measured minus before|difference
residual|measured minus estimated|measured minus smoothed|difference
error|standard error|standard error|error
"""
QUANTITIES = [line.split("|") for line in _TABLE.split("\n") if line]


def limits_of(kinds: list[str], values: Array) -> list[float]:
    """Return the colour limits of quantities [m/s], common to those of a kind.

    Args:
        kinds: Kind of each.
        values: Values, shape (quantities, ...) [m/s].
    """
    limits = {}
    for kind in dict.fromkeys(kinds):
        alike = np.abs(values[[each == kind for each in kinds]])
        known = alike[np.isfinite(alike)]
        most = max(np.quantile(known, 0.99), 1e-3) if known.size else 1.0
        limits[kind] = float(f"{most:.2g}")
    return [limits[kind] for kind in kinds]


def gridded(bins: BinsAlongTrack) -> tuple[Any, Array, Array]:
    """Return the quantities of bins averaged over cells of time and depth along the track.

    Returns:
        Edges of the columns (times) and rows [m], and means, shape (quantities, 2, rows, columns); NaN in empty cells.
    """
    first, last = int(bins.time_ns.min()), int(bins.time_ns.max())
    fewer = bins.profiles // _PROFILES_A_COLUMN if bins.profiles > 60 else bins.profiles
    columns, deepest = min(_COLUMNS, max(1, fewer)), max(float(bins.depth.max()), 1.0)
    # each row at least as thick as the bins
    steps = np.abs(np.diff(bins.depth)[np.diff(bins.time_ns) == 0])
    apart = float(np.median(steps)) if steps.size else deepest
    rows = int(np.clip(deepest / max(apart, 1e-3), 1, _ROWS))
    at = (bins.time_ns - first) / max(1.0, (last - first) / columns)
    row = np.clip(bins.depth / deepest * rows, 0, rows - 1).astype(np.intp)
    cell = row * columns + np.minimum(at.astype(np.intp), columns - 1)
    values = pd.DataFrame(np.hstack([bins.values[key] for key, *_ in QUANTITIES]))
    means = values.groupby(cell).mean().reindex(range(rows * columns)).to_numpy()
    middle, half = 0.5 * (last - first), 0.5 * max(last - first, _LEAST_NS)
    edges = first + np.rint(np.linspace(middle - half, middle + half, columns + 1)).astype(np.int64)
    depths = np.linspace(0.0, deepest, rows + 1)
    return edges.astype("datetime64[ns]"), depths, means.T.reshape(-1, 2, rows, columns)


def section_figure(contents: Contents) -> Figure:
    """Return the section of both components along the track."""
    bins, title = contents.section, "Profiles along the track"
    if bins.time_ns.size == 0:
        why = "The result holds no profile that was used, and no estimate along its track."
        return Figure("profiles", title, [missing_panel("Section along the track", why)])
    smoothed, estimated = (np.isfinite(bins.values[key]).any() for key in ("replayed", "estimated"))
    notes = {
        "No profile of the current was used: the section shows only the estimate along the track.": not contents.bins.time_ns.size,
        "The result holds no estimate: the section shows only measured minus estimated, which it holds for each bin.": not estimated,
        f"{bins.left_out} of {bins.left_out + bins.profiles} profiles are omitted, evenly spread.": bins.left_out,
        "The result is smoothed: the estimate at each time also uses later measurements.": smoothed,
    }
    times, depths, means = gridded(bins)
    limits, panels, shown = limits_of([kind for *_, kind in QUANTITIES], means), [], []
    axes = Axis("time (UTC)", ends=(times[0], times[-1])), Axis("depth", "m", (depths[-1], 0.0))
    for (_, name, after, kind), pair, most in zip(QUANTITIES, means, limits, strict=True):
        if not np.isfinite(pair).any() or not (name or smoothed):
            continue
        shown.append(after if smoothed else name)
        colors, least, digits = ("amp", 0.0, 4) if kind == "error" else ("balance", -most, 3)
        look: Any = {"scale": (colors, least, most, "m/s")}
        for component, cells in zip(COMPONENTS.values(), np.round(pair, digits), strict=True):
            mark = Mark("mesh", times, depths, shown[-1], z=cells, **look)
            panels.append(Panel(f"{shown[-1]}, {component}", *axes, [mark], 0.42))
    words = f"Depth against time along the track, both velocity components, in {len(shown)} rows: {', '.join(shown)}."
    kept = [note for note, holds in notes.items() if holds]
    return Figure("profiles", title, panels, _caption(bins), words, notes=kept)


def _caption(bins: BinsAlongTrack) -> str:
    error = "The standard error is that of the last estimate at these places."
    if not np.isfinite(bins.values["residual"]).any():
        return (
            "The estimate just after the last measurement before each time, along the local axes. It is based on the mean currents of "
            f"the dives; how it varies with depth comes from the ensemble only. {error}"
        )
    return (
        "Each bin and the estimate just after it was used, along the local axes, averaged over cells of time and depth. "
        "Look for structure in the difference. Stripes along the dives point to the "
        "instrument or the dead reckoning, layers to depths "
        f"that the estimate does not resolve. {error}"
    )


def dives_figure(contents: Contents) -> Figure:
    """Return measured, corrected and estimated DACs against time, with a panel for each component."""
    means, title = contents.mean_currents, "Mean currents of the dives"
    if not len(means):
        why = "The result holds no mean current of a dive: its vehicle does not dive, or the log has none that was used."
        return Figure(
            "mean-currents", title, [missing_panel("Depth-averaged currents of dives", why)]
        )
    lacking = "The result holds no estimate: the figure shows measured minus estimated currents."
    corrected = means["mean_current_corrected_east"].notna().any()
    looks: dict[str, Any] = {
        "measured": {"kind": "points", "color": "two", "size": 7.0},
        "corrected": {"kind": "points", "color": "two", "size": 7.0, "symbol": "circle-open"},
        "estimated": {"kind": "joined", "symbol": "square", "size": 4.0},
    }
    parts = [part for part in looks if corrected or part != "corrected"]
    times, about = means.index.to_numpy(), {"text": means["dive"].to_numpy()}
    panels = []
    for end, component in zip(("east", "north"), COMPONENTS.values(), strict=True):
        marks = []
        for part in parts:
            std = means[f"mean_current_{part}_standard_error"].to_numpy(np.float64)
            error = {} if part == "estimated" else {"error": std}
            values = means[f"mean_current_{part}_{end}"].to_numpy(np.float64)
            marks.append(Mark(x=times, y=values, name=part, **looks[part], **about, **error))
        axes = Axis("end of the dive (UTC)"), Axis(component, "m/s")
        panels.append(Panel(f"dives' mean current, {component}", *axes, marks, 0.55, level=0.0))
    circles = "Open circles: corrected for the flight model's error, as the estimate uses them. "
    caption = (
        "Points: mean current measured over each dive; bars: its own standard error, where known. "
        f"{circles if corrected else ''}Line: mean of the estimate "
        "over the positions of the dive, just after the update. Points that stay on one side of the line show a bias."
    )
    names = " and ".join(parts).capitalize()
    words = f"{names} mean current of {len(means)} dives, eastward and northward, against time."
    notes = [] if means["mean_current_estimated_east"].notna().any() else [lacking]
    return Figure("mean-currents", title, panels, caption, words, notes=notes)


def series_figure(contents: Contents, at: At | None) -> Figure:
    """Return the time series of both components at a position.

    Args:
        contents: Contents of the result.
        at: Position; None for the last one, at the published depth most typical of the measurements.
    """
    track, slices, title = contents.track, contents.slices, "Current at a place"
    if at is None and track.time_ns.size:
        depth = typical_depth(slices, contents.measured.innovations["depth"].to_numpy(np.float64))
        at = (float(track.longitude[-1]), float(track.latitude[-1]), depth)
    series = None if at is None else contents.series(at)
    if slices is None or at is None or series is None:
        lacks = "no position, and no place was requested" if slices else "no published current"
        return Figure("series", title, [missing_panel(title, f"The result holds {lacks}.")])
    place, shown = place_text(at[0], at[1]), float(series["depth"].iloc[0])
    if series["u"].isna().all():
        lacks = f"{place} at {at[2]:g} m is on land, below the bottom, or outside the region of the estimate."
        return Figure("series", title, [missing_panel(title, lacks)])
    notes, once = list[str](), len(series) == 1
    if shown != at[2]:
        notes.append(f"Requested depth: {at[2]:g} m; nearest published depth: {shown:g} m.")
    elif series["u_standard_error"][:-1].isna().all() and not once:
        depths = ", ".join(f"{depth:g}" for depth in slices.depths)
        notes.append(
            f"At {shown:g} m only the last standard error is known; through time it was published at {depths} m."
        )
    if once:
        notes.append("The current was published once: there is no series.")
    elif (radars := getattr(contents.estimate, "surface", None)) and shown <= radars.depth:
        notes.append("The last value alone includes what radars show beside the estimate's modes.")
    panels, times, name = [], series["time"].to_numpy(), "one standard error"
    for key, component in COMPONENTS.items():
        values, errors = (series[column].to_numpy() for column in (key, f"{key}_standard_error"))
        marks = [Mark("joined", times, values, "estimate", size=4.5)]
        if np.isfinite(errors).sum() > 1:
            both = np.append(values - errors, (values + errors)[::-1])
            marks.append(Mark("band", np.append(times, times[::-1]), both, name))
        elif np.isfinite(errors).any():
            marks.append(Mark("points", times[-1:], values[-1:], name, size=4.5, error=errors[-1:]))
        where, axis = f"{component}, {place}, {shown:g} m", Axis(f"${key}$", "m/s")
        panels.append(Panel(where, _TIME, axis, marks, 0.5, level=0.0))
    return Figure("series", title, panels, notes=notes)


_POINTS = 1000
#: A bottom farther below the plan than this share of its depth is not drawn: dives would be flat.
_BELOW = 2.5


def profile_figure(contents: Contents, plan: Plan) -> Figure:
    """Return the depth profile of the last plan over the bottom."""
    kept = thinned(len(plan.track), _POINTS)
    far, depth = distance_along(*plan.track[:, :2].T)[kept] / 1e3, plan.track[kept, 2]
    ground = None if plan.bottom is None else plan.bottom[kept]
    deepest = max(float(depth.max()), 1.0)
    lowest = deepest if ground is None else min(float(np.nanmax(ground)), _BELOW * deepest)
    floor, marks, below = 1.05 * max(deepest, lowest), [], ""
    if ground is not None:
        look: Any = {"color": "ink", "width": 1.5, "base": np.full(far.size, floor)}
        marks = [Mark("line", far, ground, "bottom", **look)]
        below = "Filled: the bottom of the bathymetry, interpolated linearly; plans keep above the shallowest of the four points around."
        if (ground > floor).any():
            least, most = np.nanmin(ground), np.nanmax(ground)
            below += f" Where it is not shown it is deeper than {floor:.0f} m: it is {least:.0f} to {most:.0f} m deep."
    elif (level := _deepest_wet(contents, plan.track[kept])) is not None:
        floor = max(floor, 1.05 * float(level.max()))
        marks = [Mark("line", far, level, "deepest wet level", "ink", width=1.5)]
        below = "The forecast is wet down to its last level all along the plan."
        if level.min() < level.max():
            below = "The line below is the deepest wet level of the forecast; the bottom lies between it and the next level."
    times = plan.start_time_ns + np.rint(1e9 * plan.track_time[kept]).astype(np.int64)
    text = times.astype("datetime64[ns]")
    marks.append(Mark("line", far, depth, "planned depth", text=text))
    over, hours = "" if ground is None else ", over the bottom", plan.track_time[-1] / 3600.0
    axes = Axis("distance along the plan", "km"), Axis("depth", "m", (floor, 0.0))
    return Figure(
        "plan-profile",
        "Depth profile of the last plan",
        [Panel("depth along the plan", *axes, marks, shares_legend=True)],
        f"Depth of the last plan along its predicted track, {far[-1]:.1f} km in {hours:.1f} hours. {below}",
        f"Depth against distance along the last plan, {far[-1]:.0f} km long{over}.",
    )


def _deepest_wet(contents: Contents, track: Array) -> Any:
    """Return the deepest wet level at the grid points nearest to a track, shape (n, 3) [m]; None without an estimate."""
    if contents.estimate is None:
        return None
    grid = contents.estimate.grid
    wet = grid.wet.reshape(grid.levels.size, -1)[:, nearest_node(grid, track[:, :2])]
    return np.max(np.where(wet, grid.levels[:, None], 0.0), axis=0)


def surfacing_figure(contents: Contents) -> Figure:
    """Return the actual surfacings relative to those predicted by the previous plans."""
    table = contents.result.surfacings
    radians = np.deg2rad(table["direction_deg"].to_numpy(np.float64))
    distance = table["distance"].to_numpy(np.float64) / 1e3
    east_km, north_km = distance * np.sin(radians), distance * np.cos(radians)
    points = Mark("points", east_km, north_km, "surfacing", size=9.0, text=table.index.to_numpy())
    reach = float(f"{1.15 * max(distance.max(), 0.1):.3g}")
    x, y = (Axis(f"{end} of the prediction", "km", (-reach, reach)) for end in ("east", "north"))
    return Figure(
        "surfacing-errors",
        "Predicted and actual surfacings",
        [Panel("surfacings", x, y, [points], equal=True)],
        "Each point is an actual surfacing relative to the one predicted by the previous plan. A cloud off the "
        "centre means that the estimate lacks a current, or that another plan was flown.",
        f"Error of {len(table)} predicted surfacings, east and north.",
    )
