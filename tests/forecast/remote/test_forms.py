"""A forecast on a server in each form: the same values, and no more of them than asked for."""

import importlib.util
import re
import sys
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
import zarr

from replay_kit.forecast.remote.kept import record_of
from tests.forecast.remote.conftest import refused, sea
from tests.forecast.remote.servers import Files, griddap, opendap, serving, zarr_objects

pytestmark = pytest.mark.filterwarnings("ignore:Consolidated metadata is currently not part")
SPAN = {"start": "2018-11-16T06:00Z", "end": "2018-11-17T12:00Z"}


def needs(package):
    """Skip where a server is not installed; importing it would warn."""
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")


def expected():
    """The part in the box, at the levels down to one below 60 m, from the time before the span to the one after it."""
    part = sea().sel(lat=slice(-39.5001, -38.4999), lon=slice(152.9999, 154.5001))
    return part.isel(depth=slice(0, 3), time=slice(1, 4))


def assert_same(found):
    # griddap has these names for its axes
    found = found.rename({"latitude": "lat", "longitude": "lon"}) if "latitude" in found else found
    for name in ("uo", "vo", "time", "depth", "lat", "lon", "member"):
        np.testing.assert_array_equal(found[name].values, expected()[name].values)
    assert found.uo.attrs["standard_name"] == "eastward_sea_water_velocity"


PART = {"logs": SPAN, "levels": (5.0, 60.0)}


@contextmanager
def netcdf(ds):
    files = Files({"e.nc": ds.to_netcdf(engine="h5netcdf").tobytes()})
    with serving(files):
        yield f"{files.url}/e.nc"


@pytest.mark.parametrize(
    ("server", "package", "after"),
    [
        (netcdf, "h5netcdf", ""),
        (opendap, "pydap", ""),
        (griddap, "xpublish_erddap", ""),
        (griddap, "xpublish_erddap", ".html"),
    ],
)
def test_a_server_gives_the_part_in_the_box(asker, server, package, after):
    needs(package)
    ds = sea()
    if server is opendap:
        hours = np.arange(4) * 24.0, {"units": "hours since 2018-11-15", "axis": "T"}
        ds = ds.assign_coords(time=("time", *hours))
    with server(ds) as url:
        assert_same(asker(url + after, **PART))
    assert asker.state.fetched.files[0].stat().st_size < 4e5


@pytest.mark.parametrize(
    ("zarr_format", "encoding"),
    [
        (2, {"chunks": (1, 3, 2, 10, 10)}),
        (3, {"chunks": (1, 3, 2, 10, 10)}),
        (3, {"chunks": (1, 3, 1, 10, 10), "shards": (2, 3, 4, 30, 40)}),
    ],
)
def test_zarr_over_https_is_cut_to_box_depths_and_times(asker, zarr_format, encoding):
    own = dict.fromkeys(("uo", "vo"), encoding)
    files = Files(zarr_objects(sea(), zarr_format=zarr_format, encoding=own))
    # later versions than 3.1 join parts less than a megabyte apart, which is more than this store has
    apart = zarr.config.set({"array.sharding_coalesce_max_gap_bytes": 0})
    with serving(files), apart:
        assert_same(asker(files.url + "/", **PART))
    objects = [path for path in files.asked if re.search(r"[uv]o/.*\d", path)]
    # of 4 x 2 x 3 x 4 chunks of each: 3 times, a pair of levels or both, 2 x 3 in the box; none is received twice
    assert len(set(objects)) <= 2 * 3 * 2 * 2 * 3
    assert files.sent < 0.5 * sum(map(len, files.objects.values()))
    record = record_of(asker.state.fetched.files[0])
    assert record["address"].startswith("http://127.0.0.1")
    assert record["form"] == "Zarr"
    assert record["wanted"]["region"] == [153.0, -39.5, 154.5, -38.5]
    assert record["fetched"].endswith("Z")


def test_a_box_across_the_seam_of_a_global_grid(asker):
    ds = sea(times=1, shape=(20, 360), step=1.0).isel(time=0)
    ds = ds.assign_coords(lon=("lon", np.arange(-180.0, 180.0), ds.lon.attrs))
    with serving(Files(zarr_objects(ds, zarr_format=2))) as files:
        found = asker(files.url, region="178,-39,-177,-35")
    np.testing.assert_array_equal(found.lon, [178.0, 179.0, -180.0, -179.0, -178.0, -177.0])
    np.testing.assert_array_equal(found.uo, ds.uo.isel(lat=slice(1, 6)).sel(lon=found.lon))


def test_copernicus_marine_is_asked_through_its_own_client(asker, monkeypatch):
    asked = []

    def open_dataset(dataset_id, **_):
        asked.append(dataset_id)
        if dataset_id != "cmems_mod_glo_phy":
            raise ValueError("DatasetNotFound: see https://user:secret@host/x")
        return sea()

    monkeypatch.setitem(sys.modules, "copernicusmarine", SimpleNamespace(open_dataset=open_dataset))
    assert_same(asker("cmems:cmems_mod_glo_phy", logs=SPAN, levels=(5.0, 60.0)))
    assert set(asked) == {"cmems_mod_glo_phy"}
    with pytest.raises(Exception, match="client answers: DatasetNotFound") as raised:
        asker("cmems:other")
    assert "secret" not in str(raised.value)


def test_without_the_extras_the_command_that_adds_them_is_named(asker, monkeypatch):
    monkeypatch.setitem(sys.modules, "copernicusmarine", None)
    assert "pip install 'replay-kit[cmems]'" in refused(asker, "cmems:any")
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    assert "pip install 'replay-kit[remote]'" in refused(asker, "https://example.org/e.zarr")


def test_a_second_run_asks_only_whether_the_data_changed_and_offline_nothing(asker):
    with serving(Files(zarr_objects(sea(), zarr_format=2))) as files:
        first = asker(files.url, logs=SPAN)
        (name,), before = asker.state.fetched.files, files.sent
        asker(files.url, logs=SPAN)
        assert not asker.state.fetched.asked
        assert files.sent - before < 10_000
        count = len(files.asked)
        again = asker(files.url, logs=SPAN, offline=True)
        xr.testing.assert_identical(first, again)
        # what was fetched for more does for less
        assert asker(files.url, logs=SPAN, offline=True, region="153.5,-39.2,154,-39").equals(first)
        assert (asker.state.fetched.files, len(files.asked)) == ((name,), count)
        # a damaged copy is fetched anew, as is what changed
        name.write_bytes(b"x")
        for factor in (1.0, 1.5):
            files.objects = zarr_objects(factor * sea(), zarr_format=2)
            changed = asker(files.url, logs=SPAN)
            assert asker.state.fetched.asked
            np.testing.assert_allclose(changed.uo, factor * first.uo, rtol=1e-6)
    with pytest.raises(Exception, match="no earlier download covers the request"):
        asker("http://127.0.0.1:9/other", offline=True)
