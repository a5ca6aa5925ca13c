"""Depth slices of a flow for viewers: a regular grid of values and a field of arrows.

The grid is along the local axes, with about the ensemble's spacing and centres near its points. Values are float32 for display; the
estimate is in the attachment ``estimate.npz``.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple
from zlib import crc32

import foxglove.messages as fox
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ReplayKitError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.points import known_at
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.grid import Grid, Projection, Seabed

if TYPE_CHECKING:
    import pandas as pd

#: Frame of all poses: local east, local north, up, so z = -depth.
FRAME = "map"
# The longest arrow of the first slices is this many arrow spacings long.
_ARROW_CELLS = 1.5

# Arrows beyond this many along a side are thinned: a viewer draws each as a mesh.
_MAX_ARROWS_A_SIDE = 40

# Of a grid's cells; the last two only where the flow has an uncertainty.
FIELDS = ("u", "v", "speed", "u_standard_error", "v_standard_error")
_SURFACE = ["time", "longitude", "latitude", "depth", "u", "v", *FIELDS[3:]]
_COLOR = fox.Color(r=0.05, g=0.2, b=0.5, a=1.0)


def stamp(time_ns: int) -> fox.Timestamp:
    """Return a Foxglove timestamp.

    Raises:
        ReplayKitError: The time lies outside 1970..2106, the range of the message.
    """
    try:
        return fox.Timestamp(*divmod(time_ns, 10**9))
    except OverflowError as error:
        raise ReplayKitError(
            f"time {time_ns} ns cannot be written: result files hold times from 1970 to 2106; check the log's clock"
        ) from error


def pose(x: float, y: float, z: float, rotation: fox.Quaternion) -> fox.Pose:
    """Return a pose in the frame ``map``."""
    return fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=rotation)


# a vehicle keeps its heading from one position to the next
@lru_cache(maxsize=8)
def orientation(east: float, north: float, up: float) -> fox.Quaternion:
    """Return the rotation of the x axis to a direction, without roll: yaw 0 = east, counter-clockwise, then nose up."""
    yaw, down = 0.5 * math.atan2(north, east), -0.5 * math.atan2(up, math.hypot(east, north))
    return fox.Quaternion(
        x=-math.sin(yaw) * math.sin(down),
        y=math.cos(yaw) * math.sin(down),
        z=math.sin(yaw) * math.cos(down),
        w=math.cos(yaw) * math.cos(down),
    )


def basis_of(flow: FlowEstimate) -> int:
    """Return a number that identifies the modes of an estimate's window."""
    return crc32(flow.modes.astype("<f4").tobytes())


