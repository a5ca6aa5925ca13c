"""Tables of topics in a narrow terminal, and the codes of reasons."""

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
from replay_kit.show.text import (
    SafeConsole,
    fold_names,
    folded,
    not_used_lines,
    print_table,
    short_times,
)
from tests.show.status.held_samples import held

DAY = 86_400 * 10**9
# 2018-11-16
START = 17_851 * DAY


def printed(work, width: int = 80) -> list[str]:
    said = io.StringIO()
    work(SafeConsole(file=said, width=width))
    return [line.rstrip() for line in said.getvalue().splitlines()]


@pytest.mark.parametrize(
    ("names", "one"),
    [
        (
            [f"/glider42/adcp/cell_{k:02}" for k in range(1, 9)],
            "/glider42/adcp/cell_01 ... _08, 8 topics",
        ),
        (["/adcp1/status", "/adcp2/status"], "/adcp1/status ... p2/status, 2 topics"),
        (["1", "2"], "1 ... 2, 2 topics"),
        (["/a"], "/a"),
    ],
)
def test_names_that_differ_in_a_number_are_one(names, one):
    assert fold_names(names) == one


def test_rows_fold_that_are_equal_but_for_one_number():
    rows = [
        ("/a1", "5"),
        ("/a2", "5"),
        ("/a3", "6"),
        ("/b3", "6"),
        ("/b4/c4", "6"),
        ("/b5/c5", "6"),
        ("/b5/c6", "6"),
    ]
    assert folded(rows) == [
        ("/a1 ... a2, 2 topics", "5"),
        ("/a3", "6"),
        ("/b3", "6"),
        ("/b4/c4", "6"),
        ("/b5/c5 ... c6, 2 topics", "6"),
    ]
    assert folded(rows, whole=True) == rows


@pytest.mark.parametrize(
    ("times", "short"),
    [
        ((START, START + DAY - 10**9, None), ["00:00:00", "23:59:59", ""]),
        ((START, START + DAY), ["11-16 00:00", "11-17 00:00"]),
        ((START, START + 60 * DAY), ["2018-11-16 00:00", "2019-01-15 00:00"]),
        ((None, None), ["", ""]),
    ],
)
def test_times_are_shown_without_what_they_share(times, short):
    assert short_times(times) == short


def test_a_table_keeps_names_and_folds_words_at_80_columns():
    name, schema = (
        "/vehicles/glider42/sensors/adcp/current",
        "marine_acoustic_msgs/msg/CurrentProfile",
    )
    lines = printed(
        lambda console: print_table(
            console, "Topics", ("topic", "schema", "n"), [(name, schema, "12"), ("/b", "x", "3")]
        )
    )
    assert lines[0] == "Topics"
    assert max(map(len, lines)) <= 80
    assert any(
        line.startswith(f"{name}  marine_acoustic_msgs") and line.endswith(" 12") for line in lines
    )
    assert lines[-1].startswith("/b ")
    assert lines[-1].endswith("   3")


def test_a_name_wider_than_the_terminal_is_whole():
    name = "/" + "0123456789" * 9
    lines = printed(lambda console: print_table(console, None, ("topic", "n"), [(name, "12")]))
    assert max(map(len, lines)) <= 80
    assert "".join(line.removesuffix("12").strip() for line in lines[1:]) == name


@pytest.mark.parametrize(
    ("reason", "code"),
    [
        ("not needed by the estimator, or outside the time span", "not_needed_by_the_estimator"),
        ("later than the reorder window allows", "later_than_the_reorder_window_allows"),
        (
            "GPS fix without time or position, or flagged bad (quality 3)",
            "gps_fix_without_time_or_position",
        ),
        ("of MAVLink system 7, where 1 counts", "of_mavlink_system"),
        ("position in the frame 'earth', whose axes", "position_in_the_frame"),
        ("no fix (status < 0)", "no_fix"),
        ("12.5: -3", "other"),
    ],
)
def test_a_code_has_no_numbers_and_no_details(reason, code):
    assert code_of(reason) == code


