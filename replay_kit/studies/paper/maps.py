"""The truth and the glides flown in it from above, drawn with matplotlib: currents in kilometres, with arrows."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.core.grid import Grid
from replay_kit.estimator.baselines import average_over_depth
from replay_kit.studies.paper.run import Shown
from replay_kit.studies.reports.charts import (
    FLOW_STYLES,
    ORANGE,
)

_WINDOW_POINTS = 60
# Arrows across the longer side of a view.
_ARROWS = 18
EAST, NORTH = "east [km]", "north [km]"


def truth_top(shown: Shown) -> Figure:
    """Return the truth from above at two levels, with the places of all pings."""
    grid = shown.truth.grid
    places = (
        np.array(
            [
                to_local(grid.projection, ping.longitude, ping.latitude)
                for ping in shown.observations
            ]
        )
        / 1e3
    )
    figure = Figure(figsize=(13.0, 6.1 * shape_of(grid) + 2.0), layout="compressed")
    panels = figure.subplots(1, 2, sharey=True)
    depths = (
        grid.levels[0],
        grid.levels[int(np.argmin(np.abs(grid.levels - 0.5 * grid.levels[-1])))],
    )
    for axes, depth in zip(panels, depths, strict=True):
        velocity = _velocity_on_grid(shown.truth, float(depth))
        mesh = from_above(axes, grid, velocity, _fastest(velocity))
        axes.plot(
            *places.T,
            ".",
            color=ORANGE,
            markersize=5.5,
            markeredgecolor="black",
            markeredgewidth=0.5,
            label=f"{len(places)} pings",
        )
        axes.set_title(f"The truth at {_metres(float(depth))} m")
        axes.set_xlabel(EAST)
        figure.colorbar(
            mesh, ax=axes, label="speed [m/s]", location="bottom", shrink=0.7, aspect=30
        )
    panels[0].set_ylabel(NORTH)
    panels[0].legend(loc="upper right", framealpha=0.9)
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class _Flown:
    """The glides of one pair.

    Attributes:
        number: Of the pair, from 0.
        start: shape (2,), east and north [km].
        target: shape (2,), the same.
        paths: Flown in the truth, each up to its closest approach, by flow: shape (n, 2), the same.
        distances: Closest approaches [m], by flow.
    """

    number: int
    start: Array
    target: Array
    paths: dict[str, Array]
    distances: dict[str, float]

    @property
    def window(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Limits east and north [km] of a view that holds all paths: wide enough for its labels, and not too flat."""
        points = np.concatenate([*self.paths.values(), self.start[None], self.target[None]])
        low, high = points.min(axis=0), points.max(axis=0)
        middle, size = (low + high) / 2.0, 1.2 * (high - low)
        size = np.maximum(size, [size[1], 0.5 * size[0]])
        (west, south), (east, north) = middle - size / 2.0, middle + size / 2.0
        return (float(west), float(east)), (float(south), float(north))


