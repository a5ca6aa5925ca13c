"""A result on one screen: each answer against what was put in, and what wakes a person."""

import base64
import hashlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from pyproj import Geod

from replay_kit.core.as_flown import AS_FLOWN, AsFlown, FlownDive
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Source, VehicleState
from replay_kit.core.plan import ORIGIN
from replay_kit.results import ResultWriter
from replay_kit.results.outcome.outcome import Outcome, outcome_from
from replay_kit.results.reader import ResultReader
from replay_kit.show.status import figures
from replay_kit.show.status.alarms import alarms_of, change_of
from replay_kit.show.status.held import Fix, read_held
from replay_kit.show.status.lines import age_text, brief_text, status_text
from replay_kit.show.status.page import status_page
from replay_kit.show.status.status import status_of
from tests.cli.test_cli_settings import loaded
from tests.command import invoke
from tests.places import SAMPLES
from tests.show.status.held_samples import HOUR_NS, START_NS, held, mean_current, plan

END_NS = START_NS + 48 * HOUR_NS


def kinds(values, now_ns=END_NS):
    return [alarm.kind for alarm in alarms_of(values, now_ns)]


def test_what_is_made_good_is_how_much_nearer_the_goal_came_a_day():
    day, mission = figures.made_good(held())
    geod = Geod(ellps="WGS84")
    begin, before, end = (
        geod.inv(longitude, 62.0, 5.5, 62.0)[2] / 1e3 for longitude in (4.65, 4.9, 5.0)
    )
    assert (day.days, mission.days) == (pytest.approx(25.0 / 24.0), pytest.approx(2.0))
    assert day.km_a_day == pytest.approx((before - end) / day.days)
    assert mission.km_a_day == pytest.approx((begin - end) / 2.0)
    assert mission.error == pytest.approx(0.02 * 2.0**0.5 / 2.0)


@pytest.mark.parametrize("seed", range(6))
def test_positions_held_are_the_first_the_last_one_a_day_before_and_where_it_was_reckoned_since(
    seed, tmp_path
):
    rng = np.random.default_rng(seed)
    said = [
        Fix(int(time), float(k), -5.0, bool(rng.random() < 0.6))
        for k, time in enumerate(np.sort(rng.integers(0, 60, 9)) * HOUR_NS)
    ]

    def positions(said):
        with ResultWriter(tmp_path / "r.mcap", overwrite=True) as writer:
            writer.start(Projection(5.0, 62.0), 0, {}, "")
            for fix in said:
                place = fix.longitude, fix.latitude
                writer.fix(
                    VehicleState(fix.time_ns, *place, 0.0, fix.reckoned, Source(0, "/", 0, 0))
                )
        found = read_held(ResultReader(tmp_path / "r.mcap"))
        return found.fixes, found.reckoned

    measured = [fix for fix in said if not fix.reckoned]
    day_before = [fix for fix in measured if measured[-1].time_ns - fix.time_ns >= 24 * HOUR_NS]
    reckoned = said[-1] if said[-1].reckoned and said[-1].time_ns > measured[-1].time_ns else None
    assert positions(said) == ([measured[0], *day_before[-1:], measured[-1]], reckoned)
    alone = [replace(fix, reckoned=True) for fix in said]
    assert positions(alone) == ([], alone[-1])
    assert positions([]) == ([], None)


def test_a_vehicle_without_goal_or_way_makes_nothing_good():
    assert figures.made_good(held(plans=[])) == []
    assert figures.made_good(held(fixes=held().fixes[-1:])) == []


def test_the_current_of_the_last_dive_stands_beside_the_estimate_s():
    found = figures.dive_current(held())
    assert found.measured.toward == pytest.approx(90.0, abs=0.1)
    assert found.difference == pytest.approx(0.1)
    assert found.expected == pytest.approx(0.02)
    assert found.corrected is None
    assert figures.dive_current(held(dive=None)) is None


def test_what_was_measured_stands_before_what_the_correction_made_of_it():
    errors = {"mean_std": 0.01, "corrected_std": 0.02}
    one = mean_current(END_NS, (0.1, 0.0), (0.0, 0.0), 0.02, (0.0, 0.05), **errors)
    found = figures.dive_current(held(dive=one))
    assert (found.measured.speed, found.corrected.speed) == pytest.approx((0.1, 0.05))
    assert found.difference == pytest.approx(0.05)
    status = status_of(held(dive=one))
    (line,) = (line for line in status.lines if line.key == "current")
    assert line.text[:2] == (
        "dive 7 measured 10.0 ± 1.0 cm/s toward 90°",
        "dive 7 corrected for the flight model's error 5.0 ± 2.0 cm/s toward 0°",
    )
    assert status.figures["current"]["measured"]["standard_error"] == 0.01
    # a result of version 0.2.0 holds the corrected one alone
    old = held(dive=mean_current(END_NS, None, (0.0, 0.0), 0.02, (0.1, 0.0)))
    found = figures.dive_current(old)
    assert found.measured is None
    assert found.corrected.speed == pytest.approx(0.1)
    assert "measured" not in " ".join(
        next(line for line in status_of(old).lines if line.key == "current").text
    )


