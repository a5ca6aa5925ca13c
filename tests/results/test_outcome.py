"""The outcome of a run: the same from the run and from its record, and a verdict with its reasons."""

import json
import math
from dataclasses import fields, replace

import pytest

from replay_kit.core.errors import Finding, MeasurementError
from replay_kit.core.message import Loss
from replay_kit.results.outcome.from_run import failed, outcome_of
from replay_kit.results.outcome.outcome import Outcome, outcome_from
from replay_kit.results.outcome.run import DiveRow, ReplaySummary, TopicRow

RUN = ReplaySummary(
    (TopicRow("/adcp", 5, 4, 1, {"late: by 3 s": 1}),),
    (),
    0,
    4,
    1,
    9,
    {"amplitude": 2},
    0.1,
    0.05,
    0.2,
    1.1,
    (DiveRow(1, 4, 9, 0.1, math.nan, 1.1),),
    notes=("members: 40 fields",),
)
FINDING = Finding("turned", 0, "by 30 degrees", "the compass", "set it right")
LOST = (("a.mcap", Loss("damage", 3, 5, None, None, None)),)
OUTSIDE = "the log begins 2.0 days outside the forecast's times"
PLAN = {"message": "ok", "odds": None}


def test_what_a_result_keeps_gives_the_outcome_of_the_run_field_by_field():
    made = outcome_of(replace(RUN, findings=(FINDING,), losses=LOST, doubts=("shear alone",)))
    kept = outcome_from(json.loads(json.dumps(made.to_record(), allow_nan=False)))
    for one in fields(Outcome):
        assert getattr(kept, one.name) == getattr(made, one.name), one.name
    assert kept.to_json() == made.to_json()
    assert kept != outcome_of(RUN)


def test_wall_times_are_of_the_run_alone():
    made = outcome_of(replace(RUN, seconds={"read": 1.0}))
    assert made.to_json()["seconds"] == {"read": 1.0}
    assert outcome_from(made.to_record()).seconds == {}
    assert made == outcome_of(RUN)


@pytest.mark.parametrize(
    ("changes", "plan", "word", "reason"),
    [
        ({}, None, "trust", ""),
        ({}, PLAN | {"status": "reached"}, "trust", ""),
        ({"losses": LOST}, None, "with care", "part of the log was lost"),
        ({"nis_per_dof": 2.5}, None, "with care", "errors are larger than stated"),
        ({"nis_per_dof": 0.4}, None, "with care", "errors are smaller than stated"),
        ({"outside": (OUTSIDE,)}, None, "with care", OUTSIDE),
        ({}, PLAN | {"status": "partial"}, "with care", "the plan is partial"),
        ({}, PLAN | {"status": "unsafe"}, "with care", "the plan is unsafe"),
        ({}, PLAN | {"status": "reached", "odds": {"reached": 0.0}}, "with care", "no sample"),
        ({"findings": (FINDING,)}, None, "do not use", "turned"),
        ({"findings": (replace(FINDING, severity="warning"),)}, None, "with care", "turned"),
        ({"profiles_used": 0}, None, "do not use", "no observation was used"),
    ],
)
def test_the_verdict_follows_what_was_found_and_changes_no_exit_code(changes, plan, word, reason):
    run = replace(RUN, **changes)
    outcome = replace(outcome_of(run), plan=plan)
    assert outcome.decision.word == word
    assert (reason in "; ".join(outcome.decision.reasons)) == bool(reason or word == "trust")
    assert bool(outcome.decision.reasons) == (word != "trust")
    assert outcome.exit_code == run.exit_code
    assert outcome.to_json()["decision"] == word
    assert repr(outcome).startswith(word)


def test_a_run_of_several_is_trusted_as_far_as_the_least_trusted_vehicle():
    uncertain = PLAN | {"status": "uncertain"}
    each = {
        "sg1": replace(outcome_of(RUN), plan=uncertain).to_json(),
        "sg2": outcome_of(RUN).to_json(),
        "sg3": replace(outcome_of(replace(RUN, losses=LOST)), plan=uncertain).to_json(),
    }
    decision = replace(outcome_of(RUN), vehicles=each).decision
    told = ("sg1, sg3: the plan is uncertain", "sg3: part of the log was lost")
    assert decision == ("with care", told)
    contradicts = {"sg2": outcome_of(replace(RUN, findings=(FINDING,))).to_json()}
    decision = replace(outcome_of(RUN), vehicles=each | contradicts).decision
    assert decision.word == "do not use"
    assert "sg2: turned" in decision.reasons
    assert replace(outcome_of(RUN), vehicles={"sg2": each["sg2"]}).decision.word == "trust"


def test_a_run_that_failed_is_not_to_be_used_and_says_why():
    error = MeasurementError("no usable ping", findings=(FINDING,))
    for outcome in (failed(error), failed(error, RUN)):
        assert outcome.decision == ("do not use", ("no usable ping",))
        answer = outcome.to_json()
        assert (answer["status"], answer["exit_code"], answer["error"]) == (
            "failed",
            3,
            "no usable ping",
        )
        assert [one["name"] for one in answer["consistency"]] == ["turned"]
    assert failed(error, RUN).observations["used"] == 4


def test_of_an_earlier_version_as_much_is_read_as_it_kept():
    old = {
        "verdict": [
            "1 of 2 observations used",
            "none",
            "gain",
            "stated errors fit (NIS 1 per degree of freedom)",
            "shear alone",
        ]
    }
    outcome = outcome_from(old | {"nis_per_dof": 1.0, "status": "done", "unknown": 3})
    assert outcome.doubts == ["shear alone"]
    assert outcome.messages is None
