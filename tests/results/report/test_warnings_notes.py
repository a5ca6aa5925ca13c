"""Notes that state what was chosen are not among what looks wrong."""

from types import SimpleNamespace

import numpy as np
import pandas as pd

from replay_kit.results.report.sections.in_words import _depths
from replay_kit.results.report.sections.warnings import what_was_chosen


def test_notes_of_what_was_chosen_stand_apart() -> None:
    notes = ["members: 40 fields", "300 modes a level", "a fix <b> jumps", "3 logs: the recorder's stamps are +0.000 s from UTC"]
    contents = SimpleNamespace(summary={"notes": notes}, result=SimpleNamespace(events=pd.DataFrame({"level": [], "message": []})))
    said = what_was_chosen(contents)  # type: ignore[arg-type]
    assert said == ["Members: 40 fields.", "300 modes a level.", "3 logs: the recorder&#x27;s stamps are +0.000 s from UTC."]


def test_a_depth_of_a_little_above_the_surface_is_no_negative_zero() -> None:

    assert _depths(np.array([-0.2, np.nan, 12.4])) == "0 to 12 m"
