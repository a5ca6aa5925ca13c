"""Members as slices of velocities at the kernel's nodes, and the scales of the grid and of the members.

Everything that a basis needs of an ensemble is a sum over nodes, so members are read by blocks of grid rows: an ensemble on disk is never
in memory as a whole.
"""

from collections.abc import Iterator

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.grid import Ensemble, Grid

# Values of all members in a block of rows, 32 MB.
_BLOCK_VALUES = 4_000_000


def ensemble_slices(ensemble: Ensemble) -> Array:
    """Return the members' velocities at the nodes, shape (E, Z, 2N) [m/s]; see ``slice_blocks``."""
    n_members, n_levels = ensemble.n_members, ensemble.grid.levels.size
    out = np.empty((n_members, n_levels, 2, int(ensemble.grid.wet[0].sum())))
    for nodes, block in slice_blocks(ensemble):
        out[..., nodes] = block
    return out.reshape(n_members, n_levels, -1)


def slice_blocks(ensemble: Ensemble) -> Iterator[tuple[slice, Array]]:
    """Yield which nodes, and the members' velocities at them, shape (E, Z, 2, n) [m/s], until all nodes were given.

    Below the sea floor a column keeps the velocity of its deepest wet level, so that modes have no jump there; the grid's mask
    keeps such points out of every result.
    """
    first = 0
    for start, stop in _rows(ensemble):
        wet = ensemble.grid.wet[:, start:stop]
        at_nodes = ensemble.rows(start, stop)[..., wet[0]]  # (E, 2, Z, n)
        for z in range(1, len(wet)):
            dry = ~wet[z][wet[0]]
            at_nodes[:, :, z, dry] = at_nodes[:, :, z - 1, dry]
        nodes = slice(first, first + at_nodes.shape[3])
        first = nodes.stop
        yield nodes, np.moveaxis(at_nodes, 2, 1)


def _rows(ensemble: Ensemble) -> Iterator[tuple[int, int]]:
    """Yield the first and last row of blocks of rows."""
    n_levels, n_rows, n_columns = ensemble.grid.wet.shape
    step = max(1, _BLOCK_VALUES // (2 * ensemble.n_members * n_levels * n_columns))
    for start in range(0, n_rows, step):
        yield start, min(start + step, n_rows)


def surface_speed(ensemble: Ensemble) -> float:
    """Return the root mean square of a component of all members at the nodes of the first level [m/s]."""
    top = ensemble.grid.wet[0]
    squares = sum(
        float(np.sum(np.square(ensemble.rows(start, stop, 0)[:, :, 0, top[start:stop]])))
        for start, stop in _rows(ensemble)
    )
    return float(np.sqrt(squares / (2 * ensemble.n_members * int(top.sum()))))


def cell_size(grid: Grid) -> tuple[float, float]:
    """Return the median spacing of grid points [m] along its two directions, the one nearer to east-west first."""
    along_i = np.hypot(np.diff(grid.east, axis=1), np.diff(grid.north, axis=1))
    along_j = np.hypot(np.diff(grid.east, axis=0), np.diff(grid.north, axis=0))
    sizes = float(np.median(along_i)), float(np.median(along_j))
    i_is_east = np.median(np.abs(np.diff(grid.east, axis=1))) >= np.median(
        np.abs(np.diff(grid.north, axis=1))
    )
    return sizes if i_is_east else sizes[::-1]


def correlation_length(ensemble: Ensemble) -> float:
    """Return the correlation length of the members' anomalies [m]: the standard deviation over that of the gradient.

    That is the scale of the correlation's parabola at zero distance (Daley 1991, Atmospheric Data Analysis, section 4.3), pooled over
    components, levels and both directions of the grid. It is at least one cell, the resolution of the grid.
    """
    grid, n_rows = ensemble.grid, ensemble.grid.wet.shape[1]
    square, slopes = 0.0, np.zeros(2)
    for start, stop in _rows(ensemble):
        # one row more, for the gradients to the next block
        part = slice(start, min(stop + 1, n_rows))
        anomalies, wet = ensemble.rows(part.start, part.stop), grid.wet[:, part]
        anomalies -= anomalies.mean(axis=0)
        anomalies[..., ~wet] = 0.0
        own = stop - start
        square += float(np.sum(np.square(anomalies[:, :, :, :own])))
        for axis, rows in ((0, part.stop - start), (1, own)):
            spacing = np.hypot(
                *(np.diff(place[part][:rows], axis=axis) for place in (grid.east, grid.north))
            )
            water, values = wet[:, :rows], anomalies[:, :, :, :rows]
            both = np.delete(water, -1, axis=axis + 1) & np.delete(water, 0, axis=axis + 1)
            slopes[axis] += np.sum(np.square(np.diff(values, axis=axis + 3) * (both / spacing)))
    n_values = 2 * ensemble.n_members
    pairs = np.array(
        [
            np.sum(np.delete(grid.wet, -1, axis=axis) & np.delete(grid.wet, 0, axis=axis))
            for axis in (1, 2)
        ]
    )
    cell = float(np.sqrt(np.prod(cell_size(grid))))
    slope = float(np.mean(slopes / (n_values * pairs)))
    return (
        max(cell, float(np.sqrt(square / (n_values * grid.wet.sum()) / slope)))
        if slope > 0.0
        else cell
    )
