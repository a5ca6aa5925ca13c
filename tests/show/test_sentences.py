"""Sentences on an outcome: each number in them carries its field."""

import re
from typing import Any

from replay_kit.results.outcome.outcome import Outcome, leaves
from replay_kit.show.numbers import Shown
from replay_kit.show.sentences import estimate_sentences, flown_sentences, trust_sentences


def fields(text: str) -> dict[str, Any]:
    """Return numbers and words by name, of ``name=value`` each."""
    pairs = (each.split("=") for each in text.split())
    return {name: float(value) if value[-1].isdigit() else value for name, value in pairs}


_PAST = fields(
    "count=6 inside_50=0.61 inside_90=0.83 distance_median_m=318 radius_90_mean_m=602 log_score_gain=0.47 radius_ratio=0.76"
)
_SOURCE = fields(
    "kind=radar used=31 rejected=2 values=244 nis_per_dof=1.06 rms_before=0.081 rms_after=0.064 rms_prior=0.113"
)
_AGAINST = fields("ensemble=other.nc compared=5 not_compared=2 gain_mean=1.26 better=first")
RICH = Outcome(
    observations={
        **fields("used=52 rejected=3 bins_used=409 mean_currents=21"),
        **{"bins_rejected": {"missing": 17}, "sources": [_SOURCE | {"doubts": ["too smooth"]}]},
    },
    rms_innovation=fields("before=0.071 after=0.044 prior=0.102"),
    nis_per_dof=0.93,
    surfacings=fields("count=4 distance_median_m=655 delay_median_s=-540 inside_ellipse=0.75"),
    predicted_surfacings=_PAST | {"later": _PAST, "each": [], "next": None},
    evidence=fields("log_evidence=41.7 measurements=11 per_measurement=3.79") | {"by_dive": []},
    comparison={
        **{"ensemble": "{one}.nc", "units": "dives"},
        "against": [_AGAINST | {"interval_90": [0.22, 2.31]}],
    },
    flight_correction=fields(
        "corrected=21 rms_m_s=0.021 largest_m_s=0.043 dives=22 along=0.14 along_std=0.03 across=-0.02 across_std=0.04 evidence=9.6"
    ),
)
#: What is no number of the outcome: shares that ellipses are to hold, and what follows from several numbers.
_KNOWN = r"[59]0 % (ellipse|one|interval|within)|of 90 %|0(\.0)? profiles.*|-?[\d.]+ profiles used \(\d+ bins\)"


def test_each_number_of_a_sentence_carries_its_field():
    said = [*estimate_sentences(RICH), *flown_sentences(RICH), *trust_sentences(RICH)]
    assert len(said) == 8
    outcome = dict(leaves(RICH.to_json()))
    for one in said:
        for part in one.parts:
            if isinstance(part, Shown):
                assert outcome[part.key] == part.value
            else:
                assert re.findall(r"\d", re.sub(_KNOWN, "", part)) == [], str(one)
    text = "\n".join(map(str, said))
    for words in (
        "by 2.1 cm/s RMS, 4.3 cm/s at most; from 22",
        "this error is 14 ± 3 % of the way through the water along it and -2 ± 4 % across",
        "inside the 50 % ellipse, 83 % inside the 90 % ellipse",
        "{one}.nc explained the log better; log evidence +1.26 a dive over 5",
    ):
        assert words in text
