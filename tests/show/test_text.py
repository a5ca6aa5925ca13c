"""Tables of topics in a narrow terminal, the codes of reasons, and sentences on plans and surfacings."""

import io
import math
from dataclasses import replace

import pytest

from replay_kit.core.surfacing import Ellipse, Surfacing, SurfacingOutcome
from replay_kit.results.losses import code_of, coded
from replay_kit.results.outcome.outcome import made
from replay_kit.results.outcome.parts import plan_part, surfacings_part
from replay_kit.show.sentences import energy_sentence, outcomes_sentence
from replay_kit.show.status.status import status_of
from replay_kit.show.summary import print_summary
from replay_kit.show.text import SafeConsole, folded, not_used_lines, print_table, short_times
from tests.show.status.held_samples import held

DAY = 86_400 * 10**9
# 2018-11-16
START = 17_851 * DAY
ROWS = "/a1 5,/a2 5,/a3 6,/b4/c4 6,/b5/c_05 6,/b5/c_06 6,1 7"
FOLDED = "/a1 ... /a2, 2 topics 5;/a3 6;/b4/c4 6;/b5/c_05 ... /b5/c_06, 2 topics 6;1 7"


def printed(work, width: int = 80) -> list[str]:
    said = io.StringIO()
    work(SafeConsole(file=said, width=width))
    return [line.rstrip() for line in said.getvalue().splitlines()]


def test_rows_fold_that_are_equal_but_for_one_number():
    rows = [tuple(row.split()) for row in ROWS.split(",")]
    assert [" ".join(row) for row in folded(rows)] == FOLDED.split(";")
    assert folded(rows, whole=True) == rows


@pytest.mark.parametrize(
    ("times", "short"),
    [
        ((START, START + DAY - 10**9, None), ["00:00:00", "23:59:59", ""]),
        ((START, START + DAY), ["11-16 00:00", "11-17 00:00"]),
        ((START, START + 60 * DAY), ["2018-11-16 00:00", "2019-01-15 00:00"]),
    ],
)
def test_times_are_shown_without_what_they_share(times, short):
    assert short_times(times) == short


def test_a_table_keeps_names_and_folds_words_at_80_columns():
    name, long = "/vehicles/glider42/sensors/adcp/current", "/" + "0123456789" * 9
    rows = [(name, "marine_acoustic_msgs/msg/CurrentProfile", "12"), ("/b", "x", "3")]
    lines = printed(lambda console: print_table(console, "Topics", ("topic", "schema", "n"), rows))
    assert (lines[0], max(map(len, lines)) <= 80) == ("Topics", True)
    assert any(line.startswith(f"{name}  marine") and line.endswith(" 12") for line in lines)
    assert lines[-1].endswith("   3")
    # a name wider than the terminal is whole
    lines = printed(lambda console: print_table(console, None, ("topic", "n"), [(long, "12")]))
    assert "".join(line.removesuffix("12").strip() for line in lines[1:]) == long


def test_a_code_has_no_numbers_and_no_details():
    codes = {
        "later than the reorder window allows": "later_than_the_reorder_window_allows",
        "GPS fix without time, or bad (quality 3)": "gps_fix_without_time",
        "of MAVLink system 7, where 1 counts": "of_mavlink_system",
        "12.5: -3": "other",
    }
    assert {reason: code_of(reason) for reason in codes} == codes


def test_topics_alike_share_a_line_unless_all_are_asked_for():
    not_used = {"/a1": {"late": 2}, "/a2": {"late": 3}, "/b": {"late": 4, "empty": 1}}
    few, all_of = (
        [line.removeprefix("Not used: ") for line in not_used_lines(not_used, whole)]
        for whole in (False, True)
    )
    assert few == ["1 x /b: empty", "9 x /a1 ... /a2, 2 topics, /b: late"]
    assert all_of == ["2 x /a1: late", "3 x /a2: late", "4 x /b: late", "1 x /b: empty"]


def test_tables_of_topics_and_dives_are_printed_when_asked_for():
    reasons = coded({"late: by 3 s": 2})
    rms = {"rms_innovation_predicted": 0.3, "rms_innovation_prior": None, "nis_per_dof": 1.0}
    found = made(
        {
            "messages": [
                {"topic": f"/adcp/cell_{k}", "read": 5, "used": 3, "skipped": 2, "reasons": reasons}
                for k in (1, 2, 3)
            ],
            "observations": {"used": 4, "rejected": 0, "bins_used": 4, "bins_rejected": {}},
            "by_dive": [{"dive": 7, "profiles": 1, "bins": 3, **rms}],
        }
    )
    few, whole = (
        printed(lambda on, v=v: print_summary({"": status_of(held())}, found, on, verbose=v), 400)
        for v in (False, True)
    )
    assert not any("/adcp" in line for line in few)
    assert sum(line.startswith("/adcp/cell_") for line in whole) == 3
    assert ["7", "1", "3", "30.00", "1.00"] in [line.split() for line in whole]
    first = found.to_json()["messages"][0]["reasons"]
    assert first == [{"code": "late", "reason": "late: by 3 s", "count": 2}]


def test_energy_is_told_with_its_share_of_the_battery_and_null_if_unknown(plan):
    for energy, expected in ((5.0, 5.0), (math.nan, None), (math.inf, None)):
        kept = made({"plan": plan_part(replace(plan, energy=energy, battery=energy))}).plan
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
    told, last = surfacings_part(each), surfacings_part(each[2:])
    said = "Surfaced 3000 m from the plan, +1 min (median of 3), 50 % inside the 90 % ellipse"
    assert str(outcomes_sentence(told)) == said
    assert str(outcomes_sentence(last)) == "Surfaced 9000 m from the plan, +4 min (median of 1)"
    assert [one["inside_ellipse"] for one in told["each"]] == [True, False, None]
