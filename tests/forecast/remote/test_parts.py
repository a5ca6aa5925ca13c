"""Which part of a forecast is received, and its pieces: properties."""

from itertools import product
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
    shape, chunks, draws = zip(*axes, strict=True)
    dims, parts = [f"d{k}" for k in range(len(axes))], {}
    for dim, length, data in zip(dims, shape, draws, strict=True):
        start = data.draw(st.integers(0, length - 1))
        parts[dim] = np.arange(start, data.draw(st.integers(start + 1, length)))
    values = np.arange(float(np.prod(shape))).reshape(shape)
    served = SimpleNamespace(ds=xr.Dataset({"u": (dims, values)}), chunks=lambda name: chunks)
    found, seen = np.full([part.size for part in parts.values()], np.nan), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_PIECE", size)
        for source, target in Cut(served, parts, ("u",), ("u",)).pieces("u"):
            assert np.isnan(found[target]).all()
            found[target] = values[source]
            indices = (range(part.start, part.stop) for part in source)
            of = [{at // n for at in own} for own, n in zip(indices, chunks, strict=True)]
            seen += product(*of)
    # the slow twin: the whole at once
    np.testing.assert_array_equal(found, values[np.ix_(*parts.values())])
    assert len(seen) == len(set(seen))


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
