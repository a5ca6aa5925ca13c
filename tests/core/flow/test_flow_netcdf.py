import io
import pickle
import time
from dataclasses import replace

import h5netcdf
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from replay_kit import __version__
from replay_kit.core.errors import ConfigError, EstimatorError, ForecastError
from replay_kit.core.flow.lattice import lattice_over
from replay_kit.core.flow.load import load, load_bytes
from replay_kit.core.flow.lossless import save, save_bytes
from replay_kit.core.flow.netcdf import to_dataset, wet_at, write_grid
from replay_kit.core.geodesy import grid_bearing_of_true_north, rotate_to_geographic, to_local
from replay_kit.core.sealed import sealed
from replay_kit.results.slices import depth_slice
from tests.synthetic_flow import regular


def bits(array):
    return array.shape, array.dtype, np.ascontiguousarray(array).tobytes()


def assert_same_flow(one, other):
    for name in ("latent", "modes", "weight_cov"):
        assert bits(getattr(one, name)) == bits(getattr(other, name)), name
    for name in ("longitude", "latitude", "east", "north", "levels", "wet"):
        assert bits(getattr(one.grid, name)) == bits(getattr(other.grid, name)), name
    assert one.grid.projection == other.grid.projection
    assert (one.horizontal.key, one.depth_functions, one.time_ns) == (
        other.horizontal.key,
        other.depth_functions,
        other.time_ns,
    )


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
@pytest.mark.parametrize("n_modes", [0, 4])
@pytest.mark.parametrize("time_ns", [None, 1_700_000_000_123_456_789])
def test_lossless_round_trip(make_flow, tmp_path, kind, n_modes, time_ns):
    flow = replace(make_flow(kind, n_modes), time_ns=time_ns)
    save(flow, tmp_path / "flow.nc")
    assert_same_flow(flow, load(tmp_path / "flow.nc"))
    assert [path.name for path in tmp_path.iterdir()] == ["flow.nc"]


@settings(deadline=None, max_examples=25)
@given(latent=arrays(np.float64, (68, 3), elements=st.floats(width=64)))
@pytest.mark.full
def test_every_number_survives(make_flow, latent):
    flow = replace(make_flow(), latent=latent)
    assert_same_flow(flow, load_bytes(save_bytes(flow), "flow"))


def test_method_saves(flow, tmp_path):
    flow.save(tmp_path / "flow.nc")
    assert (tmp_path / "flow.nc").read_bytes() == save_bytes(flow)


def test_bytes_are_reproducible(flow):
    first = save_bytes(flow)
    # HDF5 would stamp objects to the second: let one pass.
    time.sleep(1.1)
    assert save_bytes(flow) == first


def test_no_lock_is_asked_of_a_scheduler(flow, monkeypatch):
    # xarray names the lock after the buffer's address, which the next mission on a worker uses again
    expected = save_bytes(flow)
    monkeypatch.setattr("xarray.backends.h5netcdf_.get_write_lock", None)
    assert save_bytes(flow) == expected


def test_load_refuses_other_files(flow, tmp_path):
    path = tmp_path / "other.nc"
    with pytest.raises(ForecastError, match="cannot read"):
        load(path)
    path.write_bytes(b"no NetCDF at all")
    with pytest.raises(
        ForecastError,
        match=r"expected a file of --save-estimate \(NetCDF-4\), but it is not one, or is damaged",
    ):
        load(path)
    write_grid(flow, path)
    with pytest.raises(
        ForecastError, match="expected a file of --save-estimate, got another NetCDF file"
    ):
        load(path)


def before_version_4(dataset):
    """Return a file's content without what version 4 says of the horizontal functions, which were a kernel of the grid's nodes."""
    dataset = dataset.drop_vars(["node_east", "node_north"])
    del dataset.attrs["horizontal_functions"]
    return dataset


def version_1(flow, path):
    """Write a flow as replay-kit did before its files followed CF: time as an integer, the depth of ``wet`` first, no metadata."""
    save(flow, path)
    with xr.open_dataset(path, engine="h5netcdf", decode_cf=False) as opened:
        dataset = before_version_4(opened.load())
    dataset = dataset.drop_vars("time", errors="ignore").assign(
        wet=dataset["wet"].transpose("depth", "y", "x")
    )
    if flow.time_ns is not None:
        dataset["time"] = ((), np.int64(flow.time_ns))
    dataset.attrs["replay_kit_format_version"] = 1
    for name in ("Conventions", "title", "history"):
        del dataset.attrs[name]
    dataset.to_netcdf(
        path,
        engine="h5netcdf",
        encoding={str(name): {"_FillValue": None} for name in dataset.variables},
    )