def test_a_surfacing_is_overdue_by_a_share_of_its_leg_and_the_next_leg_comes_after_a_surfacing():
    following = figures.next_surfacing(held())
    assert following.time_ns == END_NS + 4 * HOUR_NS
    assert following.margin_s == pytest.approx(0.2 * 14_400.0)
    on_time, late = following.time_ns + int(2879e9), following.time_ns + int(2881e9)
    assert "surfacing overdue" not in kinds(held(), on_time)
    assert "surfacing overdue" in kinds(held(), late)
    surfaced = held().outcomes[0]
    surfaced.planned_time.FromNanoseconds(END_NS)
    assert figures.next_surfacing(held(outcomes=[surfaced])).time_ns == END_NS + 8 * HOUR_NS
    assert figures.next_surfacing(held(outcomes=[surfaced, surfaced])) is None


def expected(next_ns):
    """The figures of one surfacing that was expected from the dives, and of the coming one."""
    ellipse = {"major_m": 464.0, "minor_m": 283.0, "bearing_deg": 29.0}
    of_one = {
        "count": 1,
        "inside_50": 1.0,
        "inside_90": 1.0,
        "distance_median_m": 200.0,
        "radius_90_mean_m": 400.0,
        "log_score_gain": None,
        "radius_ratio": None,
    }
    each = [{"dive": 7, "earlier_dives": 6, "inside_90": True, "radius_90_m": 400.0}]
    coming = {"time_ns": next_ns, "expected": [5.2, 62.1], "ellipse_90": ellipse}
    return {"predicted_surfacings": {**of_one, "later": None, "each": each, "next": coming}}


def surfacing(given):
    status = status_of(given, END_NS)
    (line,) = (line for line in status.lines if line.key == "surfacing")
    return line.text, status.figures["surfacing"]


def test_one_next_surfacing_comes_first_the_plans_while_one_is_flown_and_else_the_last_dives():
    summary = expected(END_NS + HOUR_NS)
    text, numbers = surfacing(held(outcome=outcome_from(summary)))
    when = "2023-11-17 02:13:20Z (in 4.0 h; overdue after 48 min more)"
    assert text[0] == f"next, by the plan: {when}"
    assert (numbers["next"]["basis"], numbers["next"]["time"]) == ("plan", "2023-11-17 02:13:20Z")
    assert sum("next" in sentence for sentence in text) == 1
    text, numbers = surfacing(held(outcome=outcome_from(summary), plans=[], outcomes=[]))
    assert text[0] == (
        "next, from the last dive, as no plan is being flown: 2023-11-16 23:13:20Z (in 60 min), 5.2000 E, 62.1000 N, 90 % within "
        "464 x 283 m along 29 degrees"
    )
    assert numbers["next"] == {
        "basis": "last_dive",
        "time": "2023-11-16 23:13:20Z",
        "longitude": 5.2,
        "latitude": 62.1,
        "major_m": 464.0,
        "minor_m": 283.0,
        "bearing_deg": 29.0,
    }
    assert sum("next" in sentence for sentence in text) == 1
    # the habit is shown where it has predicted better, and says so
    found = outcome_from(summary)
    record = {"shown": "habit", "count": 3, "habit": -20.0, "plan": -26.0}
    by_habit = replace(found, predicted_surfacings={**found.predicted_surfacings, "record": record})
    text, numbers = surfacing(held(outcome=by_habit))
    assert numbers["next"]["basis"] == "last_dive"
    assert "as the dives before predicted better: " in text[0]
    over = held().outcomes[0]
    over.planned_time.FromNanoseconds(END_NS)
    text, _ = surfacing(held(outcome=outcome_from(summary), outcomes=[over, over]))
    assert text[0].startswith("next, from the last dive, as the plan has no surfacing ahead: ")
    assert (
        "(60 min ago)"
        in surfacing(held(outcome=outcome_from(expected(END_NS - HOUR_NS)), plans=[], outcomes=[]))[
            0
        ][0]
    )
    assert surfacing(held(outcomes=[over, over]))[0][0] == "the plan has no surfacing ahead"


