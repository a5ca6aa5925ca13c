"""Figures of one truth: what is measured of it, and the glides flown in it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.observation import Observation
from replay_kit.estimator.baselines import average_over_depth
from replay_kit.studies.paper.run import Shown
from replay_kit.studies.paper.views import (
    fastest,
    from_above,
    in_3d,
    metres,
    set_box,
    shape_of,
    slice_3d,
    velocity_at,
    velocity_on_grid,
)
from replay_kit.studies.reports.charts import (
    BLUE,
    DEPTH,
    EAST,
    FLOW_STYLES,
    NORTH,
    ORANGE,
    VERMILION,
)

_LEVELS_SHOWN = 3
_WINDOW_POINTS = 60
# East and north in kilometres; depth stays in metres.
_KM = np.array([1e3, 1e3, 1.0])


def truth_3d(shown: Shown) -> Figure:
    """Return the truth in 3D with the place of one ping, and that ping beside the truth under it."""
    grid = shown.truth.grid
    ping = _deepest_of(shown.observations)
    east, north = (
        float(value) for value in to_local(grid.projection, ping.longitude, ping.latitude)
    )
    figure = Figure(figsize=(12.5, 6.0), layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.8, 1.0))
    left, right = halves
    deepest = float(grid.levels[-1])
    axes = in_3d(left, (1, 1, 1), grid, (0.0, deepest))
    levels = np.unique(
        np.argmin(np.abs(grid.levels[:, None] - np.linspace(0.0, deepest, _LEVELS_SHOWN)), axis=0)
    )
    slices = {
        float(depth): velocity_on_grid(shown.truth, float(depth))
        for depth in grid.levels[levels[::-1]]
    }
    colours = Normalize(0.0, max(fastest(velocity) for velocity in slices.values()))
    for depth, velocity in slices.items():
        slice_3d(axes, grid, velocity, depth, colours)
    axes.plot(
        [east / 1e3] * 2,
        [north / 1e3] * 2,
        [0.0, deepest],
        color=VERMILION,
        linewidth=3.0,
        label="the ping",
        zorder=100.0,
    )
    axes.legend(loc="upper left")
    axes.set_title(f"The truth at {', '.join(map(metres, sorted(slices)))} m, and one ping")
    left.colorbar(
        ScalarMappable(norm=colours, cmap="viridis"),
        ax=axes,
        label="speed [m/s]",
        shrink=0.6,
        pad=0.1,
    )
    _ping_profile(right.subplots(), shown, ping, (east, north))
    return figure


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
        velocity = velocity_on_grid(shown.truth, float(depth))
        mesh = from_above(axes, grid, velocity, fastest(velocity))
        axes.plot(
            *places.T,
            ".",
            color=ORANGE,
            markersize=5.5,
            markeredgecolor="black",
            markeredgewidth=0.5,
            label=f"{len(places)} pings",
        )
        axes.set_title(f"The truth at {metres(float(depth))} m")
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
        start: shape (3,), east and north [km], depth [m].
        target: shape (3,), the same.
        paths: Flown in the truth, each up to its closest approach, by flow: shape (n, 3), the same.
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
        points = np.concatenate([*self.paths.values(), self.start[None], self.target[None]])[:, :2]
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
    paths = {
        one.row.flow: one.tracks[k][
            : int(np.argmin(np.linalg.norm(one.tracks[k] - target, axis=1))) + 1
        ]
        / _KM
        for one in glides
    }
    return _Flown(
        k,
        start / _KM,
        target / _KM,
        paths,
        {one.row.flow: one.row.closest_approach[k] for one in glides},
    )


def glides_3d(shown: Shown) -> Figure:
    """Return the paths of one pair in 3D."""
    flown = _representative(shown)
    figure = Figure(figsize=(11.0, 6.6), layout="constrained")
    axes = in_3d(figure, (1, 1, 1), shown.truth.grid, (0.0, flown.target[2]))
    deepest = 1.05 * max(
        float(flown.target[2]), *(float(path[-1, 2]) for path in flown.paths.values())
    )
    set_box(axes, *flown.window, (0.0, deepest))
    _draw_paths(axes, flown, slice(3))
    _label(figure, axes, shown, flown)
    return figure


def glides_top(shown: Shown, depth: float) -> Figure:
    """Return the paths of the same pair from above, over the truth's average down to a depth [m]."""
    flown = _representative(shown)
    window = flown.window
    width, height = (high - low for low, high in window)
    figure = Figure(
        figsize=(11.5, float(np.clip(7.5 * height / width, 4.5, 7.0)) + 1.4), layout="constrained"
    )
    axes = figure.subplots()
    east, north = np.meshgrid(*(np.linspace(*side, _WINDOW_POINTS) for side in window))
    velocity = velocity_at(average_over_depth(shown.truth, depth), 1e3 * east, 1e3 * north)
    speed = np.hypot(*np.moveaxis(velocity, -1, 0))
    # paths are distinguished by colour, so the current below them is light grey
    greys = LinearSegmentedColormap.from_list("light greys", ["white", "0.82"])
    mesh = axes.pcolormesh(
        east, north, np.ma.masked_invalid(speed), cmap=greys, vmin=0.0, shading="nearest"
    )
    part = np.s_[
        _WINDOW_POINTS // 20 :: _WINDOW_POINTS // 10, _WINDOW_POINTS // 20 :: _WINDOW_POINTS // 10
    ]
    scale = 12.0 * fastest(velocity)
    axes.quiver(
        east[part],
        north[part],
        *np.moveaxis(velocity[part], -1, 0),
        color="0.4",
        scale=scale,
        scale_units="width",
        width=0.003,
    )
    _draw_paths(axes, flown, slice(2))
    axes.set(xlim=window[0], ylim=window[1], aspect="equal", xlabel=EAST, ylabel=NORTH)
    label = f"speed of the truth's mean to {depth:.0f} m [m/s]"
    figure.colorbar(mesh, ax=axes, label=label, location="bottom", shrink=0.7, aspect=30)
    _label(figure, axes, shown, flown)
    return figure


