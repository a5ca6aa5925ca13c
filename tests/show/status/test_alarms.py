"""A plan that must not be flown is the first alarm of every answer to a person."""

import io
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.errors import Finding, finding_json
from replay_kit.core.plan import Odds
from replay_kit.results import ResultWriter
from replay_kit.results.outcome.outcome import Outcome, checked_outcome
from replay_kit.results.outcome.parts import plan_part
from replay_kit.results.views.contents import Contents
from replay_kit.show.notebook import read_result
from replay_kit.show.report.answer import found_warnings, lights, next_steps
from replay_kit.show.status.held import read_held
from replay_kit.show.status.lines import lines
from replay_kit.show.status.status import status_of
from replay_kit.show.summary import print_summary
from replay_kit.show.text import SafeConsole
from tests.results.result_samples import CONFIG, METADATA
from tests.show.status.held_samples import held
from tests.synthetic_flow import synthetic_flow

NONE_ARRIVES = Odds(40, 0.0, 1.0, 250.0, 9e4, 7e4, 8e4)
#: Values of plans, with the kind of warning that the page gives, if any.
PLANS = {
    "unreachable": ({"message": "misses by 3200.0 m", "closest_approach": 3200.0}, "care"),
    "unsafe": ({"message": "crosses the lane", "odds": NONE_ARRIVES}, "stop"),
    "uncertain": ({"message": "0 % of 40 samples arrive", "odds": NONE_ARRIVES}, "care"),
    "none arrives": ({"status": "reached", "odds": NONE_ARRIVES}, "care"),
    "failed": ({"message": "no path", "duration": np.nan, "closest_approach": np.inf}, "stop"),
    "reached": ({"odds": replace(NONE_ARRIVES, reached=0.95)}, ""),
}
FINDING = Finding("headings", 0, "off by 90", "the mounting", "check the mounting")
RUN = {
    "observations": {"used": 4, "rejected": 0, "bins_used": 4, "bins_rejected": {}},
    "rms_innovation": dict.fromkeys(("before", "after", "prior"), 0.1),
    "nis_per_dof": 1.0,
}


def outcome_of(plan=None, note="", **more):
    return checked_outcome(RUN | {"plan": plan_part(plan, note), **more})


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_that_must_not_be_flown_is_the_first_alarm_wherever_it_is_shown(
    name, plan, tmp_path
):
    values, kind = PLANS[name]
    plan, flow = replace(plan, **{"status": name, **values}), synthetic_flow()
    outcome = outcome_of(plan, consistency=[finding_json(FINDING)] if kind else [])
    with ResultWriter(tmp_path / "r.mcap") as writer:
        writer.start(flow.grid.projection, plan.start_time_ns, METADATA, CONFIG)
        writer.plan(plan, flow.grid.projection)
        writer.summary(plan.start_time_ns, outcome)
    result = read_result(tmp_path / "r.mcap")
    status = status_of(read_held(result.reader))
    shown, labels = found_warnings(Contents(result)), [line.label for line in lines(status)]
    assert ("Arrive" in labels) == (name not in ("unreachable", "failed"))
    alarms = outcome.to_json()["alarms"]
    assert [one["text"] for one in alarms] == [one.text for one in status.alarms]
    assert [one["kind"] for one in alarms] == (["plan", "consistency"] if kind else [])
    if not kind:
        assert not any("plan" in text for _, text in shown)
        return
    said = alarms[0]["text"]
    arrive = "0 of 40 simulated flights arrive"
    assert (arrive if plan.odds and name != "unsafe" else plan.message) in said
    assert shown[0] == (kind, said[:1].upper() + said[1:] + ".")
    printed = io.StringIO()
    print_summary({"": status}, outcome, SafeConsole(file=printed, width=400))
    assert printed.getvalue().startswith("DO NOT USE headings: off by 90")


def test_a_replay_that_could_make_no_plan_in_the_end_says_so_first():
    """An earlier plan of it may have arrived."""
    outcome = outcome_of(note="the goal is on land")
    said = "the plan failed: the goal is on land: keep the last command and mend what failed"
    assert outcome.to_json()["alarms"][0] == {"kind": "plan", "text": said}
    for plans in (held().plans, []):
        status = status_of(held(outcome=outcome, plans=plans))
        assert status.alarms[0].text == said
        assert not any(line.label == "Arrive" for line in lines(status))


def result_of(path, outcome, innovations=()):
    with ResultWriter(path) as writer:
        writer.start(synthetic_flow().grid.projection, 10**18, METADATA, CONFIG)
        for one in innovations:
            writer.innovations([one])
        writer.summary(10**18, outcome)
    return Contents(read_result(path))


def test_notes_on_how_the_log_was_read_are_notes(tmp_path):
    names = "glider_1.nc: 5 variables were read by their names"
    outcome = Outcome(notes=(names, "a fix <b> jumps"))
    # the name of a file stays as it is
    notes = [("note", f"{names}."), ("note", "A fix &lt;b&gt; jumps.")]
    assert found_warnings(result_of(tmp_path / "r.mcap", outcome)) == notes


@pytest.mark.parametrize(
    ("nis", "profiles", "first"),
    [(1.3, 1, "Give a goal"), (2.07, 1, "Run <code>replay-kit qc"), (2.07, 0, "Compare")],
)
def test_steps_follow_the_verdict_and_can_be_run(innovation, nis, profiles, first, tmp_path):
    """Quality control refuses logs of mean currents alone."""
    counts = {**RUN["observations"], "used": 400}
    outcome = outcome_of(observations=counts, nis_per_dof=nis)
    contents = result_of(tmp_path / "r.mcap", outcome, [innovation] * profiles)
    steps = next_steps(contents)
    # there is no plan, nor an estimate
    assert steps[int(nis > 2.0)].startswith(first)
    assert (outcome.verdict.word == "trust") == (nis < 2.0)
    assert lights(contents)[2].color == ("good" if nis < 2.0 else "care")
