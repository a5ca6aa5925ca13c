"""A result on one screen: each answer against what was put in, and what wakes a person."""

import base64
import hashlib
from dataclasses import replace

import numpy as np
import pytest
from pyproj import Geod

from replay_kit.core.as_flown import AS_FLOWN, AsFlown
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Source, VehicleState
from replay_kit.core.plan import ORIGIN, Place
from replay_kit.core.words.text import time_text
from replay_kit.results import ResultWriter
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.reader import ResultReader
from replay_kit.show.status.held import Fix, read_held
from replay_kit.show.status.lines import WIDTH, detail_lines, lines, status_page, title
from replay_kit.show.status.status import status_of
from tests.cli.test_cli_settings import loaded
from tests.command import invoke
from tests.places import SAMPLES
from tests.show.status.held_samples import HOUR_NS, START_NS, held, mean_current, outcome, plan

END_NS = START_NS + 48 * HOUR_NS
# of one surfacing that was expected from the dives, and the coming one
ELLIPSE = {"major_m": 464.0, "minor_m": 283.0, "bearing_deg": 29.0}
PAST = {"time_ns": START_NS, "ellipse_90": ELLIPSE, "inside_90": True, "distance_m": 200.0}
PAST |= {"direction_deg": 90.0}
COMING = {"time_ns": END_NS + HOUR_NS, "expected": [5.2, 62.1], "ellipse_90": ELLIPSE}
EXPECTED = {"inside_50": 1.0, "inside_90": 1.0, "count": 1, "each": [PAST], "next": COMING}
HABIT = {"record": {"shown": "habit", "count": 3, "habit": -20.0, "plan": -26.0}}


def text_of(status):
    """All that a status says, of which lines may be broken."""
    return " ".join(" ".join([*map(str, lines(status)), *detail_lines(status)]).split())


def answer(key, **values):
    return status_of(held(**values)).figures.get(key, {})


def kinds(now_ns=END_NS, **values):
    return [alarm.kind for alarm in status_of(held(**values), now_ns).alarms]


def expected(**more):
    return Outcome(predicted_surfacings=EXPECTED | more)


def test_what_is_made_good_is_how_much_nearer_the_goal_came_a_day():
    day, mission = answer("goal")["made_good"]
    begin, before, end = (
        Geod(ellps="WGS84").inv(longitude, 62.0, 5.5, 62.0)[2] / 1e3
        for longitude in (4.65, 4.9, 5.0)
    )
    assert day["days"] == pytest.approx(25.0 / 24.0)
    assert day["km_a_day"] == pytest.approx((before - end) / day["days"])
    error = 0.02 * 2.0**0.5 / 2.0
    assert mission == pytest.approx({"days": 2.0, "km_a_day": (begin - end) / 2.0, "error": error})
    assert answer("goal", fixes=held().fixes[-1:])["made_good"] == []


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
                at = fix.time_ns, fix.longitude, fix.latitude, 0.0, fix.reckoned
                writer.fix(VehicleState(*at, Source(0, "/", 0, 0)))
        found = read_held(ResultReader(tmp_path / "r.mcap"))
        return found.fixes, found.reckoned

    measured = [fix for fix in said if not fix.reckoned]
    day_before = [fix for fix in measured if measured[-1].time_ns - fix.time_ns >= 24 * HOUR_NS]
    reckoned = said[-1] if said[-1].reckoned and said[-1].time_ns > measured[-1].time_ns else None
    assert positions(said) == ([measured[0], *day_before[-1:], measured[-1]], reckoned)
    alone = [fix._replace(reckoned=True) for fix in said]
    assert positions(alone) == ([], alone[-1])


def test_the_current_of_the_last_dive_is_told_as_measured_corrected_and_against_the_estimate():
    found = answer("current")
    assert found["difference_m_s"] == pytest.approx(0.1)
    assert found["predicted_difference_m_s"] == pytest.approx(0.02)
    errors = {"mean_std": 0.01, "corrected_std": 0.02}
    one = mean_current(END_NS, (0.1, 0.0), (0.0, 0.0), 0.02, (0.0, 0.05), **errors)
    said = text_of(status_of(held(dive=one)))
    for words in (
        "measured 10.0 cm/s to 090° ± 1.0 cm/s",
        "corrected 5.0 cm/s to 000° ± 2.0 cm/s",
        "dive 7: 5.0 cm/s to 000° corrected, 5.0 from the estimate",
    ):
        assert words in said
    refused = {**held().dive, "accepted": np.zeros(1, np.bool_)}
    assert kinds(dive=refused) == ["current rejected"]


def surfacing(**values):
    status = status_of(held(**values), END_NS)
    said = [str(line.said) for line in lines(status) if line.label in ("Next", "  or")]
    return said, status.figures["surfacing"].get("next", {}).get("why")


