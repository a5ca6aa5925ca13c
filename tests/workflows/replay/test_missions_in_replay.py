"""Missions planned in a replay: when, what is kept of each plan, and that the result is made again bit for bit."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import replay_kit as rk
from planners import plan_mission
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import EstimatorConfig, OutputConfig, RunConfig, load_config
from replay_kit.core.as_flown import AS_FLOWN, AsFlown
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import distance, to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Source, VehicleState
from replay_kit.core.plan import Place
from replay_kit.core.surfacing import Ellipse, Surfacing, surfacing_outcome
from replay_kit.estimator import embed_member
from replay_kit.measurements.track.surfacings import SurfacingState, detect_surfacing
from replay_kit.results.reader import ResultReader
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.map import Chosen, plan_figure
from replay_kit.show.notebook import read_result
from replay_kit.show.status.held import read_held
from replay_kit.show.status.lines import detail_lines
from replay_kit.show.status.status import status_of
from replay_kit.workflows.planning.adapters import MissionPlanner, planner_of, span_of
from replay_kit.workflows.replay.inputs.provenance import run_settings_toml
from replay_kit.workflows.replay.stages.planner import PlanQuery
from replay_kit.workflows.verify import verify
from tests import synthetic
from tests.command import invoke, succeed
from tests.results import result_samples
from tests.synthetic_flow import constant, growing
from tests.workflows.replay.given import position
from tests.workflows.replay.interrupted import QUICK, goes_on, job_in, often, run_until

PLANNER = PlannerConfig(
    kind="mission", when="surfacing", depth=300.0, surface_time=240.0, samples=3, tolerance=500.0
)
CONFIG = RunConfig(
    estimator=QUICK,
    planner=PLANNER,
    output=OutputConfig(interval=7200.0),
)
GOAL = Place(152.42, -39.66, 0.0)


def run(ocean, out, config=CONFIG, goal=GOAL):
    return run_until(job_in(ocean, out, goal), config, None)[0]


@pytest.fixture(scope="module")
def replayed(ocean):
    """The result of a run, and its summary."""
    out = ocean / "out.mcap"
    return out, run(ocean, out)


def decoded(path, topic):
    return [message for _, message in result_samples.decoded(path, topic).get(topic, ())]


def ns(stamp) -> int:
    return stamp.ToNanoseconds()


def test_a_mission_is_planned_at_each_surfacing_and_kept_beside_what_then_happened(replayed):
    path, summary = replayed
    plans, outcomes, fixes = (
        decoded(path, topic) for topic in ("/plan/controls", "/plan/outcome", "/vehicle/fix")
    )
    depths = [(ns(fix.timestamp), -fix.altitude, fix) for fix in fixes]
    # the first fix not below the surface depth after each dive
    surfaced = [after for before, after in pairwise(depths) if before[1] > 3.0 >= after[1]]
    assert len(surfaced) >= 3
    times = [time for time, _, _ in surfaced]
    # four minutes adrift after each surfacing; one more plan at the log's end
    assert [ns(plan.timestamp) - 240 * 10**9 for plan in plans[:-1]] == times
    assert [ns(outcome.timestamp) for outcome in outcomes] == times[1:]
    for outcome, plan, (_, _, fix) in zip(outcomes, plans, surfaced[1:], strict=False):
        assert ns(outcome.planned_time) == ns(plan.timestamp)
        assert (outcome.actual.longitude, outcome.actual.latitude) == (fix.longitude, fix.latitude)
        away = distance(
            outcome.predicted.longitude, outcome.predicted.latitude, fix.longitude, fix.latitude
        )
        assert outcome.distance == pytest.approx(float(away), rel=1e-6)
        assert outcome.delay == pytest.approx(
            (ns(outcome.timestamp) - ns(outcome.predicted_time)) / 1e9
        )
        # the first leg in the plan ends after its drift
        leg = json.loads(next(item.value for item in plan.statistics if item.name == "leg_001"))
        reached = (ns(outcome.predicted_time) - ns(plan.timestamp)) / 1e9
        assert leg["surfacing_s"] - reached == pytest.approx(240.0, abs=1e-6)
        depth = np.interp(reached, plan.track_time, plan.track_depth)
        assert depth == pytest.approx(0.0, abs=1e-6)
        assert outcome.ellipse_major >= outcome.ellipse_minor > 0.0
    figures = summary.surfacings
    assert figures["count"] == len(outcomes) == len(figures["each"])
    assert figures["distance_median_m"] == pytest.approx(
        np.median([outcome.distance for outcome in outcomes])
    )
    assert figures["inside_ellipse"] == np.mean([outcome.inside_ellipse for outcome in outcomes])


def test_plans_are_for_a_vehicle_that_flies_as_its_dives_so_far_and_say_so(
    ocean, replayed, tmp_path
):
    """The twin glides at 0.3 m/s and 19 degrees to the last level, of 300 m; its depth is stated here, its speed is not."""
    path, words = replayed[0], "as flown: 0.30 m/s, 19 degrees"
    plans, held = decoded(path, "/plan/controls"), read_held(ResultReader(path))
    # the first one is made when the first dive has ended
    assert plans[0].message.endswith("; as flown in a single dive: 0.30 m/s, 19 degrees")
    assert all(plan.message.endswith(f"; {words}") for plan in plans[1:])
    legs = (one.value for plan in plans for one in plan.statistics if "leg_" in one.name)
    assert min(json.loads(leg)["glide_angle_deg"] for leg in legs) >= 19.0 - 0.01
    flown = AsFlown.in_metadata(held.metadata)
    assert (flown.speed, flown.glide_angle_deg, flown.depth, flown.dives) == (
        0.3,
        19.0,
        290.0,
        len(held.outcomes) + 1,
    )
    assert words in " ".join(" ".join(detail_lines(status_of(held))).split())
    contents = Contents(rk.open_result(path))
    assert f"Dives {words}." in plan_figure(contents, Chosen()).notes
    last = held.fixes[-1]
    places = f"--start={last.longitude},{last.latitude},0 --goal={GOAL.longitude},{GOAL.latitude},0"

    def said(more=""):
        return json.loads(succeed(f"plan {path} {places} --samples=0 --json - {more}").stdout)

    made, stated = said("--depth 280"), said("--speed 0.3 --depth 280 --angles 19,35")
    assert made["message"] == f"{stated['message']}; {words}"
    assert (made["legs"], made["statistics"]["dives"], "dives" in stated["statistics"]) == (
        stated["legs"],
        words,
        False,
    )
    # the dives went as deep, and so do those of a plan that states nothing, which begins at the last fix and leads to the run's goal
    whole = said()
    assert whole["message"].endswith("; as flown: 0.30 m/s, dives to 290 m, 1.6 h, 19 degrees")
    alone = json.loads(succeed(f"plan {path} --samples=0 --json -").stdout)
    assert alone["legs"] == whole["legs"]
    # a saved estimate knows its vehicle too
    record = json.dumps(AsFlown.in_metadata(held.metadata).to_record())
    flow = rk.open_result(path).estimate
    replace(flow, about={**flow.about, AS_FLOWN: record}).save(tmp_path / "flow.nc")
    saved = json.loads(succeed(f"plan {tmp_path}/flow.nc {places} --samples=0 --json -").stdout)
    assert saved["message"] == whole["message"]


def at(seconds: float, depth: float, reckoned: bool = False) -> VehicleState:
    return position(seconds, depth=depth, reckoned=reckoned)


def seen_in(events) -> list[float]:
    """Return the times [s] of the fixes at which surfacings were seen."""
    watch, found = SurfacingState(), []
    for event in events:
        watch, fix = detect_surfacing(watch, event, 3.0)
        if fix is not None:
            found.append(fix.time_ns / 1e9)
    return found


def test_a_surfacing_is_a_fix_after_a_dive_or_before_the_next_one():
    nan = float("nan")
    dives = [
        at(0, 0.0),
        at(10, 4.0),
        at(20, 0.0),
        at(30, 90.0),
        at(40, 1.0, True),
        at(50, 1.0),
    ]
    # 4 m is no dive, a computed position no fix
    assert seen_in([*dives, at(60, 0.0), at(70, 50.0), at(80, nan)]) == [
        50.0,
        80.0,
    ]
    grid = synthetic.ensemble().grid
    profiles = [
        synthetic.profile(
            grid, 0.0, 0.0, np.array([50.0]), np.zeros((1, 2)), time_ns=int(t * 1e9), dive=dive
        )
        for t, dive in ((15, 1), (20, 1), (45, 2), (75, 3))
    ]
    # positions without depths: the last before the next dive's first profile, and none where there is no position
    places = [at(t, nan) for t in (10, 30, 40)]
    assert seen_in([places[0], *profiles[:2], *places[1:], *profiles[2:]]) == [40.0]
    assert seen_in([at(t, 0.0) for t in range(5)]) == []


def test_an_outcome_says_how_far_and_which_way_the_surfacing_was():
    longitude, latitude = (
        float(value) for value in to_geographic(Projection(152.0, -40.0), -300.0, 400.0)
    )
    fix = VehicleState(90 * 10**9, longitude, latitude, 0.0, False, Source(0, "/fix", 0, 0))
    found = surfacing_outcome(0, Surfacing(100 * 10**9, 152.0, -40.0), fix)
    assert found.distance == pytest.approx(500.0)
    assert found.direction_deg == pytest.approx(360.0 - np.rad2deg(np.arctan2(3.0, 4.0)))
    assert (found.late, found.inside) == (-10.0, None)


@given(
    st.floats(10.0, 5e3),
    st.floats(0.1, 1.0),
    st.floats(0.0, 179.9),
    st.floats(0.0, 6.28),
    st.sampled_from([0.97, 1.03]),
)
def test_an_ellipse_holds_what_lies_inside(major, ratio, bearing, angle, share):
    minor, centre = ratio * major, Projection(152.0, -40.0)
    along, across = share * major * np.cos(angle), share * minor * np.sin(angle)
    turn = np.deg2rad(bearing)
    east, north = (
        along * np.sin(turn) + across * np.cos(turn),
        along * np.cos(turn) - across * np.sin(turn),
    )
    longitude, latitude = (float(value) for value in to_geographic(centre, east, north))
    assert Ellipse(152.0, -40.0, major, minor, bearing).holds(longitude, latitude) == (share < 1.0)


def test_settings_that_contradict_each_other_are_refused(tmp_path, ocean):
    path = tmp_path / "run.toml"
    for text, said in (
        ("min_angle = 40.0", "min_angle 40 is above max_angle 35"),
        ("samples = 2", "needs three or more"),
    ):
        path.write_text(f"[planner]\n{text}\n")
        with pytest.raises(ConfigError, match=said):
            load_config(path)
    # asked for on the command line; a glide has no dives that could be too deep
    path.write_text(
        run_settings_toml(CONFIG.model_copy(update={"planner": PlannerConfig(depth=900.0)}))
    )
    files = f"{ocean}/glider.mcap --ensemble {ocean}/ensemble.nc -o {tmp_path}/out.mcap"
    done = invoke(f"replay {files} --config {path} --goal=152.42,-39.66,0 --planner mission")
    assert "[planner] depth is 900 m" in str(done.exception)


def test_a_stated_number_of_legs_is_that_of_the_first_plan():
    planner = MissionPlanner(PlannerConfig(kind="mission", depth=300.0, legs=4))
    flow = embed_member(synthetic.ensemble(), 0, EstimatorConfig())
    start, goal = Place(152.2, -39.8, 0.0), Place(152.3, -39.75, 0.0)
    first = planner.plan(flow, PlanQuery(start, goal, 0))
    assert len(first.memory.headings_deg) == 4
    after = int(first.memory.surfacing_times[1] * 1e9)
    here = Place(float(first.memory.surfacings[1, 0]), float(first.memory.surfacings[1, 1]), 0.0)
    again = planner.plan(flow, PlanQuery(here, goal, after, first))
    assert len(again.memory.headings_deg) == 2
    # the second is a plan of its own, not the first anew
    assert again.memory.start_time_ns == after


def test_a_mission_is_planned_on_estimates_for_the_time_that_it_may_take():
    still = replace(embed_member(synthetic.ensemble(), 0, EstimatorConfig()), time_ns=10**15)
    grown = growing(still, (1.0 + 0.036 * np.arange(5.0)) ** 20, 36000.0)
    same = constant(still, 10**15)
    start, goal = Place(152.15, -39.85, 0.0), Place(152.3, -39.8, 0.0)
    planner = MissionPlanner(PlannerConfig(kind="mission", depth=300.0, legs=5, flow_step=36000.0))
    # 14 km take 13.4 h at 0.29 m/s, and may take twice as long: steps to 10, 20 and 30 h, and to 40 h as they come in fours
    flows = [grown, *(grown.at(10**15 + k * 36000 * 10**9) for k in (1, 2, 3, 4))]
    asked, _ = planner.request(still.grid, start, (goal,), 10**15)
    expected = plan_mission(flows, asked)
    np.testing.assert_array_equal(
        planner.plan(grown, PlanQuery(start, goal, 10**15)).plan.track, expected.track
    )
    once = plan_mission(still, asked)
    np.testing.assert_array_equal(
        planner.plan(same, PlanQuery(start, goal, 10**15)).plan.track, once.track
    )
    assert (
        np.abs(once.track[: len(expected.track)] - expected.track[: len(once.track)]).max() > 50.0
    )


@pytest.mark.full
def test_the_last_plan_has_the_status_and_the_odds_that_the_command_plan_states_and_those_before_it_have_none(
    ocean, tmp_path
):
    out, dives = (
        tmp_path / "out.mcap",
        {"speed": 0.3, "depth": 300.0, "surface_time": 240.0, "tolerance": 100.0},
    )
    planner = PlannerConfig(kind="mission", when="surfacing", **dives)
    run(ocean, out, config=CONFIG.model_copy(update={"planner": planner}))
    # the number of samples is not recorded where none was stated, or the plans before the last would have odds when it is made again
    assert verify(out, [ocean], planner_of).same
    plans = read_result(out).plans
    last, figures = plans.iloc[-1], [name for name in plans if name.startswith("odds_")]
    assert len(plans) > 3
    assert plans[figures].iloc[:-1].isna().all(axis=None)
    start = f"--start={last.start_longitude},{last.start_latitude},{last.start_depth}"
    goal = f"--goal={GOAL.longitude},{GOAL.latitude},{GOAL.depth}"
    began = f"{plans.index[-1].isoformat()}Z"
    (tmp_path / "run.toml").write_text("[planner]\ntolerance = 100.0\n")
    dives = f"--speed=0.3 --depth=300 --surface-time=240 --config {tmp_path}/run.toml"
    done = succeed(f"plan {out} {start} {goal} --start-time {began} {dives} --json -")
    said = json.loads(done.stdout)
    samples = said["samples"]
    stated = [samples[name] for name in ("count", "reached", "safe", "radius_m")]
    assert last[["odds_n_samples", "odds_reached", "odds_safe", "odds_radius"]].tolist() == stated
    assert 0.0 < samples["reached"] < 0.9
    assert (last.status, said["status"], samples["count"]) == ("uncertain", "uncertain", 100)
    # the plan is the same, but one that begins from the plan before is not compared with the earliest arrival
    assert said["message"].startswith(last.message)


def test_the_current_is_known_for_twice_the_way_through_still_water_and_no_longer_than_a_mission():
    planner = MissionPlanner(PlannerConfig(kind="mission", depth=300.0, max_duration=1e6))
    start, goals = Place(5.0, 62.0, 0.0), [Place(5.1, 62.0, 0.0), Place(5.0, 62.0, 0.0)]
    grid = synthetic.ensemble().grid
    asked, far = (
        planner.request(grid, start, places, 0)[0]
        for places in (tuple(goals), (Place(25.0, 62.0, 0.0),))
    )
    speed = float(asked.vehicle.speeds(np, asked.vehicle.angles[0])[0])
    way = 2.0 * float(distance(5.0, 62.0, 5.1, 62.0))
    assert span_of(asked) == pytest.approx(2.0 * way / speed)
    assert span_of(far) == 1e6


@pytest.mark.full
def test_a_run_stopped_between_surfacings_is_that_of_a_run_that_was_not(ocean, tmp_path):
    goes_on(job_in(ocean, tmp_path / "out.mcap", GOAL), often(CONFIG), 80)