def _draw_paths(axes: Any, flown: _Flown, coordinates: slice) -> None:
    """Draw the paths of a pair, its start and its target, in 3D axes or from above."""
    for name, path in flown.paths.items():
        style, distance = FLOW_STYLES[name], flown.distances[name]
        label = (
            f"{style.label} ({distance:.0f} m)"
            if distance < 1e3
            else f"{style.label} ({distance / 1e3:.1f} km)"
        )
        axes.plot(
            *path[:, coordinates].T,
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
            *place[coordinates],
            marker,
            color="white",
            markeredgecolor="black",
            markersize=size,
            label=label,
        )


def _label(figure: Figure, axes: Any, shown: Shown, flown: _Flown) -> None:
    axes.set_title(
        f"Glides planned on each flow, flown in the truth (pair {flown.number + 1} of {len(shown.pairs)})"
    )
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="outside right center",
        title="planned on (closest approach)",
    )


def _ping_profile(axes: Axes, shown: Shown, ping: Observation, place: tuple[float, float]) -> None:
    """Draw a ping's components against depth, and the truth's."""
    projection = shown.truth.grid.projection
    local = rotate_to_local(projection, ping.longitude, ping.latitude, *ping.velocity.T)
    depths = np.linspace(0.0, float(shown.truth.levels[-1]), 200)
    truth = shown.truth.velocity(*place, depths)
    for component, (name, colour, marker) in enumerate(
        (("east", BLUE, "o"), ("north", VERMILION, "s"))
    ):
        axes.plot(truth[:, component], depths, color=colour, label=f"{name}, truth")
        axes.plot(
            local[component],
            ping.depth,
            marker,
            color=colour,
            markersize=5,
            markerfacecolor="white",
            label=f"{name}, measured",
        )
    axes.invert_yaxis()
    axes.grid(alpha=0.3)
    axes.set(xlabel="velocity [m/s]", ylabel=DEPTH, title="The ping's bins")
    axes.legend(fontsize=11, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2)


def _deepest_of(observations: tuple[Observation, ...]) -> Observation:
    """Return the first of the profiles with the most bins."""
    return max(observations, key=lambda ping: int(np.isfinite(ping.velocity).all(axis=1).sum()))
