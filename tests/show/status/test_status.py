"""A result on one screen: each answer against what was put in, and what wakes a person."""

import base64
import hashlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from pyproj import Geod

from replay_kit.core.as_flown import AS_FLOWN, AsFlown
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Source, VehicleState
from replay_kit.core.plan import ORIGIN, Odds, Place
from replay_kit.core.text import time_text
from replay_kit.results import ResultWriter
from replay_kit.results.outcome.outcome import Outcome, outcome_from
from replay_kit.results.reader import ResultReader
from replay_kit.show.status.held import Fix, course, read_held
from replay_kit.show.status.lines import WIDTH, detail_lines, fitting, lines, title
from replay_kit.show.status.page import status_page
from replay_kit.show.status.status import status_of
from tests.cli.test_cli_settings import loaded
from tests.command import invoke
from tests.places import SAMPLES
from tests.show.status.held_samples import HOUR_NS, START_NS, held, mean_current, plan

RMS = {"before": 0.09, "after": 0.08, "prior": 0.1}
END_NS = START_NS + 48 * HOUR_NS


def text_of(status):
    """All that a status says, of which lines may be broken."""
    return " ".join(" ".join([*map(str, lines(status)), *detail_lines(status)]).split())


def answer(key, now_ns=None, **values):
    return status_of(held(**values), now_ns).figures.get(key, {})


def kinds(values, now_ns=END_NS):
    return [alarm.kind for alarm in status_of(values, now_ns).alarms]


def test_what_is_made_good_is_how_much_nearer_the_goal_came_a_day():
    day, mission = answer("goal")["made_good"]
    geod = Geod(ellps="WGS84")
    begin, before, end = (
        geod.inv(longitude, 62.0, 5.5, 62.0)[2] / 1e3 for longitude in (4.65, 4.9, 5.0)
    )
    assert day["days"] == pytest.approx(25.0 / 24.0)
    assert day["km_a_day"] == pytest.approx((before - end) / day["days"])
    error = 0.02 * 2.0**0.5 / 2.0
    assert mission == pytest.approx({"days": 2.0, "km_a_day": (begin - end) / 2.0, "error": error})


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
    assert answer("goal", plans=[]) == {}
    assert answer("goal", fixes=held().fixes[-1:])["made_good"] == []


def test_the_current_of_the_last_dive_stands_beside_the_estimate_s():
    found = answer("current")
    assert course(found["measured"])[1] == pytest.approx(90.0, abs=0.1)
    assert found["difference_m_s"] == pytest.approx(0.1)
    assert found["predicted_difference_m_s"] == pytest.approx(0.02)
    assert "corrected" not in found
    assert answer("current", dive=None) == {}


def test_what_was_measured_stands_before_what_the_correction_made_of_it():
    errors = {"mean_std": 0.01, "corrected_std": 0.02}
    one = mean_current(END_NS, (0.1, 0.0), (0.0, 0.0), 0.02, (0.0, 0.05), **errors)
    status = status_of(held(dive=one))
    assert "measured 10.0 cm/s to 090° ± 1.0 cm/s" in text_of(status)
    assert "corrected 5.0 cm/s to 000° ± 2.0 cm/s" in text_of(status)
    assert "dive 7: 5.0 cm/s to 000° corrected, 5.0 from the estimate" in text_of(status)
    assert status.figures["current"]["measured"]["standard_error"] == 0.01


def test_a_surfacing_is_overdue_by_a_share_of_its_leg_and_the_next_leg_comes_after_a_surfacing():
    following, due = answer("surfacing")["next"], END_NS + 4 * HOUR_NS
    assert following["time"] == time_text(due)
    assert following["margin_s"] == pytest.approx(0.2 * 14_400.0)
    on_time, late = due + int(2879e9), due + int(2881e9)
    assert "surfacing overdue" not in kinds(held(), on_time)
    assert "surfacing overdue" in kinds(held(), late)
    surfaced = held().outcomes[0]
    surfaced.planned_time.FromNanoseconds(END_NS)
    second = answer("surfacing", outcomes=[surfaced])["next"]
    assert second["time"] == time_text(END_NS + 8 * HOUR_NS)
    assert "next" not in answer("surfacing", outcomes=[surfaced, surfaced])


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
    each = [
        {"dive": 7, "earlier_dives": 6, "inside_90": True, "radius_90_m": 400.0}
        | {"time_ns": START_NS, "ellipse_90": ellipse, "distance_m": 200.0, "direction_deg": 90.0}
    ]
    coming = {"time_ns": next_ns, "expected": [5.2, 62.1], "ellipse_90": ellipse}
    return {"predicted_surfacings": {**of_one, "later": None, "each": each, "next": coming}}


