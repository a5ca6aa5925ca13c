"""Parts shared by figures: a region from above and in 3D, in kilometres, depth downwards."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid
from replay_kit.core.grid import Grid
from replay_kit.studies.reports.charts import DEPTH, EAST, NORTH

# Arrows across the longer side of a view.
_ARROWS, _ARROWS_3D = 18, 15


def velocity_on_grid(flow: FlowEstimate, depth: float) -> Array:
    """Return a flow's velocity at its grid's points at a depth, shape (J, I, 2) [m/s]; NaN where the nearest level is dry."""
    grid = flow.grid
    velocity = flow.velocity(grid.east, grid.north, depth)
    velocity[~grid.wet[int(np.argmin(np.abs(grid.levels - depth)))]] = np.nan
    return velocity


def velocity_at(flow: FlowEstimate, east: Array, north: Array) -> Array:
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
    part = _thinned(grid, _ARROWS)
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


def metres(depth: float) -> str:
    """Return a depth [m] in as many digits as a title needs."""
    return f"{depth:.0f}" if depth >= 10.0 else f"{depth:.2g}"


def shape_of(grid: Grid) -> float:
    """Return a region's height over its width, within what a figure can show."""
    return float(np.clip(np.ptp(grid.north) / np.ptp(grid.east), 0.4, 1.5))


def in_3d(
    figure: Figure | SubFigure,
    position: tuple[int, int, int],
    grid: Grid,
    depths: tuple[float, float],
) -> Any:
    """Return 3D axes of a region, depth downwards; what is drawn later lies above what was drawn before.

    Args:
        figure: Where.
        position: Of the axes, as ``add_subplot`` takes it.
        grid: The region.
        depths: Ends of the depth axis [m], the upper one first.
    """
    # matplotlib's 3D axes come without types
    axes: Any = figure.add_subplot(*position, projection="3d", computed_zorder=False)
    east, north = (
        (float(side.min()) / 1e3, float(side.max()) / 1e3) for side in (grid.east, grid.north)
    )
    set_box(axes, east, north, depths)
    return axes


def set_box(
    axes: Any, east: tuple[float, float], north: tuple[float, float], depths: tuple[float, float]
) -> None:
    """Set the limits [km, km, m], the names and the shape of 3D axes."""
    axes.set(xlim=east, ylim=north, zlim=depths[::-1], xlabel=EAST, ylabel=NORTH, zlabel=DEPTH)
    width, height = east[1] - east[0], north[1] - north[0]
    longer = max(width, height)
    # a region much longer in one direction would leave no room for the labels of its short side; a deep view would push them out
    axes.set_box_aspect(
        (max(width / longer, 0.5), max(height / longer, 0.5), 0.8),
        zoom=1.0 if width >= 0.9 * height else 0.85,
    )
    axes.view_init(elev=22.0, azim=-62.0)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.labelpad = 9.0
        axis.set_major_locator(MaxNLocator(4))


def slice_3d(axes: Any, grid: Grid, velocity: Array, depth: float, colours: Normalize) -> None:
    """Draw one depth in 3D axes: speed in colours, arrows over it. Draw deeper slices first.

    Args:
        axes: Where.
        grid: The points.
        velocity: shape (J, I, 2), at them.
        depth: [m].
        colours: Speed to the ends of the colours; the longest arrow is somewhat longer than their distance.
    """
    east, north, speed = grid.east / 1e3, grid.north / 1e3, np.hypot(*np.moveaxis(velocity, -1, 0))
    steps = np.linspace(0.0, float(colours.vmax or 1.0), 21)
    order = 2.0 + len(axes.collections)
    style: Any = {"cmap": "viridis", "norm": colours, "alpha": 0.85, "zorder": order}
    axes.contourf(
        east, north, np.ma.masked_invalid(speed), levels=steps, zdir="z", offset=depth, **style
    )
    part = _thinned(grid, _ARROWS_3D)
    u, v = (component[part].ravel() for component in np.moveaxis(velocity, -1, 0))
    drawn = np.isfinite(u) & np.isfinite(v)
    tail = np.column_stack([east[part].ravel(), north[part].ravel(), np.full(u.size, depth)])[drawn]
    longest = 1.6 * max(float(np.ptp(east)), float(np.ptp(north))) / _ARROWS_3D
    along = np.column_stack([u, v])[drawn] * longest / steps[-1]
    axes.add_collection3d(
        Line3DCollection(_strokes(tail, along), colors="white", linewidths=1.0, zorder=order)
    )


def _thinned(grid: Grid, arrows: int) -> tuple[slice, slice]:
    """Return the slices of a grid's points that leave so many arrows along its longer side."""
    every = max(1, round(max(grid.east.shape) / arrows))
    return np.s_[every // 2 :: every, every // 2 :: every]


def fastest(velocity: Array) -> float:
    """Return the largest speed [m/s] of velocities, shape (J, I, 2), that are NaN on land."""
    return float(np.nanmax(np.hypot(*np.moveaxis(velocity, -1, 0))))


def _strokes(tail: Array, along: Array) -> Array:
    """Return arrows as line segments in their own level, shape (3 n, 2, 3): shafts, then both sides of the heads.

    matplotlib's own 3D arrows have heads that stand upright, which a depth axis in metres hides.
    """
    tip = tail.copy()
    tip[:, :2] += along
    segments = [np.stack([tail, tip], axis=1)]
    for angle in np.deg2rad([150.0, -150.0]):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        barb = tip.copy()
        barb[:, :2] += 0.35 * along @ turn.T
        segments.append(np.stack([tip, barb], axis=1))
    return np.concatenate(segments)
