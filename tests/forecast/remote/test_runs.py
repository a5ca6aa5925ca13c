"""A store of several runs: their leads valid at one time are members, in a file and on a server alike."""

import numpy as np
import pytest
import xarray as xr

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.forecast import read_ensemble
from tests.forecast.forms import in_turn
from tests.forecast.remote.conftest import sea
from tests.forecast.remote.servers import Files, serving, zarr_objects

pytestmark = pytest.mark.filterwarnings("ignore:Consolidated metadata is currently not part")


def runs(start: str) -> xr.Dataset:
    """Five runs a day apart, each of six leads a day apart; the current grows with the start and falls with the lead."""
    one = sea(times=1).isel(time=0, member=0, drop=True)
    days = np.datetime64("2018-11-10T00", "ns") + np.arange(5) * np.timedelta64(1, "D")
    about = {"units": "days", "standard_name": "forecast_period"}
    leads = [[one * (1 + 0.1 * k - 0.01 * lead) for lead in range(6)] for k in range(5)]
    return in_turn([in_turn(each, np.arange(6), "lead", **about) for each in leads], days, start)


@pytest.mark.parametrize(
    "start", [pytest.param("time", marks=pytest.mark.full), "forecast_reference_time"]
)
def test_lags_of_a_store_of_runs(tmp_path, asker, start):
    ds, runs_file = runs(start), tmp_path / "runs.nc"
    ds.to_netcdf(runs_file, engine="h5netcdf")

    def read(path, **changes):
        settings = {"members": "lags", "time": "2018-11-14T00:00Z", "levels": (5.0,)} | changes
        return read_ensemble(path, ForecastConfig(**settings))

    found = read(runs_file)
    assert found.members[0].endswith("started 2018-11-10T00:00")
    factors = [(1 + 0.1 * k - 0.01 * (4 - k)) / 0.96 for k in range(5)]
    for velocity, factor in zip(found.velocity, factors, strict=True):
        np.testing.assert_allclose(velocity, factor * found.velocity[0], rtol=1e-6)
    with serving(Files(zarr_objects(ds, zarr_format=2))) as files:
        span = {"start": "2018-11-14T00:00Z", "end": "2018-11-14T06:00Z"}
        part = asker(files.url, members="lags", logs=span)
        (file,) = asker.state.fetched.files
        # of the newest start, although the log is of another time
        asker(files.url, members="lags", lead=1.0, logs=span)
    # the last start's first leads, the first start's last ones
    assert dict(part.sizes)[start] == 5
    box = {"region": (153.0, -39.5, 154.5, -38.5)}
    again = read(file, **box)
    assert (again.n_members, again.time_ns) == (5, found.time_ns)
    ahead = box | {"time": None, "lead": 1.0}
    ours, theirs = (read(path, **ahead) for path in (asker.state.fetched.files[0], runs_file))
    assert ours.time_ns == theirs.time_ns == found.time_ns + 86_400 * 10**9
    np.testing.assert_array_equal(ours.velocity, theirs.velocity)
    with pytest.raises(ForecastError, match="lead 4 of the newest run is valid 2018-11-18"):
        read(runs_file, **ahead | {"lead": 4.0})
