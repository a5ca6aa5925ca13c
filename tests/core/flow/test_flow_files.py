"""Files of estimates: bit for bit there and back, refused where they are damaged or of another version, and CF for other readers."""

import pickle
import time
from dataclasses import fields, is_dataclass, replace

import h5netcdf
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.core.errors import ConfigError, EstimatorError, ForecastError
from replay_kit.core.files.atomic import sealed
from replay_kit.core.flow.dataset import to_dataset, wet_at, write_grid
from replay_kit.core.flow.file import load, load_bytes, pack, save_bytes, unpack
from tests.core.flow.made import HOUR, LOCAL, SURFACE, changing
from tests.synthetic_flow import TIME_NS, regular


def assert_same(one, other, name="flow"):
    """Every number of two values, bit for bit."""
    if is_dataclass(one):
        assert type(one) is type(other), name
        for each in fields(one):
            assert_same(getattr(one, each.name), getattr(other, each.name), f"{name}.{each.name}")
    elif isinstance(one, np.ndarray):
        assert (one.shape, one.dtype) == (other.shape, other.dtype), name
        assert np.ascontiguousarray(one).tobytes() == np.ascontiguousarray(other).tobytes(), name
    else:
        assert one == other, name


FLAGS = ("on_lattice", "potential")


@settings(max_examples=6)
@given(
    st.integers(1, 4),
    st.integers(0, 3),
    st.sampled_from([None, 0, TIME_NS + 1]),
    st.sampled_from([1, 4]),
    st.fixed_dictionaries(
        dict.fromkeys(FLAGS, st.booleans())
        | {"turning": st.integers(0, 2), "kind": st.sampled_from(["hat", "gaussian"])}
    ),
    st.sampled_from([{}, {"local": LOCAL, "surface": SURFACE, "about": {"source": "\u00e9"}}]),
)
def test_every_kind_of_flow_survives_a_file_and_a_pickle(moving, fixed, time_ns, times, of, beside):
    flow = replace(changing(moving, fixed, time_ns, times, **of), **beside).at(TIME_NS + HOUR)
    data, packed = save_bytes(flow), pack(flow)
    for again in (load_bytes(data, "flow"), pickle.loads(pickle.dumps(flow))):
        assert_same(flow, again)
    assert save_bytes(again) == data
    # in results all but patterns and covariance are as they were
    again = unpack(packed, "flow")
    assert pack(flow) == packed
    ours, theirs = again.unknowns, flow.unknowns
    assert_same(replace(again, modes=flow.modes, unknowns=theirs), flow)
    assert_same(replace(ours, process=theirs.process, p=theirs.p), theirs)
    np.testing.assert_allclose(ours.p, theirs.p, atol=3e-6)
    assert np.linalg.eigvalsh(ours.p).min() >= 0.9 * np.linalg.eigvalsh(theirs.p).min()
    at = (flow.nodes[:, 0], flow.nodes[:, 1], 20.0)
    np.testing.assert_allclose(again.standard_error(*at), flow.standard_error(*at), rtol=1e-5)
    found, expected = (each.moved(flow.time_ns + HOUR).velocity(*at) for each in (again, flow))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
    alone = replace(flow.mean_flow(), time_ns=time_ns)
    assert_same(alone, load_bytes(save_bytes(alone), "flow"))
    assert_same(alone, unpack(pack(alone), "flow"))


def test_every_number_survives_and_files_are_alike_whenever_they_are_written(
    flow, tmp_path, monkeypatch
):
    odd = np.resize([np.nan, np.inf, -0.0, 5e-324, 1.7e308, -np.inf], flow.latent.shape)
    moved = replace(flow.horizontal, nodes=flow.nodes + 100.0)
    flow = replace(flow, latent=odd, horizontal=moved)
    first = save_bytes(flow)
    assert_same(flow, load_bytes(first, "flow"))
    # HDF5 would stamp objects to the second: let one pass
    time.sleep(1.1)
    flow.save(tmp_path / "flow.nc")
    assert (tmp_path / "flow.nc").read_bytes() == first
    assert [path.name for path in tmp_path.iterdir()] == ["flow.nc"]
    # xarray names the lock after the buffer's address, which the next mission on a worker uses again
    monkeypatch.setattr("xarray.backends.h5netcdf_.get_write_lock", None)
    assert save_bytes(flow) == first
    with pytest.raises(ConfigError, match="cannot be written"):
        flow.save(tmp_path / "missing" / "flow.nc")