def test_a_surfacing_is_not_overdue_while_the_dives_flown_would_go_on():
    def flown(hours):
        return held(metadata={AS_FLOWN: AsFlown(0.2, 20.0, 500.0, 3600.0 * hours, 5).to_record()})

    # the plan's leg takes four hours
    planned, longer = (figures.next_surfacing(flown(hours)) for hours in (2.0, 7.0))
    assert (planned.time_ns, planned.margin_s) == (
        END_NS + 4 * HOUR_NS,
        pytest.approx(0.2 * 4.0 * 3600.0),
    )
    assert (longer.time_ns, longer.margin_s) == (
        planned.time_ns,
        pytest.approx((3.0 + 0.2 * 7.0) * 3600.0),
    )
    # nor while the longest of them would have, of few by as much again
    for dives, margin in ((5, 6.0 - 4.0 + 0.2 * 6.0), (2, 6.0 - 4.0 + 6.0)):
        record = AsFlown(0.2, 20.0, 500.0, 7200.0, dives, longest=6 * 3600.0).to_record()
        assert figures.next_surfacing(held(metadata={AS_FLOWN: record})).margin_s == pytest.approx(
            3600.0 * margin
        )
    after = longer.time_ns + 4 * HOUR_NS
    assert "surfacing overdue" in kinds(flown(2.0), after)
    assert "surfacing overdue" not in kinds(flown(7.0), after)


def test_of_200_twin_dives_hardly_one_is_overdue_though_the_pilot_changes_their_depth():
    rng, alarms, planned = np.random.default_rng(0), 0, 4 * 3600.0
    for _ in range(10):
        depth, down, dives = rng.uniform(200.0, 600.0), rng.uniform(0.07, 0.15), []
        for _ in range(21):
            seconds = 2.0 * depth / (down * rng.lognormal(0.0, 0.1))
            if flown := AsFlown.of(dives):
                # the plan's leg of four hours is a dive as flown
                scale = planned / (2.0 * flown.depth / flown.vertical)
                lasted = {name: scale * getattr(flown, name) for name in ("duration", "longest")}
                record = {AS_FLOWN: replace(flown, **lasted).to_record()}
                margin = figures.next_surfacing(held(metadata=record)).margin_s
                alarms += scale * seconds > planned + margin
            dives.append(FlownDive(seconds, depth, 0.25, 2.0 * depth / seconds))
            depth = np.clip(depth * rng.lognormal(0.0, 0.2), 50.0, 1000.0)
    assert alarms <= 10


def test_a_plan_says_which_numbers_of_its_dives_were_not_stated():
    origin = "as flown: 0.21 m/s, 500 m, 57 degrees"
    said = plan(END_NS)
    assert "as flown" not in status_text(status_of(held(plans=[said])))
    said.statistics.add(name=ORIGIN, value=origin)
    status = status_of(held(plans=[said]))
    assert origin in status_text(status)
    assert status.figures["odds"]["dives"] == origin


def test_each_alarm_is_given_for_its_cause_alone():
    assert kinds(held()) == []
    outside = held().outcomes[0]
    outside.inside_ellipse = False
    assert kinds(held(outcomes=[outside])) == ["outside its ellipse"]
    finding = {
        "name": "headings",
        "evidence": "off by 90",
        "set": "check the mounting",
        "severity": "inconsistent",
    }
    assert kinds(held(outcome=Outcome(consistency=[finding]))) == ["consistency"]
    for status in ("unsafe", "uncertain", "failed", "unreachable", "reached", "partial"):
        assert kinds(held(plans=[plan(END_NS, status=status)])) == (
            [] if status in ("reached", "partial") else ["plan"]
        )
    assert kinds(held(plans=[]), END_NS + 60 * HOUR_NS) == ["forecast ended"]
    static = {
        "replay_kit.forecast": {
            "first": "2023-11-14T00:00:00Z",
            "last": "2023-11-14T00:00:00Z",
            "evolves": "false",
        }
    }
    assert kinds(held(plans=[], metadata=static), END_NS + 60 * HOUR_NS) == []


def test_a_change_of_the_command_is_told_with_its_reasons():
    (change,) = change_of(held())
    # the plan before would steer its second leg now
    assert "was 60°: 20° to the right" in change
    assert "3.5 km toward 270°" in change
    assert "the current differed 10 cm/s" in change
    moved = plan(
        END_NS, goal={"longitude": 6.0, "latitude": 62.0, "depth": 0.0}, status="uncertain"
    )
    (change,) = change_of(held(plans=[held().plans[0], moved]))
    assert "the goal moved 26.2 km" in change
    assert "was reached and is uncertain" in change
    quiet = held(
        plans=[plan(END_NS - HOUR_NS), plan(END_NS)],
        outcomes=[],
        dive=mean_current(END_NS, (0.01, 0.0), (0.0, 0.0), 0.02),
    )
    assert change_of(quiet) == ("unchanged since the plan before",)
    assert change_of(held(plans=held().plans[-1:])) == ()


