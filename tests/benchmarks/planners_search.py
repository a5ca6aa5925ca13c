"""A fine table of a flow, in which the exhaustive search of one glide tries every heading and time to depth at the size that is asked."""

import weakref
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Grid
from tests.benchmarks.planners_masked import bounds

# Spacing of the table in kernel lengths: linear interpolation is then good to 1e-4 m/s.
_SPACING = 1.0 / 30.0
_tables: "weakref.WeakKeyDictionary[FlowEstimate, Table]" = weakref.WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Table:
    """A flow at the points of a fine grid."""

    grid: Grid
    levels: Array
    origin: Array
    spacing: Array
    components: Array

    def velocity(self, east: Array, north: Array, depth: Array) -> Array:
        """The flow at points, shape (n, 2)."""
        column, row = (np.column_stack([east, north]) - self.origin).T / self.spacing[:, None]
        layer = np.interp(depth, self.levels, np.arange(self.levels.size, dtype=float))
        at = [layer, row, column]
        return np.column_stack(
            [map_coordinates(each, at, order=1, mode="nearest") for each in self.components]
        )


def tabulated(flow: FlowEstimate) -> Table:
    """Return a flow's table, made once."""
    if flow not in _tables:
        low, high = bounds(flow)
        lengths = np.array(
            [flow.horizontal.kernel.length_east, flow.horizontal.kernel.length_north]
        )
        size = np.ceil((high - low) / lengths / _SPACING).astype(int) + 1
        east, north = (np.linspace(low[i], high[i], size[i]) for i in (0, 1))
        rows = [flow.velocity(east[None], y, flow.levels[:, None]) for y in north]
        _tables[flow] = Table(
            flow.grid,
            flow.levels,
            low,
            (high - low) / (size - 1),
            np.ascontiguousarray(np.stack(rows, axis=1).transpose(3, 0, 1, 2)),
        )
    return _tables[flow]
