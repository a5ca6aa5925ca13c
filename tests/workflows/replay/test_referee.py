"""The forecast referee in a replay, a counterfactual, and that verify makes both again."""

import json

import pytest

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.verify import verify
from tests import synthetic
from tests.command import succeed
from tests.workflows.replay.interrupted import QUICK, job_in


@pytest.fixture(scope="module")
def compared(ocean, tmp_path_factory):
    """A folder with a result that another forecast was compared for, and the answer."""
    folder = tmp_path_factory.mktemp("referee")
    synthetic.write_ocean(folder, 6)
    fewer = (folder / "ensemble.nc").rename(folder / "fewer.nc")
    return folder, answer(ocean, folder / "out", f"--against {fewer}")


def answer(ocean, out, more):
    files = f"{ocean}/glider.mcap --ensemble {ocean}/ensemble.nc --without dives:1"
    succeed(f"replay {files} {more} -o {out}.mcap --json {out}.json")
    return json.loads(out.with_suffix(".json").read_text())


def test_the_referee_compares_what_each_forecast_made_of_the_same_dives(compared):
    found = compared[1]
    (against,) = found["comparison"]["against"]
    assert (found["comparison"]["ensemble"], against["ensemble"]) == ("ensemble.nc", "fewer.nc")
    total = found["evidence"]["log_evidence"]
    assert against["gain"] == pytest.approx(total - against["other_log_evidence"], rel=1e-9)
    assert 1 not in [each["dive"] for each in found["evidence"]["by_dive"]]
    reasons = [reason["reason"] for row in found["messages"] for reason in row["reasons"]]
    assert any("dives:1" in reason for reason in reasons), found["messages"]


@pytest.mark.full
def test_a_comparison_changes_no_evidence_and_is_made_again(ocean, compared, tmp_path):
    folder, found = compared
    assert answer(ocean, tmp_path / "alone", "")["evidence"] == found["evidence"]
    assert verify(folder / "out.mcap", [ocean, folder], planner_of).same


def test_a_rule_that_leaves_nothing_out_has_no_result(ocean, tmp_path):
    config = RunConfig(estimator=QUICK, measurements={"without": ("dives:400",)})
    with pytest.raises(MeasurementError, match="dives:400"):
        replay(job_in(ocean, tmp_path / "none.mcap"), config)
    assert not list(tmp_path.iterdir())