def test_other_files_and_damage_are_refused(flow, tmp_path):
    path = tmp_path / "other.nc"

    def refused(words):
        with pytest.raises(ForecastError, match=words):
            load(path)

    refused("cannot read")
    path.write_bytes(b"no NetCDF at all")
    refused(r"a file of --save-estimate \(NetCDF-4\), but it")
    write_grid(flow, path)
    refused("got another NetCDF file")
    flow.save(path)
    with h5netcdf.File(path, "a") as file:
        file.attrs["horizontal_functions"] = "splines"
    refused("its checksum is missing")
    path.write_bytes(sealed(path.read_bytes()))
    refused("expected 'node kernel' or 'stream function lattice'")
    path.write_bytes(save_bytes(replace(flow.mean_flow(), latent=flow.latent[:-2])))
    refused("do not fit")
    data = save_bytes(flow)
    for place in np.linspace(0, len(data) - 1, 99).astype(int):
        damaged = bytearray(data)
        damaged[place] ^= 1 << place % 8
        for bad in (damaged, data[:place]):
            with pytest.raises(ForecastError, match=r"mission: .*copy it again"):
                load_bytes(bytes(bad), "mission")


def test_a_grid_has_the_velocities_of_its_points_and_reads_back(flow, tmp_path):
    dataset = to_dataset(flow)
    at = flow.grid.east, flow.grid.north, flow.levels[:, None, None], True
    for values, names in (
        (flow.velocity(*at), ("u", "v")),
        (flow.standard_error(*at), ("u_standard_error", "v_standard_error")),
    ):
        known = np.where(flow.grid.wet[..., None], values, np.nan)
        found = np.stack([dataset[name] for name in names], axis=-1)
        np.testing.assert_allclose(found, known, rtol=1e-9, atol=1e-12)
    bare = to_dataset(replace(flow.mean_flow(), time_ns=None))
    assert set(bare.variables) == {"u", "v", "depth", "longitude", "latitude"}
    write_grid(flow, tmp_path / "grid.nc")
    with xr.open_dataset(tmp_path / "grid.nc", engine="h5netcdf") as read:
        for name in ("u", "v_standard_error", "longitude", "depth"):
            np.testing.assert_array_equal(read[name].values, dataset[name].values)
        assert abs(read.time.values - dataset.time.values) < np.timedelta64(1, "us")
    with h5netcdf.File(tmp_path / "grid.nc") as file:
        assert set(file["u"].attrs["coordinates"].split()) == {"latitude", "longitude", "time"}


def test_a_regular_grid_has_axes_and_nothing_is_known_off_the_region_on_land_and_below(flow):
    even, grid = regular(flow), flow.grid
    dataset = to_dataset(even)
    assert dataset.u.dims == ("depth", "latitude", "longitude")
    np.testing.assert_array_equal(dataset.longitude.values, even.grid.longitude[0])
    land = to_dataset(flow, [grid.longitude[0, 0], 5.0, 20.0], [grid.latitude[0, 0]], [10.0])
    assert np.isnan(land.u.values[0, 0]).tolist() == [True, False, True]
    assert not wet_at(grid, 19_000.0, 0.0, 10.0)
    last = float(flow.levels[-1])
    depths = np.array([0.0, last, np.nextafter(last, np.inf), last + 500.0])
    column = to_dataset(flow, [5.0], [62.0], depths).to_array().values
    assert np.isnan(column).reshape(4, 4).all(axis=0).tolist() == [False, False, True, True]
    assert np.isnan(flow.standard_error(0.0, 0.0, depths)[:, 0]).tolist()[1:] == [False, True, True]
    np.testing.assert_array_equal(*flow.velocity(0.0, 0.0, depths[[1, 3]]))
    for axes, words in (([5.0],), "together"), (([[5.0]], [62.0], [1.0]), "one-dimensional"):
        with pytest.raises(EstimatorError, match=words):
            to_dataset(flow, *axes)
