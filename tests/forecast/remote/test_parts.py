"""Which part of a forecast is received, and its pieces: properties."""

from types import SimpleNamespace

import numpy as np
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.config.run import ForecastConfig
from replay_kit.forecast.members.collection import open_collection
from replay_kit.forecast.remote import fetch as module
from replay_kit.forecast.remote.fetch import Cut
from replay_kit.forecast.remote.parts import Wanted, parts_of
from tests.forecast import forms


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


def test_a_box_of_a_staggered_grid_has_two_cells_around_it(tmp_path):
    ds, _ = forms.roms(forms.rotated(), (14, 16), 0)
    x, y = ds["lon_rho"].values, ds["lat_rho"].values
    with open_collection(forms.save(ds, tmp_path / "e.nc"), None) as found:
        ((field,),) = found.members
        for j, i in ((7, 8), (4, 5), (2, 3), (11, 13)):
            box = x[j, i] - 0.06, y[j, i] - 0.05, x[j, i] + 0.06, y[j, i] + 0.05
            taken = parts_of(field, Wanted(box), ForecastConfig(), "", True)
            # the centres of the first row and column have faces on one side alone
            rows, columns = np.nonzero(
                ((box[0] <= x) & (x <= box[2]) & (box[1] <= y) & (y <= box[3]))[1:, 1:]
            )
            for inside, dim, of_faces in ((rows + 1, "eta", "eta_v"), (columns + 1, "xi", "xi_u")):
                first, stop = max(0, inside.min() - 2), inside.max() + 3
                stop = min(stop, ds.sizes[f"{dim}_rho"])
                np.testing.assert_array_equal(taken[f"{dim}_rho"], np.arange(first, stop))
                # a face fewer than centres
                np.testing.assert_array_equal(taken[of_faces], np.arange(first, stop - 1))
