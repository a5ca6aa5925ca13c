"""Which mission a glider's file is of, by the variables and attributes of each dialect; and a dialect that is added as the page says."""

import h5py
import numpy as np
import pytest

from replay_kit.logs import open_log
from tests.logs.netcdf import glider_samples as made


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
