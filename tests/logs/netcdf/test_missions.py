"""Which mission a glider's file is of, by the variables and attributes of each dialect; and a dialect that is added as the page says."""

import h5py
import numpy as np
import pytest

from replay_kit.logs import open_log
from replay_kit.logs.netcdf import reader
from replay_kit.logs.netcdf.dialects import Dialect
from tests.logs.netcdf import glider_samples as made
from tests.logs.said import read


def _pyglider(path):
    track = {"longitude": "longitude", "latitude": "latitude", "time": "time", "dive_num": "dive"}
    return made.write(path, made.over("time", track, made.samples()))


def _seaglider(path):
    names = {"log_gps_time": "time", "log_gps_lat": "latitude", "log_gps_lon": "longitude"}
    return made.write(path, made.over("gps", names, made.samples()))


_TEXT, _LETTERS = "sg033_a", np.array([list("sg034  ")], "S1")


@pytest.mark.parametrize(
    ("write", "attributes", "variables", "expected"),
    [
        (made.bodc, {"id": "sg033_2010"}, {}, "sg033_2010"),
        (made.bodc, {"id": "sg033_2010"}, {"TRAJECTORY": _TEXT}, "sg033_a"),
        (made.bodc, {}, {"TRAJECTORY": _LETTERS}, "sg034"),
        # of a profile, not of the mission
        (made.erddap, {"id": "ru29-20140101T0942"}, {}, ""),
        (_pyglider, {"deployment_name": "eva035-2019", "glider_name": "eva"}, {}, "eva035-2019"),
        (_pyglider, {"glider_name": "eva"}, {}, "eva"),
        (_seaglider, {"platform_id": "SG171", "mission": 37, "id": "p1"}, {}, "SG171 mission 37"),
        (_seaglider, {"glider": 171, "mission": 37}, {}, "171 mission 37"),
        (made.spray, {}, {"mission_name": np.array([b"22C", b"22C"])}, "22C"),
        (made.spray, {}, {"mission_name": np.array([b"22C", b"23A"])}, ""),
    ],
)
def test_missions(tmp_path, write, attributes, variables, expected):
    path = write(tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        file.attrs.update(attributes)
        for name, values in variables.items():
            file[name] = values
    log = open_log(path)
    assert (log.mission, log.report().mission) == (expected, expected)


MINE = Dialect(
    "mine",
    "A glider of mine",
    "when east north",
    {
        "time": "when",
        "longitude": "east",
        "latitude": "north",
        "depth": "below",
        "dac_east": "drift_east",
        "dac_north": "drift_north",
    },
    log_of="mission",
    pings=lambda file, notes: iter([(10**18, "/adcp", "Ping", {"rows": file.array("when").size})]),
)


def test_files_of_an_added_dialect_are_one_log_with_its_currents_and_pings(tmp_path, monkeypatch):
    names = {"when": "time", "east": "longitude", "north": "latitude", "below": "depth"}
    names |= {"drift_east": "u", "drift_north": "v"}
    for dive in (0, 1):
        track = {k: v[made.samples()["dive"] == dive] for k, v in made.samples().items()}
        variables = made.over("row", names, track)
        made.write(tmp_path / f"{dive}.nc", variables, {"deployment_name": "one"})
    assert "/dac" not in read(tmp_path / "0.nc").counts()
    monkeypatch.setattr(reader, "DIALECTS", (MINE, *reader.DIALECTS))
    said = read(tmp_path)
    assert said.report.format == "mine"
    means = [(mean["dac_eastward"], mean["dac_northward"]) for mean in said.of("/dac")]
    assert means == [pytest.approx(made.mean(dive)) for dive in (0, 1)]
    assert said.of("/adcp") == [{"rows": 59}, {"rows": 59}]
