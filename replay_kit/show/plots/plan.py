"""The last plan: where it leads over the current, and how deep."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from replay_kit.core.plan import ORIGIN
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.last_plan import LastPlan
from replay_kit.results.views.slices import CurrentSlices
from replay_kit.show.figures.in_print import drawing_of
from replay_kit.show.figures.map_layers import hazard_layer, plan_layer, surfacing_layer
from replay_kit.show.figures.on_canvas import Extent
from replay_kit.show.figures.plan import profile_chart
from replay_kit.show.plots.current_map import (
    ABOVE_KEY,
    draw_layers,
    draw_seabed,
    draw_speed,
    frame,
    show_extent,
    slices_at,
    without_current,
)
from replay_kit.show.plots.panel import Chosen, Panel, Panels, missing
from replay_kit.show.words import energy_sentence, odds_sentence


def plan_panels(contents: Contents, chosen: Chosen) -> Panels:
    """Return the last plan on a map, and its depth along its way.

    Args:
        contents: Of the result.
        chosen: Depth of the map's current.
    """
    plan, notes = contents.last_plan, list(contents.notes)
    if plan is None:
        why = (contents.outcome.plan or {}).get("message", "no goal was given, or none was due")
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
    slices, around = slices_at(contents, chosen), _around(plan)
    east, north = 1e3 * np.array(around.ends).reshape(2, 2)
    notes += [] if slices is None else without_current(slices, (east, north))
    panels = [
        Panel(
            f"last plan: {plan.row['status']}",
            partial(_map, contents, slices, around),
            0.85,
            True,
            ABOVE_KEY,
        )
    ]
    if len(plan.track):
        draw = drawing_of(profile_chart(contents, plan), 0)
        panels.append(Panel("depth along the plan", draw, 0.85, True, ABOVE_KEY))
    return Panels(panels, 2, notes)


def _figures_in_words(plan: LastPlan) -> list[str]:
    """Return how the vehicle dives where that was not stated, energy and odds of a plan, as far as the result holds them."""
    out = [f"Dives {plan.statistics[ORIGIN]}."] if ORIGIN in plan.statistics else []
    if plan.energy is not None:
        out.append(f"Energy {energy_sentence(plan.energy, plan.battery)}.")
    if plan.odds is not None:
        out.append(f"{odds_sentence(plan.odds)}.")
    return out


def _in_words(plan: Any) -> str:
    if not np.isfinite(plan["heading_deg"]):
        return f"{str(plan.name)[:16]} UTC: nothing to steer: {plan['message']}."
    steer = f"heading {plan['heading_deg']:.0f}° true, glide angle {plan['glide_angle_deg']:.1f}°, {plan['duration'] / 3600.0:.1f} h"
    return (
        f"{str(plan.name)[:16]} UTC: {steer}, misses the goal by {plan['closest_approach']:.0f} m."
    )


def _around(plan: LastPlan) -> Extent:
    """Return the extent around a plan."""
    places = np.vstack([np.column_stack([plan.east, plan.north]), plan.start, plan.goal]) / 1e3
    return Extent.around(places[:, 0], places[:, 1], 0.15)


def _map(contents: Contents, slices: CurrentSlices | None, around: Extent, axes: Axes) -> None:
    if slices is not None:
        draw_speed(contents, slices, axes, 1e3 * (around.east - around.west))
    show_extent(contents, axes, around)
    limits = {"xlim": axes.get_xlim(), "ylim": axes.get_ylim()}
    draw_seabed(contents, axes)
    draw_layers(
        contents, axes, hazard_layer(contents), plan_layer(contents), surfacing_layer(contents)
    )
    axes.set(**limits)
    frame(axes)