class Slices(NamedTuple):
    """Flow at some depths on a regular local grid.

    Attributes:
        depths: shape (D,) [m], positive down.
        east: shape (I,) [m], cell centres.
        north: shape (J,) [m], cell centres.
        fields: shape (D, 4, J, I), or (D, 2, J, I) without an uncertainty [m/s]: velocity along local east and north, and its standard
            errors; NaN where dry, outside the ensemble's outline and below its last level.
    """

    depths: Array
    east: Array
    north: Array
    fields: Array

    @property
    def cell(self) -> float:
        """Length of the shorter side of a cell [m]."""
        return float(min(self.east[1] - self.east[0], self.north[1] - self.north[0]))

    @property
    def arrow_stride(self) -> int:
        """Number of cells from one arrow to the next."""
        return -(-max(self.east.size, self.north.size) // _MAX_ARROWS_A_SIDE)


def depth_slices(flow: FlowEstimate, depths: Sequence[float]) -> Slices:
    """Return slices of a flow at depths [m] on a regular grid near the ensemble's own."""
    axes, down = slice_axes(flow.grid), np.array(depths, np.float64)
    # what depends on the place alone is computed once for all depths
    at = (*np.meshgrid(*axes), down[:, None, None])
    parts = [flow.velocity(*at), *([flow.standard_error(*at)] if flow.n_modes else [])]
    known = known_at(flow.grid, *at)[..., None]
    fields = np.where(known, np.concatenate(parts, axis=-1), np.nan)
    return Slices(down, *axes, np.moveaxis(fields, -1, 1))


def slice_axes(grid: Grid) -> tuple[Array, Array]:
    """Return the cell centres of slices of a flow on a grid, east and north [m]."""
    return _axis(grid, grid.east), _axis(grid, grid.north)


def grid_message(time_ns: int, value: Slices, level: int = 0) -> fox.Grid:
    """Return one depth as packed float32 cells of u, v, speed and standard errors of u and v [m/s]; rows go north, columns east.

    Without an uncertainty there are no standard errors.
    """
    u, v, *errors = value.fields[level]
    cells = dict(zip(FIELDS, (u, v, np.hypot(u, v), *errors), strict=False))
    return _packed_grid(time_ns, value.east, value.north, -float(value.depths[level]), cells)


def seabed_message(time_ns: int, value: Seabed) -> fox.Grid:
    """Return the seabed as cells of float32 ``depth`` [m], at the surface of the frame."""
    return _packed_grid(time_ns, value.east, value.north, 0.0, {"depth": value.depth})


def _packed_grid(
    time_ns: int, east: Array, north: Array, height: float, fields: Mapping[str, Array]
) -> fox.Grid:
    """Return fields of shape (J, I) as packed float32 cells about their centres [m]."""
    packed = np.stack(list(fields.values()), axis=-1).astype("<f4")
    wide, high = float(east[1] - east[0]), float(north[1] - north[0])
    float32 = fox.PackedElementFieldNumericType.Float32
    return fox.Grid(
        timestamp=stamp(time_ns),
        frame_id=FRAME,
        pose=pose(east[0] - 0.5 * wide, north[0] - 0.5 * high, height, fox.Quaternion(w=1.0)),
        column_count=east.size,
        cell_size=fox.Vector2(x=wide, y=high),
        row_stride=packed.strides[0],
        cell_stride=packed.strides[1],
        fields=[
            fox.PackedElementField(name=name, offset=4 * index, type=float32)
            for index, name in enumerate(fields)
        ],
        data=packed.tobytes(),
    )


def grid_cells(value: Any) -> tuple[Array, Array, dict[str, Array]]:
    """Return cell centres [m] and fields, each of shape (J, I), of a decoded ``foxglove.Grid`` of packed float32."""
    columns, rows = value.column_count, len(value.data) // value.row_stride
    cells = (
        np.frombuffer(value.data, "<f4")
        .reshape(rows, columns, value.cell_stride // 4)
        .astype(np.float64)
    )
    east = value.pose.position.x + value.cell_size.x * (np.arange(columns) + 0.5)
    north = value.pose.position.y + value.cell_size.y * (np.arange(rows) + 0.5)
    return east, north, {field.name: cells[..., field.offset // 4] for field in value.fields}


def surface_table(messages: Iterable[tuple[int, Any]], projection: Projection) -> "pd.DataFrame":
    """Return the table of cells with a current in decoded messages of ``/flow/surface``, with times, as ``Result.surface``."""
    import pandas as pd

    tables = []
    for time_ns, value in messages:
        east, north, fields = grid_cells(value)
        known = np.isfinite(fields["u"])
        places = to_geographic(projection, *(each[known] for each in np.meshgrid(east, north)))
        found = {name: fields[name][known] for name in FIELDS}
        true = rotate_to_geographic(projection, *places, found["u"], found["v"])
        found |= dict(zip(("longitude", "latitude", "u", "v"), (*places, *true), strict=True))
        about = {"time": pd.Timestamp(time_ns), "depth": -value.pose.position.z}
        tables.append(pd.DataFrame(found).assign(**about)[_SURFACE])
    rows = pd.concat(tables) if tables else pd.DataFrame(columns=_SURFACE)
    return rows.set_index("time")


def arrow_scale(slices: Slices) -> float | None:
    """Return the arrow length for 1 m/s [m], so that the fastest arrow spans 1.5 arrow spacings; None for a flow at rest."""
    speed = np.hypot(slices.fields[:, 0], slices.fields[:, 1])
    fastest = float(np.max(speed, where=speed >= 0.0, initial=0.0))
    return _ARROW_CELLS * (slices.cell * slices.arrow_stride) / fastest if fastest else None


def arrows_message(time_ns: int, value: Slices, level: int, scale: float) -> fox.SceneUpdate:
    """Return one depth as one entity of arrows, which replaces the previous one of this depth.

    Args:
        time_ns: [ns, UTC].
        value: Slices.
        level: Row of the depth.
        scale: Length of an arrow for 1 m/s [m]; also in the entity's metadata.
    """
    step, depth = value.arrow_stride, float(value.depths[level])
    start, width = step // 2, 0.08 * _ARROW_CELLS * value.cell * step
    arrows = []
    for j in range(start, value.north.size, step):
        for i in range(start, value.east.size, step):
            u, v = value.fields[level, :2, j, i].tolist()
            length = scale * float(np.hypot(u, v))
            # Dry cells are NaN, which compares false.
            if length > 0.0:
                arrows.append(
                    _arrow(
                        pose(value.east[i], value.north[j], -depth, orientation(u, v, 0.0)),
                        length,
                        width,
                    )
                )
    entity = fox.SceneEntity(
        timestamp=stamp(time_ns),
        frame_id=FRAME,
        id=f"flow {depth:g} m",
        metadata=[
            fox.KeyValuePair(key="arrow_metres_per_m_s", value=repr(scale)),
            fox.KeyValuePair(key="depth_m", value=repr(depth)),
        ],
        arrows=arrows,
    )
    return fox.SceneUpdate(entities=[entity])


def _arrow(where: fox.Pose, length: float, width: float) -> fox.ArrowPrimitive:
    head = min(0.35 * length, 2.5 * width)
    return fox.ArrowPrimitive(
        pose=where,
        shaft_length=length - head,
        shaft_diameter=min(width, 0.2 * length),
        head_length=head,
        head_diameter=min(2.0 * width, 0.4 * length),
        color=_COLOR,
    )


def _axis(grid: Grid, values: Array) -> Array:
    """Return cell centres along a local axis, near the grid's points and inside the outline of an axis-parallel grid.

    Args:
        grid: The grid.
        values: shape (J, I) [m], coordinate of its points along the axis.
    """
    # the grid's axis that leads along the local one: columns may lead north
    along = int(np.argmax([np.median(np.abs(np.diff(values, axis=axis))) for axis in (0, 1)]))
    cell = float(np.median(grid.steps(along)))
    least, most = float(values.min()), float(values.max())
    # meridians and parallels are bent in the local frame: only their innermost points have all of the axis inside
    beside = min(0.5 * cell, 0.25 * (most - least))
    first = float(values[values <= least + beside].max())
    last = float(values[values >= most - beside].min())
    # at least two centres: a slice's cell size is the distance between them
    return np.linspace(first, last, max(2, round((last - first) / cell) + 1))
