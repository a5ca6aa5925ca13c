"""Notes are not among what looks wrong, and the page judges errors as the verdict does."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.report.sections.answer import found_warnings, next_steps


def test_notes_on_how_the_log_was_read_are_notes():
    names = "glider_1.nc: 5 variables were read by their names"
    contents = SimpleNamespace(
        outcome=Outcome(notes=(names, "a fix <b> jumps", "300 modes a level")),
        result=SimpleNamespace(events=pd.DataFrame({"level": [], "message": []})),
        measured=SimpleNamespace(
            innovations=pd.DataFrame(
                {
                    f"innovation{std}_{axis}": []
                    for std in ("", "_std")
                    for axis in ("east", "north")
                }
            )
        ),
    )
    # the name of a file stays as it is
    assert found_warnings(contents) == [  # type: ignore[arg-type]
        ("note", f"{names}."),
        ("note", "A fix &lt;b&gt; jumps."),
        ("note", "300 modes a level."),
    ]


@pytest.mark.parametrize(
    ("nis", "profiles", "first"),
    [(1.3, 3, "No action needed"), (2.07, 3, "Run <code>replay-kit qc"), (2.07, 0, "Compare")],
)
def test_steps_follow_the_verdict_and_can_be_run(nis, profiles, first):
    """Quality control refuses logs of mean currents alone."""
    counts = {**Outcome().observations, "used": 400}
    outcome = Outcome(nis_per_dof=nis, observations=counts)
    contents = SimpleNamespace(
        outcome=outcome,
        result=SimpleNamespace(plans=[0]),
        estimate=0,
        bins=SimpleNamespace(time_ns=np.zeros(profiles)),
    )
    (step,) = next_steps(contents)  # type: ignore[arg-type]
    assert step.startswith(first)
    assert (outcome.verdict.word == "trust") == step.startswith("No action")
