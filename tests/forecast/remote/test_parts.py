"""Which part of a forecast is received, and its pieces: properties."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.config.run import ForecastConfig
from replay_kit.forecast import read_truth
from replay_kit.forecast.remote import fetch as module
from replay_kit.forecast.remote.fetch import Cut
from tests.forecast import forms
from tests.forecast.remote.servers import Files, serving, zarr_objects

pytestmark = pytest.mark.filterwarnings("ignore:Consolidated metadata is currently not part")


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 9), st.integers(1, 5), st.data()), min_size=1, max_size=3),
    st.integers(1, 200),
)
def test_pieces_hold_each_value_once_and_divide_no_chunk(axes, size):
    dims = [f"d{k}" for k in range(len(axes))]
    parts, shape = {}, [length for length, _, _ in axes]
    for dim, (length, _, data) in zip(dims, axes, strict=True):
        start = data.draw(st.integers(0, length - 1))
        parts[dim] = np.arange(start, data.draw(st.integers(start + 1, length)))
    values = np.arange(float(np.prod(shape))).reshape(shape)
    chunks = tuple(chunk for _, chunk, _ in axes)
    served = SimpleNamespace(ds=xr.Dataset({"u": (dims, values)}), chunks=lambda name: chunks)
    cut, most = Cut(served, parts, ("u",), ("u",)), module._PIECE
    found, chunks_seen = np.full([part.size for part in parts.values()], np.nan), []
    try:
        module._PIECE = size
        for source, target in cut.pieces("u"):
            assert np.isnan(found[target]).all()
            found[target] = values[source]
            ends = [
                range(part.start // chunk, (part.stop - 1) // chunk + 1)
                for part, chunk in zip(source, chunks, strict=True)
            ]
            chunks_seen += [
                tuple(at) for at in np.stack(np.meshgrid(*ends), -1).reshape(-1, len(dims))
            ]
    finally:
        module._PIECE = most
    # the slow twin: the whole at once
    np.testing.assert_array_equal(found, values[np.ix_(*parts.values())])
    assert len(chunks_seen) == len(set(chunks_seen))


@pytest.mark.parametrize("cell", [(7, 8), (4, 5), (1, 8), (11, 13)])
def test_a_box_of_a_staggered_grid_is_read_from_its_part_as_from_the_whole(asker, tmp_path, cell):
    ds, _ = forms.roms(forms.rotated(), (14, 16), 0)
    x, y = ds["lon_rho"].values[cell], ds["lat_rho"].values[cell]
    box = (x - 0.12, y - 0.1, x + 0.12, y + 0.1)
    with serving(Files(zarr_objects(ds, zarr_format=2))) as files:
        part = asker(files.url, box)
    assert part.sizes["xi_rho"] < 16
    paths = forms.save(ds, tmp_path / "e.nc"), asker.state.fetched.files[0]
    whole, read = (read_truth(str(path), ForecastConfig(region=box)) for path in paths)
    np.testing.assert_array_equal(read.velocity, whole.velocity)
    np.testing.assert_array_equal(read.grid.longitude, whole.grid.longitude)
