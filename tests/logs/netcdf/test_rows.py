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
    track = made.samples(600.0)
    n = track["time"].size
    levels = np.array([10.0, 20.0, 30.0])
    east, north = made.current(levels, 0)
    cells = {
        name: made.packed(np.tile(values[:, None], (1, n)), 1e-4)
        for name, values in (("ve", east), ("vn", north))
    }
    path = made.write(
        tmp_path / "lab.nc",
        made.over("obs", {"when": "time", "x": "longitude", "y": "latitude"}, track)
        | made.over("bin", {"bins": levels})
        | made.over(("bin", "obs"), cells),
    )
    said = read(path)
    assert said.report.notes[0] == (
        "of no known glider dialect: each row over when is a message on netcdf/when, with x, y, ve, vn, and at each row bins"
    )
    assert len(said.messages) == n == 10
    entry = {
        "topic": "netcdf/when",
        "kind": "profile",
        "reference": "earth",
        "frame": "enu",
        "east": "ve",
        "north": "vn",
        "depths": "bins",
    }
    config = MeasurementConfig.model_validate(
        {"map": [entry | {"longitude": "x", "latitude": "y"}]}
    )
    profiles = [
        event for event in observations(said.messages, config) if isinstance(event, Observation)
    ]
    assert len(profiles) == 10
    fourth = profiles[3]
    np.testing.assert_allclose(fourth.velocity, np.column_stack([east, north]), atol=5.1e-5)
    np.testing.assert_allclose(fourth.depth, levels)
    place = track["longitude"][3], track["latitude"][3]
    assert (fourth.longitude, fourth.latitude) == place
    unknown = config.model_copy(
        update={"map": (config.map[0].model_copy(update={"reference": "unknown"}),)}
    )
    assert not [
        event for event in observations(said.messages, unknown) if isinstance(event, Observation)
    ]


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        # as a SeaExplorer's, and as totals of HF radars
        (b"timestamp,lon,lat,depth,u,v,error", {"time": "timestamp"}),
        (b"time,lon,lat,v_err,u,v,u_err", {"depth": 9.0, "error": "u_err"}),
    ],
)
def test_a_table_is_one_of_pings_whatever_its_columns_are_called(tmp_path, names, columns):
    table, named = tmp_path / "a.csv", tmp_path / "b.csv"
    table.write_bytes(PINGS)
    named.write_bytes(names + PINGS[PINGS.index(b"\n") :])
    said = read(named, LogConfig(columns=columns))
    assert (said.report.format, said.messages) == ("table", read(table).messages)


def test_commas_in_numbers_of_a_table_are_points(tmp_path):
    table, european = tmp_path / "a.csv", tmp_path / "b.csv"
    table.write_bytes(PINGS)
    european.write_bytes(PINGS.replace(b",", b";").replace(b".", b","))
    assert read(european).messages == read(table).messages


def test_values_of_a_table_have_a_depth_each_and_an_error(tmp_path):
    """A mooring, at a place of two dimensions."""
    path, speed = tmp_path / "a.nc", (("time", "cell", "y", "x"), np.full((2, 3, 1, 1), 0.1))
    held = {"u": speed, "v": speed, "longitude": 152.0, "latitude": -40.0}
    mooring = xr.Dataset(held, {"time": np.array(["2020", "2021"], "M8[ns]")})
    stated = LogConfig(columns={"error": 0.05})
    mooring.assign(depth=("cell", [8.0, 12.0, 16.0])).to_netcdf(path)
    assert len(read(path, stated).messages) == 2
    mooring.assign(depth=("time", [40.0, 41.0])).to_netcdf(path)
    with pytest.raises(LogError, match="u varies along cell, depth does not"):
        read(path, stated)
    upwards = mooring.assign(
        depth=("time", [40.0, 41.0]), Height_above_sensor=("cell", [8.0, 16.0, 24.0])
    )
    upwards.to_netcdf(path)
    assert [one.payload["cell_distances"] for one in read(path, stated).messages] == [
        [16.0, 24.0, 32.0],
        [17.0, 25.0, 33.0],
    ]
    mooring.assign(depth=("time", [40.0, 41.0])).to_netcdf(path)
    said = read(path)
    assert "--columns error=0.05" in said.report.notes[0]
    assert said.messages[0].payload["latitude"] == -40.0


@pytest.mark.parametrize("flag", ["u_qc", "u_quality_control", "quality"])
def test_bins_of_a_table_that_are_flagged_bad_are_not_used(tmp_path, flag):
    held = {name: ("time", [0.1, 0.2, 0.3]) for name in ("u", "v", "error")}
    held |= {"longitude": 152.0, "latitude": -40.0, "depth": 9.0}
    table = xr.Dataset(held, {"time": np.array(["2020", "2021", "2022"], "M8[ns]")})
    meanings = {"flag_values": [1, 3, 4], "flag_meanings": "good suspect bad"}
    table[flag] = "time", np.array([1, 4, 3], "i1"), meanings
    table["u"].attrs["ancillary_variables"] = flag
    table.to_netcdf(tmp_path / "a.nc")
    said = read(tmp_path / "a.nc")
    assert [one.payload["velocity"][0][0] for one in said.messages] == [0.1, None, None]
    assert "1 x 3 (suspect), not used" in " ".join(said.report.notes)
    table.drop_vars("error").to_netcdf(tmp_path / "rows.nc")
    rows = read(tmp_path / "rows.nc").messages
    assert [one.payload["u"] for one in rows] == [0.1, None, None]


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_a_large_forecast_is_no_log_by_its_header(tmp_path, engine):
    path = tmp_path / "forecast.nc"
    field = np.zeros((4, 10, 300, 400), "f4")
    dims = ("time", "depth", "y", "x")
    xr.Dataset({"uo": (dims, field), "vo": (dims, field)}).to_netcdf(path, engine=engine)
    tracemalloc.start()
    for given in ([path], [path, path]):
        with pytest.raises(LogError, match=r"currents on a grid: .*given with --ensemble, not as"):
            open_logs(given)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < path.stat().st_size / 4
