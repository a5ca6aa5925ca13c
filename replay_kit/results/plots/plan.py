"""The last plan: where it leads over the current, and how deep."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from replay_kit.core.geodesy import to_local
from replay_kit.results.plots.current_map import (
    At,
    degrees,
    draw_hazards,
    draw_speed,
    draw_surfacings,
    frame,
    legend,
    slices_at,
)
from replay_kit.results.plots.panel import Panel, Panels, missing
from replay_kit.results.plots.style import FIRST, FOURTH, INK, LAND
from replay_kit.results.report.sections.last_plan import profile_floor
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.last_plan import LastPlan

_HALO: Any = {"color": "white", "linewidth": 2.4}


def plan_panels(contents: Contents, at: At | None) -> Panels:
    """Return the last plan on a map, and its depth along its way.

    Args:
        contents: Of the result.
        at: Its depth is that of the map's current; None for one that is typical of the measurements.
    """
    plan, notes = contents.last_plan, list(contents.notes)
    if plan is None:
        why = (contents.summary.get("plan") or {}).get(
            "message", "no goal was given, or none was due"
        )
        return Panels(
            [
                missing(
                    "Plan",
                    f"The result holds no plan: {why}; replay-kit plan makes one on this estimate.",
                )
            ],
            1,
            notes,
        )
    if not len(plan.track):
        notes.append(f"The last plan has no track: {plan.row['message']}.")
    else:
        notes.append(_in_words(plan.row))
        notes += _figures_in_words(plan)
    panels = [Panel(f"last plan: {plan.row['status']}", partial(_map, contents, plan, at), 0.75)]
    if len(plan.track):
        panels.append(Panel("depth along the plan", partial(_profile, plan), 0.75))
    return Panels(panels, 2, notes)


def _figures_in_words(plan: LastPlan) -> list[str]:
    """Return energy, odds and bottom of a plan, as far as the result holds them."""
    out, odds = [], plan.odds
    if plan.energy is not None:
        share = (
            ""
            if plan.battery is None
            else f", {100.0 * plan.energy / plan.battery:.1f} % of {plan.battery / 1e6:g} MJ"
        )
        out.append(f"Energy {plan.energy / 1e3:,.0f} kJ{share}.")
    if odds is not None:
        out.append(
            f"{100.0 * odds['reached']:.0f} % of {odds['n_samples']:.0f} samples of the estimate arrive with headings corrected at each "
            f"surfacing, {100.0 * odds['reached_held']:.0f} % with headings held."
        )
    return out


def _in_words(plan: Any) -> str:
    steer = f"heading {plan['heading_deg']:.0f}° true, glide angle {plan['glide_angle_deg']:.1f}°, {plan['duration'] / 3600.0:.1f} h"
    return (
        f"{str(plan.name)[:16]} UTC: {steer}, misses the goal by {plan['closest_approach']:.0f} m."
    )


def _map(contents: Contents, plan: LastPlan, at: At | None, axes: Axes) -> None:
    slices, row = slices_at(contents, at), plan.row
    ends = [
        to_local(contents.projection, row[f"{name}_longitude"], row[f"{name}_latitude"])
        for name in ("start", "goal")
    ]
    east, north = (
        np.append(values, [end[k] for end in ends])
        for k, values in enumerate((plan.east, plan.north))
    )
    reach = 0.65 * max(float(np.ptp(east)), float(np.ptp(north)), 2e3)
    if slices is not None:
        draw_speed(contents, slices, axes, 2.0 * reach)
    corners = [
        0.5 * (values.min() + values.max()) + np.array([-reach, reach]) for values in (east, north)
    ]
    around = degrees(contents, *np.meshgrid(*corners))
    axes.set(xlim=(around[0].min(), around[0].max()), ylim=(around[1].min(), around[1].max()))
    draw_hazards(contents, axes)
    x, y = degrees(contents, plan.east, plan.north)
    axes.plot(x, y, **_HALO)
    axes.plot(x, y, color=FIRST, linewidth=1.3, label="plan")
    for end, marker, size, name in zip(
        ends, ("o", "*"), (5.0, 9.0), ("start", "goal"), strict=True
    ):
        look: Any = {
            "color": FOURTH,
            "markeredgecolor": INK,
            "markeredgewidth": 0.6,
            "markersize": size,
            "linestyle": "none",
        }
        axes.plot(*degrees(contents, *end), marker, label=name, **look)
    draw_surfacings(contents, axes)
    axes.set(xlim=(around[0].min(), around[0].max()), ylim=(around[1].min(), around[1].max()))
    frame(axes)
    legend(axes)


def _profile(plan: LastPlan, axes: Axes) -> None:
    along, depth = plan.along / 1e3, plan.track["depth"].to_numpy(np.float64)
    floor = profile_floor(depth, plan.bottom)
    if plan.bottom is not None:
        axes.fill_between(along, np.minimum(plan.bottom, floor), floor, color=LAND, linewidth=0.0)
        axes.plot(along, plan.bottom, color=INK, linewidth=0.8, label="bottom")
    axes.plot(along, depth, color=FIRST, label="plan")
    axes.set(xlabel="distance along the plan [km]", ylabel="depth [m]", ylim=(floor, 0.0))
    axes.grid(linewidth=0.3, color="0.85")
    if plan.bottom is not None:
        axes.legend(loc="upper left", bbox_to_anchor=(-0.03, -0.22), ncols=2)
