"""The forecast referee in a replay, a counterfactual, and that verify makes both again."""

import json

import pytest

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError, ForecastError, MeasurementError
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import Following
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.replay.scoring import check_against
from replay_kit.workflows.verify import verify
from tests import synthetic
from tests.command import succeed
from tests.workflows.replay.interrupted import QUICK, job_in


@pytest.mark.full
def test_the_referee_compares_what_each_forecast_made_of_the_same_dives(ocean, tmp_path):
    synthetic.write_ocean(tmp_path, 6)
    fewer = (tmp_path / "ensemble.nc").rename(tmp_path / "fewer.nc")

    def answer(more):
        files = f"{ocean}/glider.mcap --ensemble {ocean}/ensemble.nc --without dives:1"
        out = f"-o {tmp_path}/out.mcap --json {tmp_path}/out.json --overwrite"
        succeed(f"replay {files} {more} {out}")
        return json.loads((tmp_path / "out.json").read_text())

    alone, found = answer(""), answer(f"--against {fewer}")
    (against,) = found["comparison"]["against"]
    assert (found["comparison"]["ensemble"], against["ensemble"]) == ("ensemble.nc", "fewer.nc")
    total = found["evidence"]["log_evidence"]
    assert against["gain"] == pytest.approx(total - against["other_log_evidence"], rel=1e-9)
    assert 1 not in [each["dive"] for each in found["evidence"]["by_dive"]]
    reasons = [reason["reason"] for row in found["messages"] for reason in row["reasons"]]
    assert any("dives:1" in reason for reason in reasons), found["messages"]
    assert alone["evidence"] == found["evidence"]
    assert verify(tmp_path / "out.mcap", [ocean, tmp_path], planner_of).same


def test_a_rule_that_leaves_nothing_out_has_no_result(ocean, tmp_path):
    config = RunConfig(estimator=QUICK, measurements={"without": ("dives:400",)})
    with pytest.raises(MeasurementError, match="dives:400"):
        replay(job_in(ocean, tmp_path / "none.mcap"), config)
    assert not list(tmp_path.iterdir())


def test_forecasts_that_cannot_be_compared_are_refused_at_once(ocean, tmp_path):
    truth = ocean / "truth.nc"
    for more, error, words in (
        ({"against": (ocean / "ensemble.nc",)}, ConfigError, "another ensemble each time"),
        ({"against": (truth,), "following": Following(tmp_path)}, ConfigError, "finished log"),
        ({"against": (ocean / "missing.nc",)}, ForecastError, "file not found; check --against"),
    ):
        with pytest.raises(error, match=words):
            check_against(job_in(ocean, **more))