def surfacing(given):
    status = status_of(given, END_NS)
    said = [str(line.said) for line in lines(status) if line.label in ("Next", "  or")]
    return said, status.figures["surfacing"]


def test_both_next_surfacings_are_named_and_first_the_one_that_the_record_says_to_believe():
    found = outcome_from(expected(END_NS + HOUR_NS))
    by_plan = "62°00.0′N 5°06.0′E ± 2.0 km if it flies this plan"
    by_dive = "62°06.0′N 5°12.0′E ± 464 m as the last dive"
    said, numbers = surfacing(held(outcome=found))
    assert said == [f"17 Nov 02:13 UTC {by_plan}", f"16 Nov 23:13 {by_dive}"]
    assert (numbers["next"]["basis"], numbers["next"]["time"]) == ("plan", "2023-11-17 02:13:20Z")
    assert numbers["next"]["why"] == "no surfacing was predicted yet"
    assert numbers["other"] == {
        "basis": "last_dive",
        "time": "2023-11-16 23:13:20Z",
        "longitude": 5.2,
        "latitude": 62.1,
        "major_m": 464.0,
        "minor_m": 283.0,
        "bearing_deg": 29.0,
    }
    record = {"shown": "habit", "count": 3, "habit": -20.0, "plan": -26.0}
    by_habit = replace(found, predicted_surfacings={**found.predicted_surfacings, "record": record})
    said, numbers = surfacing(held(outcome=by_habit))
    assert said == [f"16 Nov 23:13 UTC {by_dive}", f"17 Nov 02:13 {by_plan}"]
    assert numbers["next"]["why"] == "past dives predicted 3 surfacings better"
    said, numbers = surfacing(held(outcome=found, plans=[], outcomes=[]))
    assert said == [f"16 Nov 23:13 UTC {by_dive}"]
    assert numbers["next"]["why"] == "no plan is flown"
    over = held().outcomes[0]
    over.planned_time.FromNanoseconds(END_NS)
    said, numbers = surfacing(held(outcome=found, outcomes=[over, over]))
    assert numbers["next"]["why"] == "the plan has no surfacing left"
    assert surfacing(held(outcomes=[over, over]))[0] == []