def test_the_screen_is_80_columns_wide_and_says_how_old_each_answer_is():
    text = status_text(status_of(held(), END_NS + 3 * HOUR_NS))
    assert max(map(len, text.splitlines())) <= 80
    for label in (
        "Position",
        "Made good",
        "Current",
        "Surfacing",
        "Steer",
        "Odds",
        "Forecast",
        "Fit",
    ):
        assert (
            re.search(
                rf"^{label} +3.0 h |^{label} +\d+\.\d d |^{label} +\d+ h ", text, re.MULTILINE
            )
            or label == "Forecast"
        ), label
    assert "90 % (65 to 98) of 10 simulated flights arrive" in text
    assert "250 kJ of 1000 kJ" in text
    assert "± 20 m" in text
    assert [age_text(seconds) for seconds in (0.0, 120.0, 7200.0, -7200.0, 864_000.0)] == [
        "now",
        "2 min",
        "2.0 h",
        "in 2.0 h",
        "10.0 d",
    ]


def test_the_page_holds_the_same_answers_loads_itself_again_and_runs_nothing_of_a_log_s():
    status = status_of(
        held(
            name="<script>x</script>.mcap",
            plans=[plan(END_NS, status="unsafe", message="<b>crosses</b>")],
        )
    )
    page = status_page(status, 30)
    assert 'http-equiv="refresh"' not in page
    assert 'data-again="30"' in page
    assert page.count("<script") == 1
    script = page.partition("<script>")[2].partition("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page
    assert "&lt;b&gt;crosses&lt;/b&gt;" in page
    assert page.count("<section") == len(status.lines)
    assert '<section id="odds" class="alarm">' in page


def test_ten_lines_say_the_alarm_first_then_what_to_steer():
    unsafe = plan(END_NS, status="unsafe", message="crosses a shipping lane " * 9)
    text = brief_text(status_of(held(plans=[unsafe])))
    lines = text.splitlines()
    assert len(lines) <= 10
    assert max(map(len, lines)) <= 80
    assert lines[0].startswith("! PLAN: the plan is unsafe: crosses a shipping lane")
    assert lines[1] == "Steer      080° true, glide angle 20°, to 500 m, 0.30 m/s (as set)"
    assert "62° 00.0′ N, 5° 06.0′ E (5.1000 E, 62.0000 N)" in lines[2]
    many = {"name": "headings", "evidence": "off", "set": "check", "severity": "inconsistent"}
    four = brief_text(status_of(held(plans=[unsafe], outcome=Outcome(consistency=[many] * 3))))
    assert len(four.splitlines()) <= 11
    assert four.splitlines()[1] == "! and 3 more alarms; -v shows them"


def test_each_number_of_the_brief_status_is_a_figure_of_it_and_rounded_alike():
    status = status_of(held())
    page = status_page(status)
    shown = re.findall(r'<data data-key="([^"]*)" value="([^"]*)">([^<]*)</data>', page)
    assert len(shown) > 12
    for key, value, text in shown:
        path, _, derived = key.partition("#")
        found = status.figures
        for part in path.split("."):
            found = found[int(part)] if part.isdigit() else found[part]
        expected = np.hypot(found["east"], found["north"]) if derived else found
        assert json.loads(value) == pytest.approx(expected, rel=1e-12), key
        digits = re.match(r"[+-]?([\d,]+)(\.\d+)?", text)
        if digits and not text.endswith(("E", "N", "h", "days")):
            decimals = len(digits[2] or ".") - 1
            rounded = float(digits[0].replace(",", ""))
            each = [abs(rounded - factor * expected) for factor in (1.0, 100.0, 1e-3)]
            assert min(each) <= 0.50001 * 10.0**-decimals, (key, text)


def test_figures_are_numbers_for_json():
    figures_held = status_of(held()).figures
    assert figures_held["position"]["error_m"] == 20.0
    assert figures_held["odds"]["reached"] == 0.9
    assert figures_held["surfacing"]["next"]["major_m"] == 2000.0
    assert (
        status_of(held(plans=[], fixes=[], dive=None, outcomes=[], outcome=None)).figures["alarms"]
        == []
    )


def test_nothing_heavy_is_loaded_and_a_file_that_is_no_result_is_refused():
    line, heavy = f"status {SAMPLES}/glider.mcap", "xarray pandas casadi h5py foxglove rich"
    assert not loaded(line).intersection([*heavy.split(), "scipy", "matplotlib"])
    done = invoke(line)
    assert done.exit_code == 3
    assert "no result of replay-kit replay" in done.stderr


@pytest.mark.parametrize(
    ("reached", "interval"), [(0.9, (0.652, 0.977)), (1.0, (0.787, 1.0)), (0.0, (0.0, 0.213))]
)
def test_odds_of_all_or_none_are_not_told_as_certain(reached, interval):
    """Of ten samples, by the formula of Wilson."""
    made = plan(END_NS)
    made.odds.reached = reached
    found = status_of(held(plans=[made])).figures["odds"]
    assert found["reached_interval"] == pytest.approx(interval, abs=5e-4)
