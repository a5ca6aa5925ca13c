"""Tables of topics in a narrow terminal, the codes of reasons, and sentences on plans and surfacings."""

import io
import math
from dataclasses import replace

from replay_kit.core.surfacing import Ellipse, Surfacing, SurfacingOutcome
from replay_kit.results.losses import code_of, coded_reasons
from replay_kit.results.outcome.outcome import checked_outcome
from replay_kit.results.outcome.parts import plan_part, surfacings_part
from replay_kit.show.sentences import energy_sentence, outcomes_sentence
from replay_kit.show.status.status import status_of
from replay_kit.show.summary import print_summary
from replay_kit.show.text import SafeConsole
from tests.show.status.held_samples import held

START = 17_851 * 86_400 * 10**9


def printed(work, width: int = 80) -> list[str]:
    said = io.StringIO()
    work(SafeConsole(file=said, width=width))
    return [line.rstrip() for line in said.getvalue().splitlines()]


def test_a_code_has_no_numbers_and_no_details():
    codes = {
        "later than the reorder window allows": "later_than_the_reorder_window_allows",
        "GPS fix without time, or bad (quality 3)": "gps_fix_without_time",
        "of MAVLink system 7, where 1 counts": "of_mavlink_system",
        "12.5: -3": "other",
    }
    assert {reason: code_of(reason) for reason in codes} == codes


def test_tables_of_topics_and_dives_are_printed_when_asked_for():
    reasons = coded_reasons({"late: by 3 s": 2})
    rms = {"rms_innovation_predicted": 0.3, "rms_innovation_prior": None, "nis_per_dof": 1.0}
    found = checked_outcome(
        {
            "messages": [
                {"topic": f"/adcp/cell_{k}", "read": 5, "used": 3, "skipped": 2, "reasons": reasons}
                for k in (1, 2, 3)
            ],
            "observations": {"used": 4, "rejected": 0, "bins_used": 4, "bins_rejected": {}},
            "by_dive": [{"dive": 7, "profiles": 1, "bins": 3, "mean_currents": 0, **rms}],
        }
    )
    few, whole = (
        printed(lambda on, v=v: print_summary({"": status_of(held())}, found, on, verbose=v), 400)
        for v in (False, True)
    )
    assert not any("/adcp" in line for line in few)
    assert sum(line.startswith("/adcp/cell_") for line in whole) == 3
    assert ["7", "1", "3", "0", "30.00", "1.00"] in [line.split() for line in whole]


def test_energy_is_told_with_its_share_of_the_battery_and_null_if_unknown(plan):
    for energy, expected in ((5.0, 5.0), (math.nan, None), (math.inf, None)):
        kept = checked_outcome(
            {"plan": plan_part(replace(plan, energy=energy, battery=energy))}
        ).plan
        assert (kept["energy_j"], kept["battery_j"]) == (expected, expected)
    said = "2,100 kJ, 105.0 % of 2 MJ: more than the battery holds"
    assert str(energy_sentence(2e6, 2e6)) == "2,000 kJ, 100.0 % of 2 MJ"
    assert str(energy_sentence(2.1e6, 2e6)) == said


def test_surfacings_are_told_by_the_medians_of_their_errors_and_the_share_inside():
    ellipse = Ellipse(5.0, 62.0, 2000.0, 1000.0, 90.0)
    misses = ((ellipse, 60, 0.03, 1.5e3), (ellipse, -120, 0.06, 3e3), (None, 240, 0.0, 9e3))
    each = [
        SurfacingOutcome(
            *(START, Surfacing(START, 5.0, 62.0, area), START + late * 10**9),
            *(5.0 + away, 62.0, distance, 90.0),
        )
        for area, late, away, distance in misses
    ]
    told = surfacings_part(each)
    said = "Surfaced 3.0 km from the plan, +1 min (median of 3), 50 % inside the 90 % ellipse"
    assert str(outcomes_sentence(told)) == said
    assert [one["inside_ellipse"] for one in told["each"]] == [True, False, None]
