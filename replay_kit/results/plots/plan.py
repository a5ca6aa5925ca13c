"""The last plan: where it leads over the current, and how deep."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.results.plots.current_map import At, degrees, draw_speed, draw_surfacings, frame, legend, slices_at
from replay_kit.results.plots.panel import Panel, Panels, missing
from replay_kit.results.plots.style import FIRST, FOURTH, INK
from replay_kit.results.views.contents import Contents

_HALO: Any = {"color": "white", "linewidth": 2.4}


def plan_panels(contents: Contents, at: At | None) -> Panels:
    """Return the last plan on a map, and its depth along its way.

    Args:
        contents: Of the result.
        at: Its depth is that of the map's current; None for one that is typical of the measurements.
    """
    plans, notes = contents.result.plans, list(contents.notes)
    if not len(plans):
        why = (contents.summary.get("plan") or {}).get("message", "no goal was given, or none was due")
        return Panels([missing("Plan", f"The result holds no plan: {why}; replay-kit plan makes one on this estimate.")], 1, notes)
    last = plans.iloc[-1]
    tracks = contents.result.plan_tracks
    track = tracks[tracks["plan"] == len(plans) - 1]
    if not len(track):
        notes.append(f"The last plan has no track: {last['message']}.")
    else:
        notes.append(_in_words(last))
    local = to_local(contents.projection, track["longitude"], track["latitude"])
    panels = [Panel(f"last plan: {last['status']}", partial(_map, contents, local, at), 0.75)]
    if len(track):
        panels.append(Panel("depth along the plan", partial(_profile, local, track), 0.75))
    return Panels(panels, 2, notes)


def _in_words(plan: Any) -> str:
    steer = f"heading {plan['heading_deg']:.0f}° true, glide angle {plan['glide_angle_deg']:.1f}°, {plan['duration'] / 3600.0:.1f} h"
    return f"{str(plan.name)[:16]} UTC: {steer}, misses the goal by {plan['closest_approach']:.0f} m."


def _map(contents: Contents, local: tuple[Array, Array], at: At | None, axes: Axes) -> None:
    slices, plan = slices_at(contents, at), contents.result.plans.iloc[-1]
    ends = [to_local(contents.projection, plan[f"{name}_longitude"], plan[f"{name}_latitude"]) for name in ("start", "goal")]
    east, north = (np.append(values, [end[k] for end in ends]) for k, values in enumerate(local))
    reach = 0.65 * max(float(np.ptp(east)), float(np.ptp(north)), 2e3)
    if slices is not None:
        draw_speed(contents, slices, axes, 2.0 * reach)
    x, y = degrees(contents, *local)
    axes.plot(x, y, **_HALO)
    axes.plot(x, y, color=FIRST, linewidth=1.3, label="plan")
    for end, marker, size, name in zip(ends, ("o", "*"), (5.0, 9.0), ("start", "goal"), strict=True):
        look: Any = {"color": FOURTH, "markeredgecolor": INK, "markeredgewidth": 0.6, "markersize": size, "linestyle": "none"}
        axes.plot(*degrees(contents, *end), marker, label=name, **look)
    draw_surfacings(contents, axes)
    corners = [0.5 * (values.min() + values.max()) + np.array([-reach, reach]) for values in (east, north)]
    around = degrees(contents, *np.meshgrid(*corners))
    axes.set(xlim=(around[0].min(), around[0].max()), ylim=(around[1].min(), around[1].max()))
    frame(axes)
    legend(axes)


def _profile(local: tuple[Array, Array], track: Any, axes: Axes) -> None:
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(local[0]), np.diff(local[1])))]) / 1e3
    axes.plot(along, track["depth"], color=FIRST)
    axes.set(xlabel="distance along the plan [km]", ylabel="depth [m]", ylim=(1.05 * max(float(track["depth"].max()), 1.0), 0.0))
    axes.grid(linewidth=0.3, color="0.85")