def test_topics_alike_share_a_line_unless_all_are_asked_for():
    not_used = {"/a1": {"late": 2}, "/a2": {"late": 3}, "/b": {"late": 4, "empty": 1}}
    assert list(not_used_lines(not_used, whole=False)) == [
        "Not used: 1 x /b: empty",
        "Not used: 9 x /a1 ... a2, 2 topics, /b: late",
    ]
    assert list(not_used_lines(not_used)) == [
        "Not used: 2 x /a1: late",
        "Not used: 3 x /a2: late",
        "Not used: 4 x /b: late",
        "Not used: 1 x /b: empty",
    ]


COUNTS = {"used": 4, "rejected": 0, "bins_used": 4, "bins_rejected": {}}
DIVES = ((1, 1, 0.1), (2, 3, 0.3), (3, 0, math.nan), (4, 1, 0.2), (5, 1, 0.05))
FOUND = {
    "messages": [
        {"topic": f"/adcp/cell_{k}", "read": 5, "used": 3, "skipped": 2}
        | {"reasons": coded({"late: by 3 s": 2})}
        for k in (1, 2, 3)
    ],
    "observations": COUNTS,
    "rms_innovation": dict.fromkeys(("before", "after", "prior"), 0.1),
    "nis_per_dof": 1.0,
    "by_dive": [
        {"dive": k, "profiles": 1, "bins": bins, "rms_innovation_predicted": rms}
        | {"rms_innovation_prior": 0.2, "nis_per_dof": 1.0}
        for k, bins, rms in DIVES
    ],
}


def test_tables_of_topics_and_dives_are_printed_when_asked_for():
    found, statuses = made(FOUND), {"": status_of(held())}
    few, whole = (
        printed(lambda console, v=v: print_summary(statuses, found, console, verbose=v), 400)
        for v in (False, True)
    )
    assert not any("/adcp" in line for line in few)
    assert sum(line.startswith("/adcp/cell_") for line in whole) == 3
    assert [line.split() for line in whole if line.split()[1:3] == ["1", "3"]] == [
        ["2", "1", "3", "30.00", "20.00", "1.00"]
    ]


def test_reasons_have_codes_in_json():
    assert made(FOUND).to_json()["messages"][0]["reasons"] == [
        {"code": "late", "reason": "late: by 3 s", "count": 2}
    ]


def test_energy_that_is_not_known_is_null(plan):
    for energy, told in ((5.0, 5.0), (math.nan, None), (math.inf, None)):
        kept = made({"plan": plan_part(replace(plan, energy=energy, battery=energy))}).plan
        assert (kept["energy_j"], kept["battery_j"]) == (told, told)


def test_surfacings_are_told_by_the_medians_of_their_errors_and_the_share_inside():
    ellipse = Ellipse(5.0, 62.0, 2000.0, 1000.0, 90.0)
    misses = (
        (ellipse, 60, 0.03, 1.5e3),
        (ellipse, -120, 0.06, 3e3),
        (ellipse, 600, 0.0, 0.0),
        (None, 240, 0.0, 9e3),
    )
    made = [
        SurfacingOutcome(
            START,
            Surfacing(START, 5.0, 62.0, area),
            START + late * 10**9,
            5.0 + away,
            62.0,
            distance,
            90.0,
        )
        for area, late, away, distance in misses
    ]
    assert (
        str(outcomes_sentence(surfacings_part(made)))
        == "Surfaced 2250 m from the plan, +2 min (median of 4), 67 % inside the 90 % ellipse"
    )
    assert (
        str(outcomes_sentence(surfacings_part(made[3:])))
        == "Surfaced 9000 m from the plan, +4 min (median of 1)"
    )
    told = surfacings_part(made)
    assert [one["inside_ellipse"] for one in told["each"]] == [True, False, True, None]
    assert [one["delay_s"] for one in told["each"]] == [60.0, -120.0, 600.0, 240.0]
    assert (told["count"], told["inside_ellipse"], surfacings_part(made[3:])["inside_ellipse"]) == (
        4,
        pytest.approx(2.0 / 3.0),
        None,
    )


def test_energy_is_told_with_its_share_of_the_battery():
    assert str(energy_sentence(250_000.0, None)) == "250 kJ"
    assert str(energy_sentence(250_000.0, 1e6)) == "250 kJ, 25.0 % of 1 MJ"
    assert str(energy_sentence(2e6, 2e6)) == "2,000 kJ, 100.0 % of 2 MJ"
    assert (
        str(energy_sentence(2.1e6, 2e6)) == "2,100 kJ, 105.0 % of 2 MJ: more than the battery holds"
    )
