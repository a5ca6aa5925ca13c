"""The pictures of the studies, drawn on figures that are handed in: matplotlib itself is loaded only to write them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.studies.planning.recheck import Polygon, corners_of
from replay_kit.studies.planning.replan_rows import NEAR, ReplanRow
from replay_kit.studies.planning.world import AVERAGED, LABELS, TRUTH

if TYPE_CHECKING:
    from replay_kit.studies.planning.misses import Flown

# Okabe and Ito's colours, told apart by the colour-blind too.
_COLOURS = {
    TRUTH: "#000000",
    AVERAGED: "#8C8C8C",
    "default": "#0072B2",
    "naive3d": "#D55E00",
    "ensemble_mean": "#CC79A7",
    "nearest": "#E69F00",
}
_MARKERS = {TRUTH: "x", AVERAGED: "s", "default": "o", "naive3d": "^", "ensemble_mean": "D", "nearest": "v"}
_LAND, _FORBIDDEN, _PATH = "#8C8C8C", "#D55E00", "#0072B2"
_EAST, _NORTH = "east [km]", "north [km]"
# Misses and errors below these are drawn there.
_LEAST_MISS, _LEAST_ERROR = 1.0, 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class MaskedView:
    """A mission among islands and areas.

    Attributes:
        flow: The estimate among islands.
        areas: Longitudes and latitudes of their corners [degrees].
        track: shape (n, 3) [m], its path.
        ends: shape (2, 2) [m], start and goal.
        status: Of the plan.
    """

    flow: FlowEstimate
    areas: tuple[Polygon, ...]
    track: Array
    ends: Array
    status: str


@dataclass(frozen=True, slots=True, eq=False)
class ScenarioView:
    """Flights past an area, deterministic and scenarios.

    Attributes:
        flow: The estimate.
        corners: shape (m, 2) [m], of the area.
        ends: shape (2, 2) [m], start and goal.
        places: Of each plan, shape (K, n, 2) [m].
        shares: Of each plan's flights that trespass.
    """

    flow: FlowEstimate
    corners: Array
    ends: Array
    places: tuple[Array, ...]
    shares: tuple[float, ...]


def draw_misses(flown: "Sequence[Flown]", figure: Any) -> None:
    """Draw how misses are spread, and how each truth's median goes with the error of the flow planned on."""
    left, right = figure.subplots(1, 2)
    for flow in dict.fromkeys(one.flow for one in flown):
        alike = [one for one in flown if one.flow == flow]
        misses = np.sort(np.maximum([one.miss for one in alike], _LEAST_MISS))
        shares = np.arange(1, misses.size + 1) / misses.size
        left.step(np.append(misses[:1], misses), np.append(0.0, shares), where="post", color=_COLOURS[flow], label=LABELS[flow])
        members = dict.fromkeys(one.member for one in alike)
        of_truth = [[one for one in alike if one.member == member] for member in members]
        errors = [max(of[0].rel_error, _LEAST_ERROR) for of in of_truth]
        medians = [max(float(np.median([one.miss for one in of])), _LEAST_MISS) for of in of_truth]
        right.scatter(errors, medians, s=28, color=_COLOURS[flow], marker=_MARKERS[flow], label=LABELS[flow])
    left.set(xscale="log", xlabel="miss in the truth [m]", ylabel="share of the plans", ylim=(0.0, 1.0))
    right.set(xscale="log", yscale="log", xlabel="relative error of the flow", ylabel="median miss of a truth [m]")
    # within one decade the words of its parts would lie over each other
    right.set_xlim(min(right.get_xlim()[0], 1e-2), max(right.get_xlim()[1], 1.5))
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.tick_params(which="minor", labelbottom=False)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=10)


def draw_masked_cases(views: Sequence[MaskedView], figure: Any) -> None:
    """Draw some missions among islands and areas."""
    if not views:
        figure.text(0.5, 0.5, "no case is blocked", ha="center")
        return
    columns = min(3, len(views))
    panels = figure.subplots(-(-len(views) // columns), columns, squeeze=False).ravel()
    for axes, view in zip(panels, views, strict=False):
        grid = view.flow.grid
        axes.pcolormesh(
            grid.east / 1e3, grid.north / 1e3, np.where(grid.wet[0], np.nan, 1.0), cmap="Greys", vmin=0.0, vmax=2.0, shading="nearest"
        )
        for area in view.areas:
            axes.fill(*(corners_of(grid, area) / 1e3).T, color=_FORBIDDEN, alpha=0.5, linewidth=0.0)
        _current(axes, view.flow)
        axes.plot(*(view.track[:, :2] / 1e3).T, color=_PATH, linewidth=2.0)
        _mark(axes, view.ends)
        _around(axes, np.vstack([view.track[:, :2], view.ends]) / 1e3)
        axes.set(title=view.status, xlabel=_EAST, ylabel=_NORTH)
    for axes in panels[len(views) :]:
        axes.remove()


def draw_scenarios(view: ScenarioView, figure: Any) -> None:
    """Draw flights in fresh samples under the deterministic and the scenario plan."""
    titles = ("planned on the estimate", "planned for the samples")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, places, share, title in zip(panels, view.places, view.shares, titles, strict=True):
        axes.fill(*(view.corners / 1e3).T, color=_FORBIDDEN, alpha=0.4, linewidth=0.0)
        axes.plot(*(np.moveaxis(places, 0, -1).transpose(1, 0, 2) / 1e3), color=_PATH, linewidth=0.5, alpha=0.3)
        _mark(axes, view.ends)
        _current(axes, view.flow)
        axes.set(title=f"{title}: {share:.0%} trespass", xlabel=_EAST, ylabel=_NORTH)
    _around(panels[0], np.concatenate([view.corners, *(places.reshape(-1, 2) for places in view.places)]) / 1e3)
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
        grid.east[wet] / 1e3, grid.north[wet] / 1e3, *velocity.T, color="0.6", angles="xy", scale_units="xy", scale=0.03, width=0.004
    )


def _around(axes: Any, points: Array) -> None:
    """Show a square around points [km]."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.6 * float(np.max(high - low)) + 5.0
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set_aspect("equal")


def draw_replanned(rows: "Sequence[ReplanRow]", figure: Any) -> None:
    """Draw each mission's miss planned anew against that of the plan made once."""
    axes = figure.subplots()
    once, anew = (np.maximum([getattr(row, way).miss for row in rows], _LEAST_MISS) for way in ("once", "replanned"))
    axes.scatter(once, anew, s=28, color=_COLOURS["default"])
    ends = 0.7 * min(once.min(), anew.min()), 1.4 * max(once.max(), anew.max())
    axes.plot(ends, ends, color=_COLOURS[TRUTH], linewidth=1.0)
    axes.axhline(NEAR, color=_COLOURS[AVERAGED], linestyle="--", linewidth=1.0)
    axes.set(xscale="log", yscale="log", xlabel="miss of the plan made once [m]", ylabel="miss planned anew [m]", xlim=ends, ylim=ends)
    axes.grid(alpha=0.3)
