"""The outcome of a run: the same from the run and from its record, and a verdict with its reasons."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from replay_kit.core.errors import Finding, MeasurementError, finding_json
from replay_kit.core.message import Loss
from replay_kit.results.losses import loss_json
from replay_kit.results.outcome.outcome import checked_outcome, failed_outcome, outcome_from

RUN = {
    "messages": [{"topic": "/adcp", "read": 5, "used": 4, "skipped": 1, "reasons": []}],
    "observations": {"used": 40, "rejected": 1, "bins_used": 9, "bins_rejected": {"amplitude": 2}},
    "rms_innovation": {"before": 0.1, "after": 0.05, "prior": 0.2},
    "nis_per_dof": 1.1,
    "by_dive": [{"dive": 1, "profiles": np.int64(4), "rms_innovation_prior": math.nan}],
    "notes": ("members: 40 fields of /data/sea/ensemble.nc",),
}
FINDING = Finding("turned", 0, "by 30 degrees", "the compass", "set it right")
FOUND = [finding_json(FINDING)]
WARNED = [finding_json(replace(FINDING, severity="warning"))]
LOST = [{"file": "a.mcap"} | loss_json(Loss("damage", 3, 5, None, None, None))]
NONE = {"n_samples": 40, "reached": 0.0}
OUTSIDE = "the log begins 2.0 days outside the forecast's times"
PLAN = {"message": "ok", "odds": None}


def test_what_a_result_keeps_is_the_outcome_of_the_run_but_for_wall_times_and_score():
    own = checked_outcome(RUN | {"plan": PLAN | {"status": "partial"}})
    late = {"seconds": {"read": 1.0}, "truth": {"rmse": 0.1}}
    for more in ({"consistency": FOUND, "losses": LOST}, {"vehicles": {"sg1": own}}):
        outcome = checked_outcome(RUN | more | late, [Path("/data/sea/ensemble.nc")])
        kept = outcome_from(json.loads(outcome.to_record()))
        assert kept == outcome == outcome_from(outcome.to_json())
        assert kept.to_json() == outcome.to_json() | {"seconds": {}, "truth": None}
        assert json.loads(json.dumps(outcome.to_json(), allow_nan=False)) == outcome.to_json()
    assert kept.by_dive == ({"dive": 1, "profiles": 4, "rms_innovation_prior": None},)
    assert kept.notes == ("members: 40 fields of ensemble.nc",)


@pytest.mark.parametrize(
    ("changes", "plan", "word", "reason"),
    [
        ({}, None, "trust", ""),
        ({}, PLAN | {"status": "reached"}, "trust", ""),
        ({"losses": LOST}, None, "with care", "part of the log was lost"),
        ({"nis_per_dof": 2.5}, None, "with care", "errors 58 % larger than stated"),
        ({"nis_per_dof": 0.4}, None, "with care", "errors 37 % smaller than stated"),
        ({"outside": (OUTSIDE,)}, None, "with care", OUTSIDE),
        ({}, PLAN | {"status": "unsafe"}, "with care", "the plan is unsafe"),
        ({}, PLAN | {"status": "reached", "odds": NONE}, "with care", "no simulated flight"),
        ({"consistency": FOUND, "losses": LOST}, None, "do not use", "turned"),
        ({"consistency": WARNED}, None, "with care", "turned"),
        (
            {"observations": {"used": 0, "rejected": 1}},
            None,
            "do not use",
            "no observation was used",
        ),
    ],
)
def test_the_verdict_follows_what_was_found_and_changes_no_exit_code(changes, plan, word, reason):
    outcome = checked_outcome(RUN | changes | {"plan": plan})
    assert outcome.verdict.word == word
    assert (reason in "; ".join(outcome.verdict.reasons)) == bool(reason or word == "trust")
    codes = (4,) * ("losses" in changes) + (6,) * (changes.get("consistency") is FOUND)
    assert outcome.exit_codes == codes


def test_a_run_of_several_is_trusted_as_far_as_the_least_trusted_vehicle():
    uncertain = {"plan": PLAN | {"status": "uncertain"}}
    each = {
        "sg1": checked_outcome(RUN | uncertain),
        "sg2": checked_outcome(RUN),
        "sg3": checked_outcome(RUN | uncertain | {"losses": LOST}),
    }
    decision = checked_outcome(RUN | {"vehicles": each}).verdict
    told = ("sg1, sg3: the plan is uncertain", "sg3: part of the log was lost")
    assert decision == ("with care", told)
    contradicts = {"sg2": checked_outcome(RUN | {"consistency": FOUND})}
    outcome = checked_outcome(RUN | {"vehicles": each | contradicts})
    assert outcome.verdict.word == "do not use"
    assert "sg2: turned" in outcome.verdict.reasons
    assert outcome.exit_codes == (6,)


def test_a_run_that_failed_is_not_to_be_used_and_says_why():
    error = MeasurementError("no usable ping", findings=(FINDING,))
    for outcome in (failed_outcome(error), failed_outcome(error, checked_outcome(RUN))):
        assert outcome.verdict == ("do not use", ("no usable ping",))
        answer = outcome.to_json()
        assert (answer["status"], answer["exit_code"], answer["error"]) == (
            "failed",
            3,
            "no usable ping",
        )
        assert [one["name"] for one in answer["consistency"]] == ["turned"]


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
    assert outcome.doubts == ("shear alone",)
    assert outcome.messages is None
