"""Pieces of a part, and descriptions of OPeNDAP: properties, and what is damaged."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.core.errors import ForecastError
from replay_kit.forecast.remote import cut as module
from replay_kit.forecast.remote.cut import Cut
from replay_kit.forecast.remote.opendap import read_das, read_dds, read_dods


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


def test_descriptions_are_read_in_the_order_of_the_data():
    text = """Dataset {
      Float64 time[time = 2];
      Grid { ARRAY: Int16 u[time = 2][lat%5Fx = 3]; MAPS: Float64 time[time = 2]; Float32 lat%5Fx[lat%5Fx = 3]; } u;
      Structure { Byte flag; Int32 plain[4]; } more;
      Sequence { String s; } rows;
    } forecast;"""
    names = [(one.name, one.kind, one.dims) for one in read_dds(text, "https://h/x")]
    assert names == [
        ("time", "float64", (("time", 2),)),
        ("u", "int16", (("time", 2), ("lat_x", 3))),
        ("time", "float64", (("time", 2),)),
        ("lat_x", "float32", (("lat_x", 3),)),
        ("flag", "byte", ()),
        ("plain", "int32", (("", 4),)),
    ]
    attributes = read_das(
        'Attributes { u { String units "m s-1; \\"x\\""; Int16 _FillValue -9; Float32 r 1.5, NaN; } NC_GLOBAL { String title "t"; } }'
    )
    assert attributes["u"]["units"] == 'm s-1; "x"'
    assert attributes["u"]["_FillValue"] == -9
    assert attributes["NC_GLOBAL"] == {"title": "t"}


@given(st.binary(max_size=80), st.integers(0, 120))
def test_damaged_answers_are_errors_in_words(noise, place):
    text = b"Dataset {\n Int16 u[x = 2];\n} f;\nData:\n" + np.array([2, 2, 7, -8], ">i4").tobytes()
    np.testing.assert_array_equal(read_dods(text, "u", "https://h/x"), [7, -8])
    words = "https://h/x: "
    try:
        assert read_dods(text[:place] + noise, "u", "https://h/x").ndim == 1
    except ForecastError as error:
        words = str(error)
    assert words.startswith("https://h/x: ")
    with pytest.raises(ForecastError, match="the server answers: too large; ask for less"):
        read_dods(b'Error { code = 3; message = "too large"; };', "u", "https://h/x")
