"""The forecast referee in a replay, a counterfactual, and that verify makes both again."""

import json
from pathlib import Path

import pytest

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.forecast import read_truth
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import Following, ReplayJob
from replay_kit.workflows.replay.scoring import check_against
from replay_kit.workflows.verify import verify
from tests import synthetic
from tests.command import invoke


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A glider's log of the ocean of one ensemble, and an ensemble of another ocean."""
    folder = tmp_path_factory.mktemp("referee")
    synthetic.write_ocean(folder, 12)
    (folder / "other").mkdir()
    synthetic.write_ocean(folder / "other", 6)
    (folder / "other" / "ensemble.nc").rename(folder / "fewer.nc")
    make_twin(
        read_truth(str(folder / "truth.nc"), ForecastConfig()),
        Twin("glider", 24, 0.05, 1),
        folder / "glider.mcap",
    )
    return folder


def run(folder: Path, arguments: str) -> int:
    return invoke(f"replay {folder}/glider.mcap {arguments}").exit_code


@pytest.mark.full
def test_the_referee_compares_what_each_forecast_made_of_the_same_dives(folder):
    out, table = folder / "out.mcap", folder / "out.json"
    given, against = f"--ensemble {folder}/ensemble.nc --without dives:1", folder / "fewer.nc"
    assert run(folder, f"{given} --against {against} -o {out} --json {table}") == 0
    answer = json.loads(table.read_text())
    (against,) = answer["comparison"]["against"]
    assert (answer["comparison"]["ensemble"], against["ensemble"]) == ("ensemble.nc", "fewer.nc")
    total = answer["evidence"]["log_evidence"]
    assert against["gain"] == pytest.approx(total - against["other_log_evidence"], rel=1e-9)
    dives = [each["dive"] for each in answer["evidence"]["by_dive"]]
    assert 1 not in dives
    assert all(
        "dives:1" in reason
        for row in answer["messages"]
        for reason in row["reasons"]
        if "left out" in reason
    )
    alone = folder / "alone.json"
    assert run(folder, f"{given} -o {folder}/alone.mcap --json {alone}") == 0
    assert json.loads(alone.read_text())["evidence"] == answer["evidence"]
    assert verify(out, [folder], planner_of).same


def test_a_rule_that_leaves_nothing_out_has_no_result(folder):
    out = folder / "none.mcap"
    assert run(folder, f"--ensemble {folder}/fewer.nc --without dives:400 -o {out}") == 3
    assert not out.exists()


def test_forecasts_that_cannot_be_compared_are_refused_at_once(folder):
    job = ReplayJob((folder / "glider.mcap",), folder / "ensemble.nc")

    def against(*others, **changed):
        return ReplayJob(job.logs, job.ensemble, against=others, **changed)

    with pytest.raises(ConfigError, match="another ensemble each time"):
        check_against(against(folder / "ensemble.nc"))
    with pytest.raises(ConfigError, match="finished log"):
        check_against(against(folder / "fewer.nc", following=Following(folder)))
    with pytest.raises(ForecastError, match="file not found; check --against"):
        check_against(against(folder / "missing.nc"))