def test_both_next_surfacings_are_named_and_first_the_one_that_the_record_says_to_believe():
    by_plan = "62°00.0′N 5°06.0′E ± 2.0 km if it flies this plan"
    by_dive = "62°06.0′N 5°12.0′E ± 464 m as the last dive"
    plan_first = [f"17 Nov 02:13 UTC {by_plan}", f"16 Nov 23:13 {by_dive}"]
    dive_first = [f"16 Nov 23:13 UTC {by_dive}", f"17 Nov 02:13 {by_plan}"]
    over, later = [outcome(END_NS, END_NS)] * 2, Fix(COMING["time_ns"] + 1, 5.0, 62.0, False)
    for values, said, why in (
        ({"outcome": expected()}, plan_first, "no surfacing was predicted yet"),
        ({"outcome": expected(**HABIT)}, dive_first, "past dives predicted 3 surfacings better"),
        ({"outcome": expected(), "plans": [], "outcomes": []}, dive_first[:1], "no plan is flown"),
        (
            {"outcome": expected(), "outcomes": over},
            dive_first[:1],
            "the plan has no surfacing left",
        ),
        ({"outcomes": over}, [], None),
        ({"outcome": expected(), "outcomes": over, "fixes": [later]}, [], None),
    ):
        assert surfacing(**values) == (said, why)