@pytest.mark.parametrize("n_modes", [0, 4])
@pytest.mark.parametrize("time_ns", [None, 1_700_000_000_123_456_789])
def test_files_of_version_1_still_open(make_flow, tmp_path, n_modes, time_ns):
    flow = replace(make_flow(n_modes=n_modes), time_ns=time_ns)
    version_1(flow, tmp_path / "flow.nc")
    with pytest.warns(UserWarning, match="no checksum"):
        assert_same_flow(flow, load(tmp_path / "flow.nc"))


@pytest.mark.parametrize("n_modes", [0, 4])
def test_a_flow_on_a_lattice_survives_a_file_and_a_pickle(flow, n_modes):
    lattice, rng = lattice_over(flow.horizontal.kernel, flow.nodes), np.random.default_rng(0)
    latent, modes = (
        rng.normal(size=(lattice.size, flow.levels.size)),
        rng.normal(size=(lattice.size, n_modes)),
    )
    on_lattice = replace(
        flow if n_modes else flow.mean_flow(), horizontal=lattice, latent=latent, modes=modes
    )
    for again in (
        load_bytes(save_bytes(on_lattice), "flow"),
        pickle.loads(pickle.dumps(on_lattice)),
    ):
        assert_same_flow(on_lattice, again)
        np.testing.assert_array_equal(
            again.velocity(1e3, 2e3, 60.0), on_lattice.velocity(1e3, 2e3, 60.0)
        )


def test_nodes_that_are_not_the_grid_s_survive(flow):
    moved = replace(flow, horizontal=replace(flow.horizontal, nodes=flow.nodes + 100.0))
    assert_same_flow(moved, load_bytes(save_bytes(moved), "flow"))


def test_functions_that_nobody_knows_are_refused(flow, tmp_path):
    save(flow, tmp_path / "flow.nc")
    with h5netcdf.File(tmp_path / "flow.nc", "a") as file:
        file.attrs["horizontal_functions"] = "splines"
    with pytest.raises(ForecastError, match="its checksum is missing"):
        load(tmp_path / "flow.nc")
    (tmp_path / "flow.nc").write_bytes(sealed((tmp_path / "flow.nc").read_bytes()))
    with pytest.raises(ForecastError, match="expected 'node kernel' or 'stream function lattice'"):
        load(tmp_path / "flow.nc")


@pytest.mark.parametrize(
    "time_ns", [0, 1, 999_999_999, 1_700_000_000_000_000_001, 4_102_444_799_999_999_999]
)
def test_the_time_is_exact_and_other_readers_have_it_to_the_microsecond(flow, time_ns):
    data = save_bytes(replace(flow, time_ns=time_ns))
    assert load_bytes(data, "flow").time_ns == time_ns
    with xr.open_dataset(io.BytesIO(data), engine="h5netcdf") as dataset:
        assert abs(dataset["time"].values - np.datetime64(time_ns, "ns")) < np.timedelta64(1, "us")


def test_history_names_program_version_and_estimate_and_no_time_of_writing(
    flow,
):
    expected = f"replay-kit {__version__}: to_dataset(flow, time = 2023-11-14T22:13:20.123456789Z)"
    assert to_dataset(flow).attrs["history"] == expected
    assert (
        to_dataset(replace(flow, time_ns=None)).attrs["history"]
        == f"replay-kit {__version__}: to_dataset(flow)"
    )


