"""A study that is ended leaves on the disk what is done."""

import json

import pytest

from replay_kit.core.errors import ConfigError
from replay_kit.studies.bench import plans as of_plans
from replay_kit.studies.bench.plans import JudgedMission
from tests.studies.results import bench
from tests.workflows.replay.interrupted import Killed


def plans(ensemble, out, words):
    return bench(f"--task plans --ensemble {ensemble} -o {out} --modes 6 {words}")


def test_a_run_that_is_killed_leaves_the_missions_that_were_done(monkeypatch, ensemble, tmp_path):
    def made_up(case, *_):
        if case.member == 2:
            raise Killed
        return [JudgedMission(True, 0.9, 100.0)]

    monkeypatch.setattr(of_plans, "_of_truth", made_up)
    with pytest.raises(Killed):
        plans(ensemble, tmp_path / "out", "--leave-out 1,2 --plans 2")
    said = json.loads((tmp_path / "out" / "bench.json").read_text())
    assert (said["unfinished"], said["rows"][0]["cases"]) == (True, [f"{ensemble}#1"])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["bench.csv", "bench.json"]


def test_a_member_that_is_not_there_makes_no_folder(ensemble, tmp_path):
    done = plans(ensemble, tmp_path / "out", "--leave-out 77")
    assert isinstance(done.exception, ConfigError)
    assert "--leave-out: expected 0 to 4, got 77" in str(done.exception)
    assert not (tmp_path / "out").exists()
