"""The pictures of the studies of planning, drawn on matplotlib figures that are handed in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.studies.planning.arrival_tables import Arrival
from replay_kit.studies.planning.flights import corners_of, ends_of
from replay_kit.studies.planning.masks import Masked
from replay_kit.studies.reports.flows import BLACK, BLUE, EAST, FLOW_STYLES, GREY, NORTH, VERMILION

# Miss distances and errors below these are drawn at these.
_LEAST_MISS, _LEAST_ERROR = 1.0, 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class ScenarioView:
    """Flights past an area, with the deterministic and with the scenario plan.

    Attributes:
        flow: The estimate.
        corners: shape (m, 2) [m], of the area.
        ends: shape (2, 2) [m], start and goal.
        places: Of each plan, shape (K, n, 2) [m].
        shares: Of each plan's flights that enter the area.
    """

    flow: FlowEstimate
    corners: Array
    ends: Array
    places: tuple[Array, ...]
    shares: tuple[float, ...]


def draw_misses(arrivals: Sequence[Arrival], figure: Any) -> None:
    """Draw the distribution of miss distances, and each truth's median against the error of the flow that plans were made on."""
    left, right = figure.subplots(1, 2)
    for flow in dict.fromkeys(one.flow for one in arrivals):
        style = FLOW_STYLES[flow]
        of_flow = {"color": style.colour, "label": style.label}
        alike = [one for one in arrivals if one.flow == flow]
        misses = np.sort(np.maximum([one.miss for one in alike], _LEAST_MISS))
        left.step(
            np.append(misses[:1], misses),
            np.arange(misses.size + 1) / misses.size,
            where="post",
            **of_flow,
        )
        of_truth = [
            [one for one in alike if one.member == member]
            for member in dict.fromkeys(one.member for one in alike)
        ]
        errors = [max(of[0].rel_error, _LEAST_ERROR) for of in of_truth]
        medians = [max(float(np.median([one.miss for one in of])), _LEAST_MISS) for of in of_truth]
        right.scatter(errors, medians, s=28, marker=style.marker, **of_flow)
    left.set(
        xscale="log",
        xlabel="miss distance in the truth [m]",
        ylabel="share of the plans",
        ylim=(0.0, 1.0),
    )
    right.set(
        xscale="log",
        yscale="log",
        xlabel="relative error of the flow",
        ylabel="median miss distance of a truth [m]",
    )
    # within one decade the labels of its parts would overlap
    right.set_xlim(min(right.get_xlim()[0], 1e-2), max(right.get_xlim()[1], 1.5))
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.tick_params(which="minor", labelbottom=False)
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=10
    )


def draw_masked_cases(cases: Sequence[tuple[Masked, Array, str]], figure: Any) -> None:
    """Draw some missions among islands and areas, each with its path, shape (n, 3) [m], and the status of its plan."""
    if not cases:
        figure.text(0.5, 0.5, "no case is blocked", ha="center")
        return
    columns = min(3, len(cases))
    panels = figure.subplots(-(-len(cases) // columns), columns, squeeze=False).ravel()
    for axes, (case, track, status) in zip(panels, cases, strict=False):
        grid, ends = case.flow.grid, ends_of(case.flow.grid, case.pair)
        axes.pcolormesh(
            grid.east / 1e3,
            grid.north / 1e3,
            np.where(grid.wet[0], np.nan, 1.0),
            cmap="Greys",
            vmin=0.0,
            vmax=2.0,
            shading="nearest",
        )
        for area in case.areas:
            axes.fill(*(corners_of(grid, area) / 1e3).T, color=VERMILION, alpha=0.5, linewidth=0.0)
        _current(axes, case.flow)
        axes.plot(*(track[:, :2] / 1e3).T, color=BLUE, linewidth=2.0)
        _mark(axes, ends)
        _around(axes, np.vstack([track[:, :2], ends]) / 1e3)
        axes.set(title=status, xlabel=EAST, ylabel=NORTH)
    for axes in panels[len(cases) :]:
        axes.remove()


def draw_scenarios(view: ScenarioView, figure: Any) -> None:
    """Draw flights in fresh samples under the deterministic and the scenario plan."""
    titles = ("planned on the estimate", "planned for the samples")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, places, share, title in zip(panels, view.places, view.shares, titles, strict=True):
        axes.fill(*(view.corners / 1e3).T, color=VERMILION, alpha=0.4, linewidth=0.0)
        axes.plot(
            *(np.moveaxis(places, 0, -1).transpose(1, 0, 2) / 1e3),
            color=BLUE,
            linewidth=0.5,
            alpha=0.3,
        )
        _mark(axes, view.ends)
        _current(axes, view.flow)
        axes.set(title=f"{title}: {share:.0%} enter the area", xlabel=EAST, ylabel=NORTH)
    _around(
        panels[0],
        np.concatenate([view.corners, *(places.reshape(-1, 2) for places in view.places)]) / 1e3,
    )
    for axes in panels:
        axes.set_aspect("equal")


def _mark(axes: Any, ends: Array) -> None:
    axes.plot(*(ends[0] / 1e3), "o", color="black", markersize=5)
    axes.plot(*(ends[1] / 1e3), "*", color="black", markersize=11)


def _current(axes: Any, flow: FlowEstimate) -> None:
    """Draw the current at 250 m as arrows at the grid's water."""
    grid = flow.grid
    wet = grid.wet[0]
    velocity = flow.velocity(grid.east[wet], grid.north[wet], 250.0)
    axes.quiver(
        grid.east[wet] / 1e3,
        grid.north[wet] / 1e3,
        *velocity.T,
        color="0.6",
        angles="xy",
        scale_units="xy",
        scale=0.03,
        width=0.004,
    )


def _around(axes: Any, points: Array) -> None:
    """Show a square around points [km]."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.6 * float(np.max(high - low)) + 5.0
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set_aspect("equal")


def draw_ways(misses: Mapping[str, Array], figure: Any) -> None:
    """Draw, for each kind of survey, the share of the stretches that end within a distance [km] of their goals."""
    axes = figure.subplots()
    styles = (
        (GREY, ":"),
        (BLACK, "--"),
        (VERMILION, "-."),
        (BLUE, "-"),
        (BLUE, ":"),
        (VERMILION, ":"),
    )
    for (way, values), (color, line) in zip(misses.items(), styles, strict=False):
        share = np.arange(1, values.size + 1) / values.size
        axes.step(np.sort(values), share, where="post", color=color, linestyle=line, label=way)
    axes.axhline(0.9, color=GREY, linewidth=0.8)
    axes.set(
        xlabel="distance from the goal [km]",
        ylabel="share of the stretches",
        ylim=(0.0, 1.02),
        xlim=(0.0, None),
    )
    axes.legend(frameon=False)
    axes.grid(alpha=0.3)


def draw_replanned(misses: Array, near: float, figure: Any) -> None:
    """Draw the miss distances [m] of missions replanned against those with a single plan, shape (n, 2), the latter first."""
    axes = figure.subplots()
    single, replanned = np.maximum(misses, _LEAST_MISS).T
    axes.scatter(single, replanned, s=28, color=BLUE)
    ends = 0.7 * min(single.min(), replanned.min()), 1.4 * max(single.max(), replanned.max())
    axes.plot(ends, ends, color=BLACK, linewidth=1.0)
    axes.axhline(near, color=GREY, linestyle="--", linewidth=1.0)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="miss distance, single plan [m]",
        ylabel="miss distance, replanned [m]",
        xlim=ends,
        ylim=ends,
    )
    axes.grid(alpha=0.3)
