"""Files of no known dialect: rows that a mapping reads, tables of pings, or why a file is no log."""

import tracemalloc

import numpy as np
import pytest
import xarray as xr

from replay_kit.config.run import LogConfig, MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.core.observation import Observation
from replay_kit.logs import open_logs
from replay_kit.measurements import observations
from tests.logs.netcdf import glider_samples as made
from tests.logs.said import read
from tests.logs.sound import PINGS


def test_rows_of_an_unknown_file_are_read_by_a_mapping(tmp_path):
    """Three cells along a second dimension, time last: each row over the time is a message."""
    track, levels = made.samples(600.0), np.array([10.0, 20.0, 30.0])
    currents = zip(("ve", "vn"), made.current(levels, 0), strict=True)
    cells = {name: made.packed(np.tile(of[:, None], (1, 10)), 1e-4) for name, of in currents}
    path = made.write(
        tmp_path / "lab.nc",
        made.over("obs", {"when": "time", "x": "longitude", "y": "latitude"}, track)
        | made.over("bin", {"bins": levels})
        | made.over(("bin", "obs"), cells),
    )
    said = read(path)
    assert said.noted("a message on netcdf/when, with x, y, ve, vn, and at each row bins")
    entry = {"east": "ve", "north": "vn", "depths": "bins", "longitude": "x", "latitude": "y"}
    entry |= {"topic": "netcdf/when", "kind": "profile", "frame": "enu"}

    def profiles(reference):
        mapped = {"map": [{**entry, "reference": reference}]}
        found = observations(said.messages, MeasurementConfig.model_validate(mapped))
        return [event for event in found if isinstance(event, Observation)]

    assert len(said.messages) == len(profiles("earth")) == 10
    fourth, field = profiles("earth")[3], np.column_stack(made.current(levels, 0))
    np.testing.assert_allclose(fourth.velocity, field, atol=5.1e-5)
    np.testing.assert_allclose(fourth.depth, levels)
    assert fourth.longitude == track["longitude"][3]
    assert fourth.latitude == track["latitude"][3]
    assert not profiles("unknown")


@pytest.mark.parametrize(
    ("changed", "columns"),
    [
        # as a SeaExplorer's, as totals of HF radars, and with commas in numbers
        (PINGS.replace(b"time,longitude,latitude", b"timestamp,lon,lat"), {"time": "timestamp"}),
        (
            PINGS.replace(PINGS[: PINGS.index(b"\n")], b"time,lon,lat,v_err,u,v,u_err"),
            {"depth": 9.0, "error": "u_err"},
        ),
        (PINGS.replace(b",", b";").replace(b".", b","), {}),
    ],
)
def test_a_table_is_one_of_pings_however_it_is_written(tmp_path, changed, columns):
    table, other = tmp_path / "a.csv", tmp_path / "b.csv"
    table.write_bytes(PINGS)
    other.write_bytes(changed)
    said = read(other, LogConfig(columns=columns))
    assert (said.report.format, said.messages) == ("table", read(table).messages)


def test_values_of_a_table_have_a_depth_each_and_an_error(tmp_path):
    """A mooring, at a place of two dimensions."""
    path, speed = tmp_path / "a.nc", (("time", "cell", "y", "x"), np.full((2, 3, 1, 1), 0.1))
    held = {"u": speed, "v": speed, "longitude": 152.0, "latitude": -40.0}
    mooring = xr.Dataset(held, {"time": np.array(["2020", "2021"], "M8[ns]")})
    in_time, stated = ("time", [40.0, 41.0]), LogConfig(columns={"error": 0.05})
    mooring.assign(depth=("cell", [8.0, 12.0, 16.0])).to_netcdf(path)
    assert len(read(path, stated).messages) == 2
    mooring.assign(depth=in_time).to_netcdf(path)
    with pytest.raises(LogError, match="u varies along cell, depth does not"):
        read(path, stated)
    said = read(path)
    assert said.noted("--columns error=0.05")
    assert said.messages[0].payload["latitude"] == -40.0
    above = {"Height_above_sensor": ("cell", [8.0, 16.0, 24.0])}
    mooring.assign(depth=in_time, **above).to_netcdf(path)
    found = [one.payload["cell_distances"] for one in read(path, stated).messages]
    assert found == [[16.0, 24.0, 32.0], [17.0, 25.0, 33.0]]


@pytest.mark.parametrize("flag", ["u_qc", "u_quality_control", "quality"])
def test_bins_of_a_table_that_are_flagged_bad_are_not_used(tmp_path, flag):
    held = dict.fromkeys(("u", "v", "error"), ("time", [0.1, 0.2, 0.3]))
    held |= {"longitude": 152.0, "latitude": -40.0, "depth": 9.0}
    table = xr.Dataset(held, {"time": np.array(["2020", "2021", "2022"], "M8[ns]")})
    meanings = {"flag_values": [1, 3, 4], "flag_meanings": "good suspect bad"}
    table[flag] = "time", np.array([1, 4, 3], "i1"), meanings
    table["u"].attrs["ancillary_variables"] = flag
    table.to_netcdf(path := tmp_path / "a.nc")
    said = read(path)
    assert [one.payload["velocity"][0][0] for one in said.messages] == [0.1, None, None]
    assert said.noted("1 x 3 (suspect), not used")
    # one current over all depths, as of dives: no error makes bins of it
    table.drop_vars("error").assign(depth=("level", [8.0, 9.0])).to_netcdf(path)
    said = read(path)
    assert not said.noted("--columns")
    assert [one.payload["u"] for one in said.messages] == [0.1, None, None]


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_a_large_forecast_is_no_log_by_its_header(tmp_path, engine):
    path = tmp_path / "forecast.nc"
    field = ("time", "depth", "y", "x"), np.zeros((4, 10, 300, 400), "f4")
    xr.Dataset({"uo": field, "vo": field}).to_netcdf(path, engine=engine)
    tracemalloc.start()
    for given in ([path], [path, path]):
        with pytest.raises(LogError, match=r"currents on a grid: .*given with --ensemble, not as"):
            open_logs(given)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < path.stat().st_size / 4