def _representative(shown: Shown) -> _Flown:
    """Return the pair whose closest approaches, summed over flows, are in the middle of all pairs."""
    glides = [one for one in shown.glides if one.tracks]
    distances = np.sum([one.row.closest_approach for one in glides], axis=0)
    k = int(np.argsort(distances, kind="stable")[len(distances) // 2])
    projection = shown.truth.grid.projection
    start, target = (
        np.array([*to_local(projection, place.longitude, place.latitude), place.depth])
        for place in (shown.pairs[k].start, shown.pairs[k].target)
    )
    paths = {}
    for one in glides:
        nearest = int(np.argmin(np.linalg.norm(one.tracks[k] - target, axis=1)))
        paths[one.row.flow] = one.tracks[k][: nearest + 1, :2] / 1e3
    approaches = {one.row.flow: one.row.closest_approach[k] for one in glides}
    return _Flown(k, start[:2] / 1e3, target[:2] / 1e3, paths, approaches)


def glides_top(shown: Shown, depth: float) -> Figure:
    """Return the paths of one pair from above, over the truth's average down to a depth [m]."""
    flown = _representative(shown)
    window = flown.window
    width, height = (high - low for low, high in window)
    figure = Figure(
        figsize=(11.5, float(np.clip(7.5 * height / width, 4.5, 7.0)) + 1.4), layout="constrained"
    )
    axes = figure.subplots()
    east, north = np.meshgrid(*(np.linspace(*side, _WINDOW_POINTS) for side in window))
    velocity = _velocity_at(average_over_depth(shown.truth, depth), 1e3 * east, 1e3 * north)
    speed = np.hypot(*np.moveaxis(velocity, -1, 0))
    # paths are distinguished by colour, so the current below them is light grey
    greys = LinearSegmentedColormap.from_list("light greys", ["white", "0.82"])
    mesh = axes.pcolormesh(
        east, north, np.ma.masked_invalid(speed), cmap=greys, vmin=0.0, shading="nearest"
    )
    part = np.s_[
        _WINDOW_POINTS // 20 :: _WINDOW_POINTS // 10, _WINDOW_POINTS // 20 :: _WINDOW_POINTS // 10
    ]
    scale = 12.0 * _fastest(velocity)
    axes.quiver(
        east[part],
        north[part],
        *np.moveaxis(velocity[part], -1, 0),
        color="0.4",
        scale=scale,
        scale_units="width",
        width=0.003,
    )
    _draw_paths(axes, flown)
    axes.set(xlim=window[0], ylim=window[1], aspect="equal", xlabel=EAST, ylabel=NORTH)
    label = f"speed of the truth's mean to {depth:.0f} m [m/s]"
    figure.colorbar(mesh, ax=axes, label=label, location="bottom", shrink=0.7, aspect=30)
    axes.set_title(
        f"Glides planned on each flow, flown in the truth (pair {flown.number + 1} of {len(shown.pairs)})"
    )
    title = "planned on (closest approach)"
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right center", title=title)
    return figure


def _draw_paths(axes: Axes, flown: _Flown) -> None:
    """Draw the paths of a pair, its start and its target."""
    for name, path in flown.paths.items():
        style, distance = FLOW_STYLES[name], flown.distances[name]
        label = (
            f"{style.label} ({distance:.0f} m)"
            if distance < 1e3
            else f"{style.label} ({distance / 1e3:.1f} km)"
        )
        axes.plot(
            *path.T,
            style.line,
            color=style.colour,
            linewidth=style.width,
            label=label,
        )
    for place, marker, size, label in (
        (flown.start, "o", 9, "start"),
        (flown.target, "*", 15, "target"),
    ):
        axes.plot(
            *place,
            marker,
            color="white",
            markeredgecolor="black",
            markersize=size,
            label=label,
        )


def _velocity_on_grid(flow: FlowEstimate, depth: float) -> Array:
    """Return a flow's velocity at its grid's points at a depth, shape (J, I, 2) [m/s]; NaN where the nearest level is dry."""
    grid = flow.grid
    velocity = flow.velocity(grid.east, grid.north, depth)
    velocity[~grid.wet[int(np.argmin(np.abs(grid.levels - depth)))]] = np.nan
    return velocity


def _velocity_at(flow: FlowEstimate, east: Array, north: Array) -> Array:
    """Return a flow's velocity at the surface at points of its local frame [m], any shape; NaN on land and outside the grid."""
    grid = flow.grid
    velocity = flow.velocity(east, north, 0.0)
    nearest = cKDTree(np.column_stack([grid.east.ravel(), grid.north.ravel()])).query(
        np.stack([east, north], axis=-1)
    )[1]
    velocity[~(inside_grid(grid, east, north) & grid.wet[0].ravel()[nearest])] = np.nan
    return velocity


def from_above(axes: Axes, grid: Grid, velocity: Array, largest: float) -> QuadMesh:
    """Draw speed in colours and arrows over it; return what a colour bar needs.

    Args:
        axes: Where.
        grid: The points.
        velocity: shape (J, I, 2), at them.
        largest: Speed at the end of the colours, in the velocity's unit.
    """
    east, north = grid.east / 1e3, grid.north / 1e3
    mesh = axes.pcolormesh(
        east,
        north,
        np.hypot(*np.moveaxis(velocity, -1, 0)),
        cmap="viridis",
        vmin=0.0,
        vmax=largest,
        shading="nearest",
    )
    part = _thinned(grid)
    style: Any = {"color": "white", "edgecolor": "black", "linewidth": 0.3, "width": 0.005}
    axes.quiver(
        east[part],
        north[part],
        *np.moveaxis(velocity[part], -1, 0),
        scale=0.8 * largest * _ARROWS,
        scale_units="width",
        **style,
    )
    axes.set_aspect("equal")
    return mesh


def _metres(depth: float) -> str:
    """Return a depth [m] in as many digits as a title needs."""
    return f"{depth:.0f}" if depth >= 10.0 else f"{depth:.2g}"


def shape_of(grid: Grid) -> float:
    """Return a region's height over its width, within what a figure can show."""
    return float(np.clip(np.ptp(grid.north) / np.ptp(grid.east), 0.4, 1.5))


def _thinned(grid: Grid) -> tuple[slice, slice]:
    """Return the slices of a grid's points that leave some arrows along its longer side."""
    every = max(1, round(max(grid.east.shape) / _ARROWS))
    return np.s_[every // 2 :: every, every // 2 :: every]


def _fastest(velocity: Array) -> float:
    """Return the largest speed [m/s] of velocities, shape (J, I, 2), that are NaN on land."""
    return float(np.nanmax(np.hypot(*np.moveaxis(velocity, -1, 0))))
