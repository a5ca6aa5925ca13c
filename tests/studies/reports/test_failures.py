"""A study that is ended leaves on the disk what is done."""

import json

import pytest

from replay_kit.core.errors import ConfigError
from replay_kit.studies.planning import odds
from replay_kit.studies.planning.odds import JudgedMission
from tests import synthetic
from tests.studies.results import experiment


class Killed(BaseException):
    """What stops a run in these tests and no code of the project knows."""


@pytest.fixture(scope="module")
def ensemble(tmp_path_factory):
    path = tmp_path_factory.mktemp("ocean") / "ensemble.nc"
    synthetic.dataset(n_members=5, shape=(5, 6)).to_netcdf(path, engine="h5netcdf")
    return path


def planning(ensemble, out, words):
    return experiment(f"planning --ensemble {ensemble} -o {out} --modes 6 {words}")


def test_a_planning_run_that_is_killed_leaves_the_missions_that_were_done(
    monkeypatch, ensemble, tmp_path
):
    def made_up(case, *_):
        if case.member == 2:
            raise Killed
        return [JudgedMission(case.member, "reached", 0.95, 0.9, 100.0, 250.0)]

    monkeypatch.setattr(odds, "_of_truth", made_up)
    with pytest.raises(Killed):
        planning(ensemble, tmp_path / "out", "--leave-out 1,2 --pairs 2")
    said = json.loads((tmp_path / "out" / "planning.json").read_text())
    assert (said["unfinished"], [one["truth"] for one in said["missions"]]) == (True, [1])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "odds.csv",
        "planning.json",
    ]


def test_a_member_that_is_not_there_makes_no_folder(ensemble, tmp_path):
    done = planning(ensemble, tmp_path / "out", "--leave-out 77")
    assert isinstance(done.exception, ConfigError)
    assert "--leave-out: expected 0 to 4, got 77" in str(done.exception)
    assert not (tmp_path / "out").exists()