def test_load_refuses_other_versions_and_damage(flow, tmp_path):
    path = tmp_path / "flow.nc"
    save(flow, path)
    with h5netcdf.File(path, "a") as file:
        file.attrs["replay_kit_format_version"] = 99
    with pytest.raises(ForecastError, match="version 99"):
        load(path)
    data = save_bytes(flow)
    with pytest.raises(ForecastError):
        load_bytes(data[: len(data) // 2], "half")
    with pytest.raises(ForecastError, match="do not fit"):
        load_bytes(
            save_bytes(replace(flow, latent=flow.latent[:-2], modes=flow.modes[:-2])), "mismatch"
        )


@pytest.mark.parametrize("bit", range(0, 8))
def test_a_saved_estimate_with_one_flipped_bit_is_refused_wherever_it_is(flow, tmp_path, bit):
    data = save_bytes(flow)
    for place in np.linspace(0, len(data) - 1, 40).astype(int):
        damaged = bytearray(data)
        damaged[place] ^= 1 << bit
        (tmp_path / "flow.nc").write_bytes(damaged)
        with pytest.raises(ForecastError, match=r"flow\.nc: .*checksum.*copy it again"):
            load(tmp_path / "flow.nc")


def test_a_failed_write_leaves_nothing(flow, tmp_path):
    with pytest.raises(ConfigError, match="cannot be written"):
        save(flow, tmp_path / "missing" / "flow.nc")
    assert not list(tmp_path.iterdir())


def test_dataset_says_what_cf_asks(flow):
    dataset = to_dataset(flow)
    assert dataset.attrs["Conventions"] == "CF-1.8, CF-1.11, ACDD-1.3"
    assert dataset.u.dims == ("depth", "y", "x")
    for name, standard_name in (
        ("u", "eastward_sea_water_velocity"),
        ("v", "northward_sea_water_velocity"),
    ):
        assert dataset[name].attrs["standard_name"] == standard_name
        assert dataset[name].attrs["units"] == "m s-1"
        assert dataset[name].attrs["ancillary_variables"] == f"{name}_standard_error"
        assert (
            dataset[f"{name}_standard_error"].attrs["standard_name"]
            == f"{standard_name} standard_error"
        )
        assert dataset[f"{name}_standard_error"].attrs["units"] == "m s-1"
    assert dataset.depth.attrs == {
        "standard_name": "depth",
        "long_name": "depth below the surface",
        "units": "m",
        "positive": "down",
        "axis": "Z",
        "coverage_content_type": "coordinate",
    }
    assert dataset.longitude.attrs["units"] == "degrees_east"
    assert dataset.latitude.attrs["units"] == "degrees_north"
    assert dataset.time.values == np.datetime64(flow.time_ns, "ns")
    np.testing.assert_array_equal(np.isnan(dataset.u.values), ~flow.grid.wet)
    np.testing.assert_array_equal(np.isnan(dataset.v_standard_error.values), ~flow.grid.wet)


def test_dataset_without_uncertainty_or_time(make_flow):
    dataset = to_dataset(replace(make_flow(n_modes=0), time_ns=None))
    assert set(dataset.variables) == {"u", "v", "depth", "longitude", "latitude"}
    assert "ancillary_variables" not in dataset.u.attrs


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_vectors_turn_to_true_axes_on_a_wide_region(make_flow, kind):
    flow = make_flow(kind, spacing=150_000.0)
    grid = flow.grid
    bearing = grid_bearing_of_true_north(grid.projection, grid.longitude, grid.latitude)
    assert np.rad2deg(np.abs(bearing).max()) > 5.0
    local = flow.velocity(grid.east, grid.north, grid.levels[:, None, None])
    u, v = rotate_to_geographic(
        grid.projection, grid.longitude, grid.latitude, local[..., 0], local[..., 1]
    )
    dataset = to_dataset(flow)
    np.testing.assert_allclose(dataset.u.values[grid.wet], u[grid.wet], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(dataset.v.values[grid.wet], v[grid.wet], rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_standard_errors_turn_with_their_covariance(make_flow, kind):
    """The slow twin: each column of a factor of the covariance is a flow; its dataset's components squared add up."""
    flow = make_flow(kind, n_modes=2, spacing=150_000.0)
    axes = {"longitude": [0.0, 4.0, 9.0], "latitude": [60.0, 63.0], "depth": [0.0, 30.0, 120.0]}
    dataset = to_dataset(flow, **axes)
    total = {"u": 0.0, "v": 0.0}
    for column in np.linalg.cholesky(flow.weight_cov).T:
        part = replace(flow.mean_flow(), latent=flow.modes @ column.reshape(3, 2).T)
        for name in total:
            total[name] = total[name] + to_dataset(part, **axes)[name].values ** 2
    for name, variance in total.items():
        np.testing.assert_allclose(
            dataset[f"{name}_standard_error"].values ** 2, variance, rtol=1e-10
        )


def test_standard_error_at_the_centre_is_the_flow_s_own(flow):
    dataset = to_dataset(flow, [5.0], [62.0], [25.0, 90.0])
    np.testing.assert_allclose(
        dataset.u_standard_error.values[:, 0, 0],
        flow.standard_error(0.0, 0.0, [25.0, 90.0])[:, 0],
        rtol=1e-9,
    )


def test_product_grid(flow):
    longitude, latitude, depth = [4.9, 5.0, 5.1], [61.95, 62.05], [0.0, 25.0, 1_000.0]
    dataset = flow.to_xarray(longitude, latitude, depth)
    assert dataset.u.dims == ("depth", "latitude", "longitude")
    assert (dataset.longitude.attrs["axis"], dataset.latitude.attrs["axis"]) == ("X", "Y")
    east, north = to_local(flow.grid.projection, 5.1, 62.05)
    expected = np.hypot(*flow.velocity(east, north, 25.0))
    assert float(
        np.hypot(dataset.u, dataset.v).sel(longitude=5.1, latitude=62.05, depth=25.0)
    ) == pytest.approx(expected, rel=1e-10)
    # the third depth is below the last level
    assert np.isfinite(dataset.u.values[:2]).all()


def test_product_grid_is_empty_off_the_region_and_on_land(flow):
    grid = flow.grid
    dataset = to_dataset(flow, [grid.longitude[0, 0], 5.0, 20.0], [grid.latitude[0, 0]], [10.0])
    assert np.isnan(dataset.u.values[0, 0]).tolist() == [True, False, True]


def test_below_the_last_level_nothing_is_known_of_velocity_or_error(flow):
    """One rule: a point's velocity is continued, its error is not known, and a grid shows neither."""
    grid, last = flow.grid, float(flow.levels[-1])
    row, column = np.argwhere(grid.wet[-1])[0]
    axes = {"longitude": [grid.longitude[row, column]], "latitude": [grid.latitude[row, column]]}
    depths = np.array([0.0, last, np.nextafter(last, np.inf), last + 500.0])
    dataset = to_dataset(flow, **axes, depth=depths)
    below = np.array([False, False, True, True])
    for name in ("u", "v", "u_standard_error", "v_standard_error"):
        np.testing.assert_array_equal(np.isnan(dataset[name].values.ravel()), below, err_msg=name)
    place = grid.east[row, column], grid.north[row, column]
    np.testing.assert_array_equal(np.isnan(flow.standard_error(*place, depths)[:, 0]), below)
    np.testing.assert_array_equal(flow.velocity(*place, last + 500.0), flow.velocity(*place, last))
    assert np.isnan(depth_slice(flow, last + 500.0).velocity).all()
    assert np.isfinite(depth_slice(flow, last).velocity).any()


def test_wet_at_agrees_with_the_grid(flow):
    grid = flow.grid
    np.testing.assert_array_equal(
        wet_at(grid, grid.east, grid.north, grid.levels[:, None, None]), grid.wet
    )
    assert wet_at(grid, 2_500.0, 2_500.0, 10.0)
    assert not wet_at(grid, 19_000.0, 0.0, 10.0)


def test_regular_grid_gets_one_dimensional_axes(flow):
    even = regular(flow)
    dataset = to_dataset(even)
    assert dataset.u.dims == ("depth", "latitude", "longitude")
    np.testing.assert_array_equal(dataset.longitude.values, even.grid.longitude[0])


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        (([5.0], None, None), "together"),
        (([5.0], [62.0], None), "together"),
        (([5.0], None, [1.0]), "together"),
        ((None, [62.0], [1.0]), "together"),
        (([[5.0]], [62.0], [1.0]), "one-dimensional"),
        (([], [62.0], [1.0]), "one-dimensional"),
    ],
)
def test_incomplete_axes_are_refused(flow, axes, words):
    with pytest.raises(EstimatorError, match=words):
        to_dataset(flow, *axes)


def test_written_grid_reads_back(flow, tmp_path):
    path = tmp_path / "grid.nc"
    write_grid(flow, path)
    expected = to_dataset(flow)
    with xr.open_dataset(path, engine="h5netcdf") as dataset:
        for name in ("u", "v", "u_standard_error", "v_standard_error", "longitude", "depth"):
            np.testing.assert_array_equal(dataset[name].values, expected[name].values)
            assert dataset[name].dtype == np.float64
        assert abs(dataset.time.values - expected.time.values) < np.timedelta64(1, "us")
    with h5netcdf.File(path) as file:
        assert set(file["u"].attrs["coordinates"].split()) == {"latitude", "longitude", "time"}
        assert "_FillValue" not in file["depth"].attrs
