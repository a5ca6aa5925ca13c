"""A plan that must not be flown is the first alarm of every answer to a person."""

import io
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.errors import Finding, finding_json
from replay_kit.core.plan import Odds
from replay_kit.results import ResultWriter
from replay_kit.results.outcome.outcome import made
from replay_kit.results.outcome.parts import plan_part
from replay_kit.results.reader import ResultReader
from replay_kit.results.views.contents import Contents
from replay_kit.show.notebook import read_result
from replay_kit.show.report.sections.answer import found_warnings
from replay_kit.show.status.held import read_held
from replay_kit.show.status.lines import detail_lines, lines
from replay_kit.show.status.page import status_page
from replay_kit.show.status.status import status_of
from replay_kit.show.summary import print_summary
from replay_kit.show.text import SafeConsole
from tests.results.result_samples import CONFIG, METADATA
from tests.show.status.held_samples import held
from tests.synthetic_flow import synthetic_flow

NONE_ARRIVES = Odds(40, 0.0, 1.0, 250.0, 9e4, 7e4, 8e4)
BAD = {
    "unreachable": {
        "status": "unreachable",
        "message": "misses the goal by 3200.0 m",
        "closest_approach": 3200.0,
        "duration": 38_520.0,
    },
    "unsafe": {"status": "unsafe", "message": "crosses the lane"},
    "uncertain": {
        "status": "uncertain",
        "message": "0 % of 40 samples of the estimate arrive",
        "odds": NONE_ARRIVES,
    },
    "no sample arrives": {"message": "ends at the goal", "odds": NONE_ARRIVES},
    "failed": {
        "status": "failed",
        "message": "no path",
        "duration": np.nan,
        "closest_approach": np.inf,
    },
}
FINDING = Finding("headings", 0, "off by 90", "the mounting", "check the mounting")
RMS = dict.fromkeys(("before", "after", "prior"), 0.1)
COUNTS = {"used": 4, "rejected": 0, "bins_used": 4, "bins_rejected": {}}


def outcome_of(plan=None, findings=(FINDING,), note=""):
    found = [finding_json(one) for one in findings]
    values = {"observations": COUNTS, "rms_innovation": RMS, "nis_per_dof": 1.0}
    return made(values | {"plan": plan_part(plan, note), "consistency": found})


def written(path, plan, findings=(FINDING,)):
    flow = synthetic_flow()
    with ResultWriter(path) as writer:
        writer.start(flow.grid.projection, plan.start_time_ns, METADATA, CONFIG)
        writer.plan(plan, flow.grid.projection)
        writer.summary(plan.start_time_ns, outcome_of(plan, findings))
    return path


@pytest.mark.parametrize("name", BAD)
def test_a_plan_that_must_not_be_flown_is_the_first_alarm_wherever_it_is_shown(
    name, plan, tmp_path
):
    plan = replace(plan, **BAD[name])
    path = written(tmp_path / "r.mcap", plan)
    status = status_of(read_held(ResultReader(path)))
    assert [alarm.kind for alarm in status.alarms] == ["plan", "consistency"]
    said = status.alarms[0].text
    arrive = "0 of 40 simulated flights arrive"
    assert (arrive if plan.odds and name != "unsafe" else plan.message) in said
    assert len(said) < 160
    page = status_page(status)
    assert page.index(f"<b>plan</b> {said}") < page.index("<b>consistency</b>")
    assert not any(line.label == "Arrive" for line in lines(status)) or status.figures["odds"][
        "status"
    ] in ("reached", "uncertain")
    outcome = outcome_of(plan)
    assert read_result(path).outcome == outcome
    shown = found_warnings(Contents(read_result(path)))
    assert shown[0][1] == said[:1].upper() + said[1:] + "."
    assert shown[0][0] == ("stop" if plan.status in ("unsafe", "failed") else "care")
    alarms = outcome.to_json()["alarms"]
    assert [one["kind"] for one in alarms] == ["plan", "consistency"]
    assert alarms[0]["text"] == status.figures["alarms"][0]["text"] == said
    printed = io.StringIO()
    print_summary({"": status}, outcome, SafeConsole(file=printed, width=400))
    assert printed.getvalue().splitlines()[0].startswith("DO NOT USE headings: off by 90")


def test_a_plan_that_arrives_is_no_alarm(plan, tmp_path):
    path = written(
        tmp_path / "r.mcap",
        replace(plan, odds=Odds(40, 0.95, 1.0, 250.0, 9e4, 7e4, 8e4)),
        findings=(),
    )
    status = status_of(read_held(ResultReader(path)))
    assert status.alarms == ()
    assert "Arrive" in [line.label for line in lines(status)]
    assert outcome_of(plan, ()).alarms == ()
    assert not any("plan" in text for _, text in found_warnings(Contents(read_result(path))))


def test_a_replay_that_could_make_no_plan_in_the_end_says_so_first():
    """An earlier plan of it may have arrived."""
    outcome = outcome_of(note="the goal is on land")
    assert outcome.to_json()["alarms"][0] == {
        "kind": "plan",
        "text": "the plan failed: the goal is on land: keep the last command and mend what failed",
    }
    for plans in (held().plans, []):
        status = status_of(held(outcome=outcome, plans=plans))
        assert (
            status.alarms[0].text
            == "the plan failed: the goal is on land: keep the last command and mend what failed"
        )
        assert "failed: the goal is on land" in " ".join(detail_lines(status))
        assert not any(line.label == "Arrive" for line in lines(status))
