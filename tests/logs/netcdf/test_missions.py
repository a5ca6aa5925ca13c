"""Which mission a glider's file is of, by the variables and attributes of each dialect."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from replay_kit.logs import open_log
from replay_kit.logs.netcdf.glider import missions_of
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored
from replay_kit.logs.opening import pattern
from tests.logs.netcdf import glider_samples as made


@pytest.mark.parametrize(
    ("dialect", "attributes", "texts", "expected"),
    [
        ("og1", {"id": "sg033_2010"}, [], ("sg033_2010",)),
        ("og1", {"id": "sg033_2010"}, [b"sg033_a"], ("sg033_a",)),
        # of a profile, not of the mission
        ("gliderdac", {"id": "ru29-20140101T0942"}, [], ()),
        (
            "pyglider",
            {"deployment_name": "dfo-eva035-2019", "glider_name": "eva"},
            [],
            ("dfo-eva035-2019",),
        ),
        ("pyglider", {"glider_name": "eva"}, [], ("eva",)),
        (
            "seaglider",
            {"platform_id": "SG171", "mission": 37, "id": "p1710100"},
            [],
            ("SG171 mission 37",),
        ),
        ("seaglider", {"glider": 171, "mission": 37}, [], ("171 mission 37",)),
        ("spray", {}, [b"22C", b"22C", b"23A"], ("22C", "23A")),
        ("midas", {}, [], ()),
    ],
)
def test_missions(dialect, attributes, texts, expected):
    variables = {"TRAJECTORY": Stored(np.array(texts, "S10"), {})} if texts else {}
    assert missions_of(NetcdfFile(Path("a.nc"), attributes, variables, ()), dialect) == expected


def test_a_mission_in_characters_or_in_a_text_of_variable_length(tmp_path):
    path = made.bodc(tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        file["TRAJECTORY"] = "sg033_2010"
    assert open_log(path).mission == "sg033_2010"
    with h5py.File(path, "r+") as file:
        del file["TRAJECTORY"]
        file["TRAJECTORY"] = np.array([list("sg034  ")], "S1")
    assert open_log(path).report().mission == "sg034"


def test_several_missions_in_one_file_are_noted(tmp_path):
    path = made.spray(tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        file["mission_name"] = np.array([b"22C", b"23A", b"23B", b"24A"])
    log = open_log(path)
    assert log.mission == ""
    note = "4 missions in one log (22C, 23A, 23B, ...): their dives are merged as if one glider had made them"
    assert note in log.report().notes


def test_pattern():
    assert pattern([Path("/x/p1710100.nc")]) == "p1710100.nc"
    assert pattern([Path("/x/p1710100.nc"), Path("/y/p1710134.nc")]) == "p17101*"
