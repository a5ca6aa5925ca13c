"""Slices of a flow: where their cells lie, and that the current and its standard error are there together or not at all."""

from functools import partial

import numpy as np
import pytest

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.results import ResultReader, ResultWriter
from replay_kit.results.slices import depth_slices
from replay_kit.results.views.current import published_slices
from tests.results.cases import on, turned


def of_parallels(flow: FlowEstimate) -> FlowEstimate:
    """Return a flow on a grid of meridians and parallels, which are bent in the local frame."""
    return on(
        flow,
        *to_local(
            flow.grid.projection, *np.meshgrid(np.linspace(4.4, 5.6, 7), np.linspace(61.7, 62.3, 5))
        ),
    )


GRIDS = {
    "parallels": of_parallels,
    "turned by 1 degree": partial(turned, degrees=1.0),
    "turned by 35 degrees": partial(turned, degrees=35.0),
    "columns north": partial(turned, degrees=90.0),
}


@pytest.mark.parametrize("name", GRIDS)
def test_current_and_standard_error_are_known_at_the_same_cells(flow, tmp_path, name):
    placed = GRIDS[name](flow)
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.grids(0, placed, [10.0, 200.0])
    slices = published_slices(ResultReader(tmp_path / "out.mcap"))
    known = np.isfinite(slices.fields[:, 0])
    np.testing.assert_array_equal(known, known[:, :1].repeat(4, axis=1))
    outside = ~inside_grid(placed.grid, *np.meshgrid(slices.east, slices.north))
    assert not known[:, 0, outside].any()
    assert known[0, 0, ~outside].mean() > 0.85


@pytest.mark.parametrize("name", ["parallels", "turned by 1 degree", "columns north"])
def test_a_slice_has_a_cell_near_each_point_of_a_grid_along_the_axes(flow, name):
    placed = GRIDS[name](flow)
    found = depth_slices(placed, [10.0])
    assert {found.east.size, found.north.size} == {5, 7}
    east, north = np.meshgrid(found.east, found.north)
    assert inside_grid(placed.grid, east, north).all()
    apart = np.abs(
        placed.grid.east.ravel()
        + 1j * placed.grid.north.ravel()
        - (east + 1j * north).reshape(-1, 1)
    ).min(axis=1)
    assert apart.max() < 0.25 * found.cell
    # the only dry point of the first level is a corner
    assert np.isfinite(found.fields[0, 0]).sum() >= 0.75 * east.size
