"""Pieces of a part: properties."""

from types import SimpleNamespace

import numpy as np
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.forecast.remote import cut as module
from replay_kit.forecast.remote.cut import Cut


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
        parts[dim] = (slice(start, data.draw(st.integers(start + 1, length))),)
    values = np.arange(float(np.prod(shape))).reshape(shape)
    chunks = tuple(chunk for _, chunk, _ in axes)
    served = SimpleNamespace(ds=xr.Dataset({"u": (dims, values)}), chunks=lambda name: chunks)
    cut, most = Cut(served, parts, ("u",), ("u",)), module._PIECE
    found, chunks_seen = np.full(cut.shape("u"), np.nan), []
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
    np.testing.assert_array_equal(found, values[tuple(parts[dim][0] for dim in dims)])
    assert len(chunks_seen) == len(set(chunks_seen))