def test_a_surfacing_is_not_overdue_while_the_dives_flown_would_go_on():
    def flown(*dives, **more):
        return {"metadata": {AS_FLOWN: AsFlown(0.2, 20.0, 500.0, *dives, **more).to_record()}}

    # the plan's leg takes four hours, and is not late while the longest dive before, of few by as much again, would go on
    due, hour = END_NS + 4 * HOUR_NS, 3600.0
    for values, margin in (
        ({}, 0.2 * 4.0),
        (flown(7.0 * hour, 5), 3.0 + 0.2 * 7.0),
        (flown(2.0 * hour, 5, longest=6 * hour), 6.0 - 4.0 + 0.2 * 6.0),
        (flown(2.0 * hour, 2, longest=6 * hour), 6.0 - 4.0 + 6.0),
    ):
        following = answer("surfacing", **values)["next"]
        assert following["time"] == time_text(due)
        assert following["margin_s"] == pytest.approx(hour * margin)
        late = due + int(margin * HOUR_NS)
        assert "surfacing overdue" not in kinds(late - HOUR_NS // 10, **values)
        assert "surfacing overdue" in kinds(late + HOUR_NS // 10, **values)


def test_each_alarm_is_given_for_its_cause_alone():
    assert kinds() == kinds(plans=[], fixes=[], dive=None, outcomes=[], outcome=None) == []
    outside = [outcome(END_NS, END_NS - 4 * HOUR_NS, inside=False)]
    assert kinds(outcomes=outside) == ["outside its ellipse"]
    finding = {"name": "headings", "evidence": "off", "set": "check", "severity": "inconsistent"}
    assert kinds(outcome=Outcome(consistency=[finding])) == ["consistency"]
    late = END_NS + 60 * HOUR_NS
    assert kinds(late, plans=[]) == ["forecast ended"]
    static = held().metadata["replay_kit.forecast"] | {"evolves": "false"}
    assert kinds(late, plans=[], metadata={"replay_kit.forecast": static}) == []


def test_the_ellipse_that_was_shown_first_is_judged_by_the_surfacing():
    missed = {"inside_90": False, "time_ns": END_NS, "distance_m": 4400.0, "direction_deg": 200.0}
    each = {"each": [PAST | missed | {"ellipse_90": ELLIPSE | {"major_m": 1300.0}}]}
    assert kinds(outcome=expected(**each)) == []
    (alarm,) = status_of(held(outcome=expected(**each, **HABIT)), END_NS).alarms
    assert alarm.text == (
        "surfaced 4.4 km from the prediction toward 200°, outside its 90 % ellipse (1.3 km): plan again from here"
    )


def test_a_change_of_the_command_is_told_with_its_reasons():
    def why(**values):
        return answer("command", **values)["why"]

    (change,) = why()
    # the plan before would steer its second leg now
    assert "was 60°: 20° to the right" in change
    moved = plan(END_NS, goal=Place(6.0, 62.0, 0.0), status="uncertain")
    assert "the goal moved 26.2 km" in why(plans=[held().plans[0], moved])[0]
    small = mean_current(END_NS, (0.01, 0.0), (0.0, 0.0), 0.02)
    plans = [plan(END_NS - HOUR_NS), plan(END_NS)]
    unchanged = ["heading unchanged since the previous plan"]
    assert why(plans=plans, outcomes=[], dive=small) == unchanged


def test_what_the_summary_leaves_out_is_told_on_80_columns():
    origin = {ORIGIN: "as flown: 0.21 m/s, 500 m, 57 degrees"}
    status = status_of(held(plans=[plan(END_NS, statistics=origin)]), END_NS + 3 * HOUR_NS)
    assert max(map(len, detail_lines(status))) <= WIDTH
    text = text_of(status)
    for said in (
        "energy 250 kJ of 1000 kJ",
        "90 % ellipse 2.00 x 0.50 km along 30°",
        origin[ORIGIN],
    ):
        assert said in text, said
    assert "ENDED" in text_of(status_of(held(), END_NS + 60 * HOUR_NS))


def test_the_page_holds_the_same_answers_loads_itself_again_and_runs_nothing_of_a_log_s():
    unsafe = plan(END_NS, status="unsafe", message="<b>crosses</b>")
    page = status_page(status_of(held(name="<script>x</script>.mcap", plans=[unsafe])), 30)
    assert 'data-again="30"' in page
    assert page.count("<script") == 1
    script = page.partition("<script>")[2].partition("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page
    assert "&lt;b&gt;crosses&lt;/b&gt;" in page


def test_ten_lines_say_first_how_far_to_trust_and_then_what_to_steer():
    unsafe = plan(END_NS, status="unsafe", message="crosses a shipping lane " * 9)
    many = {"name": "headings", "evidence": "off", "set": "check", "severity": "inconsistent"}
    rms = dict.fromkeys(("before", "after", "prior"), 0.1)
    found = replace(expected(), rms_innovation=rms, plan={"status": "unsafe", "message": ""})
    for outcome_, first in (
        (found, "DO NOT USE no observation was used; the plan is unsafe"),
        (replace(found, consistency=[many] * 3), "DO NOT USE headings: off; headings: off;"),
    ):
        said = [title(status_of(held(plans=[unsafe])))]
        said += map(str, lines(status_of(held(plans=[unsafe], outcome=outcome_))))
        assert len(said) <= 10
        assert max(map(len, said)) <= WIDTH
        assert said[1].startswith(first)
    steer = "Steer      080° true to 62°00.0′N 5°06.0′E, 500 m, 20°, 0.30 m/s (as set)"
    assert said[2] == steer
    made = plan(END_NS, statistics={"arrive": "0.85"})
    used = Outcome(observations={**Outcome().observations, "used": 9})
    first, *_ = lines(status_of(held(plans=[made], outcome=used)))
    assert str(first) == "TRUST      9 of 10 simulated flights arrive (9 required)"


def test_reasons_are_cut_at_clauses_counted_without_odds_and_whole_on_a_page():
    clause = "the forecast is of 2018-11-16T00:00Z, 1974.8 days before the log begins"
    texts = (clause, "the ensemble was moved: not a forecast for this region")
    used = {**Outcome().observations, "used": 9}
    status = status_of(
        held(plans=[plan(END_NS)], outcome=Outcome(observations=used, outside=texts))
    )
    first, *_ = lines(status)
    assert str(first.said) == "the forecast is of 2018-11-16T00:00Z ...; 1 more: -v"
    assert all(text in status_page(status) for text in texts)
    assert "-v" not in status_page(status).partition("<dl>")[2].partition("</dl>")[0]
    unsafe = plan(END_NS, status="unsafe", odds=None)
    found = Outcome(observations=used, plan={"status": "unsafe", "message": ""})
    first, *_ = lines(status_of(held(plans=[unsafe], outcome=found)))
    assert str(first.said) == "the plan is unsafe"


def test_titles_keep_whole_words_and_name_one_of_several_vehicles():
    def titled(mission, **more):
        found = held(outcome=Outcome(mission=mission))
        return title(status_of(found, END_NS + 960 * 24 * HOUR_NS, **more))

    assert titled("SG249 mission 2").startswith("SG249 mission 2, dive 7: ")
    assert titled("SG249 from Nova Scotia to Cape Race").startswith("SG249 from Nova ..., dive 7: ")
    assert len(titled("SG249 mission 2")) <= WIDTH
    assert titled("SG249 mission 2", vehicle="sgA").startswith("sgA, dive 7: ")


def test_each_reason_for_excluded_bins_has_its_own_count():
    why = {"at_surface": 84, "below_grid": 3000, "missing": 2526}
    counts = {"used": 424, "bins_used": 3190, "bins_rejected": why}
    status = status_of(held(outcome=Outcome(observations={**Outcome().observations, **counts})))
    for room, text in (
        (100, "3,000 below grid, 2,526 missing, 84 at surface"),
        (69, "3,000 below grid, ..."),
        (60, "5,610 not used"),
    ):
        *_, data = lines(status, room)
        assert str(data.said) == f"424 of 424 observations used; of 8,800 bins {text}"


def test_a_heading_is_true_and_by_the_compass_of_a_vehicle_whose_declination_is_known():
    flown = AsFlown(0.3, 20.0, 500.0, 14_400.0, 5, declination=-100.0)
    status = status_of(held(plans=[plan(END_NS)], metadata={AS_FLOWN: flown.to_record()}))
    assert status.figures["command"]["magnetic_heading_deg"] == 180.0
    (steer,) = (str(line) for line in lines(status) if line.label == "Steer")
    assert "080° true, 180° magnetic to 62°" in steer
    assert len(steer) <= WIDTH


def test_nothing_heavy_is_loaded_and_a_file_that_is_no_result_is_refused():
    line, heavy = f"status {SAMPLES}/glider.mcap", "xarray pandas casadi h5py foxglove rich"
    assert not loaded(line).intersection([*heavy.split(), "scipy", "matplotlib"])
    done = invoke(line)
    assert done.exit_code == 3
    assert "no result of replay-kit" in done.stderr