def test_a_surfacing_is_not_overdue_while_the_dives_flown_would_go_on():
    def flown(*dives, **more):
        record = AsFlown(0.2, 20.0, 500.0, *dives, **more).to_record()
        return held(metadata={AS_FLOWN: record})

    # the plan's leg takes four hours, and is not late while the longest dive before, of few by as much again, would go on
    due, hour = END_NS + 4 * HOUR_NS, 3600.0
    for values, margin in (
        (flown(2.0 * hour, 5), 0.2 * 4.0),
        (flown(7.0 * hour, 5), 3.0 + 0.2 * 7.0),
        (flown(2.0 * hour, 5, longest=6 * hour), 6.0 - 4.0 + 0.2 * 6.0),
        (flown(2.0 * hour, 2, longest=6 * hour), 6.0 - 4.0 + 6.0),
    ):
        following = status_of(values).figures["surfacing"]["next"]
        assert following["time"] == time_text(due)
        assert following["margin_s"] == pytest.approx(hour * margin)
        late = due + int(margin * HOUR_NS)
        assert "surfacing overdue" not in kinds(values, late - HOUR_NS // 10)
        assert "surfacing overdue" in kinds(values, late + HOUR_NS // 10)


def test_a_plan_says_which_numbers_of_its_dives_were_not_stated():
    origin = "as flown: 0.21 m/s, 500 m, 57 degrees"
    said = plan(END_NS)
    assert "as flown" not in text_of(status_of(held(plans=[said])))
    status = status_of(held(plans=[replace(said, statistics={ORIGIN: origin})]))
    assert origin in text_of(status)
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
    (change,) = status_of(held()).figures["command"]["why"]
    # the plan before would steer its second leg now
    assert "was 60°: 20° to the right" in change
    assert "it surfaced 3.5 km from the plan toward 270°, 10 min late" in change
    assert "the current differed by 10 cm/s" in change
    moved = plan(END_NS, goal=Place(6.0, 62.0, 0.0), status="uncertain")
    (change,) = status_of(held(plans=[held().plans[0], moved])).figures["command"]["why"]
    assert "the goal moved 26.2 km" in change
    quiet = held(
        plans=[plan(END_NS - HOUR_NS), plan(END_NS)],
        outcomes=[],
        dive=mean_current(END_NS, (0.01, 0.0), (0.0, 0.0), 0.02),
    )
    assert status_of(quiet).figures["command"]["why"] == [
        "heading unchanged since the previous plan"
    ]
    assert status_of(held(plans=held().plans[-1:])).figures["command"]["why"] == []


def test_what_the_summary_leaves_out_is_told_on_80_columns():
    status = status_of(held(), END_NS + 3 * HOUR_NS)
    assert max(map(len, detail_lines(status))) <= WIDTH
    text = text_of(status)
    for said in ("energy 250 kJ of 1000 kJ", "± 20 m", "ENDED", "surfaced 3.5 km from the plan"):
        assert (said in text) == (said != "ENDED"), said
    assert "ENDED" in text_of(status_of(held(), END_NS + 60 * HOUR_NS))
    assert title(status) == "r, dive 7: fix 62°00.0′N 5°00.0′E 16 Nov 22:13 UTC, 3.0 h ago"


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
    assert page.count("<section") == 7


def test_ten_lines_say_first_how_far_to_trust_and_then_what_to_steer():
    unsafe = plan(END_NS, status="unsafe", message="crosses a shipping lane " * 9)
    many = {"name": "headings", "evidence": "off", "set": "check", "severity": "inconsistent"}
    found = outcome_from(expected(END_NS + HOUR_NS) | {"rms_innovation": RMS})
    for outcome in (found, replace(found, consistency=[many] * 3)):
        said = [title(status_of(held(plans=[unsafe])))]
        said += map(str, lines(status_of(held(plans=[unsafe], outcome=outcome))))
        assert len(said) <= 10
        assert max(map(len, said)) <= WIDTH
    assert said[1].startswith("DO NOT USE headings: off; headings: off;")
    steer = "Steer      080° true to 62°00.0′N 5°06.0′E, 500 m, 20°, 0.30 m/s (as set)"
    assert said[2] == steer


def test_a_heading_is_true_and_by_the_compass_of_a_vehicle_whose_declination_is_known():
    flown = AsFlown(0.3, 20.0, 500.0, 14_400.0, 5, declination=-100.0)
    status = status_of(held(plans=[plan(END_NS)], metadata={AS_FLOWN: flown.to_record()}))
    assert status.figures["command"]["magnetic_heading_deg"] == 180.0
    (steer,) = (str(line) for line in lines(status) if line.label == "Steer")
    assert "080° true, 180° magnetic to 62°" in steer
    assert len(steer) <= WIDTH


def test_the_first_line_counts_the_flights_that_arrive_and_that_must():
    made = plan(END_NS, statistics={"arrive": "0.85"})
    used = Outcome(observations={**Outcome().observations, "used": 9})
    said = str(lines(status_of(held(plans=[made], outcome=used)))[0])
    assert said == "TRUST      9 of 10 simulated flights arrive (9 required)"


def test_a_line_holds_as_many_reasons_as_fit_and_says_how_many_are_left():
    assert fitting(["one", "two"], 20) == "one; two"
    assert fitting(["a long reason", "another reason"], 26) == "a long reason; 1 more: -v"
    assert fitting(["word " * 9, "b"], 30) == "word word word; 1 more: -v"


def test_a_current_that_the_gate_rejected_is_shown_as_measured_and_rings_once():
    one = mean_current(END_NS, (0.1, 0.0), (0.0, 0.0), 0.02)
    refused = held(dive={**one, "accepted": np.zeros(1, np.bool_)})
    assert kinds(refused) == ["current rejected"]
    assert "dive 7: 10.0 cm/s to 090°, rejected, 10.0 from the estimate" in text_of(
        status_of(refused)
    )
    assert kinds(held()) == []


def test_the_ellipse_that_was_shown_first_is_judged_by_the_surfacing():
    found = outcome_from(expected(END_NS + HOUR_NS))
    record = {"shown": "habit", "count": 3, "habit": -20.0, "plan": -26.0}
    missed = {**found.predicted_surfacings["each"][-1], "inside_90": False, "time_ns": END_NS}
    missed |= {"distance_m": 4400.0, "direction_deg": 200.0}
    missed["ellipse_90"] = {"major_m": 1300.0, "minor_m": 1000.0, "bearing_deg": 0.0}
    for shown, rung in (("habit", ["outside its ellipse"]), ("plan", [])):
        of = {"record": {**record, "shown": shown}, "each": [missed]}
        outcome = replace(found, predicted_surfacings={**found.predicted_surfacings, **of})
        assert kinds(held(outcome=outcome)) == rung
    (alarm,) = status_of(
        held(
            outcome=replace(
                outcome, predicted_surfacings={**outcome.predicted_surfacings, "record": record}
            )
        ),
        END_NS,
    ).alarms
    assert alarm.text == (
        "surfaced 4.4 km from the prediction toward 200°, outside its 90 % ellipse (1.3 km): plan again from here"
    )


def test_each_number_of_the_brief_status_is_a_figure_of_it_and_rounded_alike():
    status = status_of(held())
    page = status_page(status)
    shown = re.findall(r'<data data-key="([^"]*)" value="([^"]*)">([^<]*)</data>', page)
    assert len(shown) > 11
    for key, value, text in shown:
        expected = status.figures
        for part in key.split("."):
            expected = expected[int(part) if part.isdigit() else part]
        assert json.loads(value) == pytest.approx(expected, rel=1e-12), key
        digits = re.match(r"[+-]?([\d,]+)(\.\d+)?", text)
        if digits and not text.endswith(("E", "N", "h", "days")):
            decimals = len(digits[2] or ".") - 1
            rounded = float(digits[0].replace(",", ""))
            each = [abs(rounded - factor * abs(expected)) for factor in (1.0, 100.0, 1e-3)]
            assert min(each) <= 0.50001 * 10.0**-decimals, (key, text)


def test_of_nothing_there_is_no_alarm():
    assert answer("alarms", plans=[], fixes=[], dive=None, outcomes=[], outcome=None) == []


def test_nothing_heavy_is_loaded_and_a_file_that_is_no_result_is_refused():
    line, heavy = f"status {SAMPLES}/glider.mcap", "xarray pandas casadi h5py foxglove rich"
    assert not loaded(line).intersection([*heavy.split(), "scipy", "matplotlib"])
    done = invoke(line)
    assert done.exit_code == 3
    assert "no result of replay-kit" in done.stderr


@pytest.mark.parametrize(
    ("reached", "interval"), [(0.9, (0.652, 0.977)), (1.0, (0.787, 1.0)), (0.0, (0.0, 0.213))]
)
def test_odds_of_all_or_none_are_not_told_as_certain(reached, interval):
    """Of ten samples, by the formula of Wilson."""
    made = plan(END_NS, odds=Odds(10, reached, 1.0, 250.0, 9e4, 7e4, 8e4))
    found = status_of(held(plans=[made])).figures["odds"]
    assert found["reached_interval"] == pytest.approx(interval, abs=5e-4)
