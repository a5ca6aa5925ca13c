"""Missions planned in a replay: when, what is kept of each plan, and that the result is made again bit for bit."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.as_flown import AS_FLOWN, AsFlown
from replay_kit.core.geodesy import distance, to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Place
from replay_kit.core.surfacing import Surfacing, surfacing_outcome
from replay_kit.estimator import embed_member
from replay_kit.measurements.track.dives import SurfacingState, detect_surfacing
from replay_kit.show.notebook import read_result
from replay_kit.show.status.held import read_held
from replay_kit.show.status.lines import detail_lines
from replay_kit.show.status.status import status_of
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.planner import PlanQuery
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.verify import verify
from tests import synthetic
from tests.command import invoke, succeed
from tests.results.result_samples import decoded
from tests.workflows.replay.given import position
from tests.workflows.replay.interrupted import QUICK, goes_on, job_in, often

DIVES = {"kind": "mission", "when": "surfacing", "depth": 300.0, "surface_time": 240.0}
CONFIG = RunConfig(
    estimator=QUICK, planner=DIVES | {"samples": 3, "tolerance": 500.0}, output={"interval": 7200.0}
)
GOAL = Place(152.42, -39.66, 0.0)


@pytest.fixture(scope="module")
def replayed(ocean, tmp_path_factory):
    """The result of a run, and its summary."""
    out = tmp_path_factory.mktemp("missions") / "out.mcap"
    return out, replay(job_in(ocean, out, GOAL), CONFIG, planner_of)[0]


def ns(stamp) -> int:
    return stamp.ToNanoseconds()


def test_a_mission_is_planned_at_each_surfacing_and_kept_beside_what_then_happened(replayed):
    path, summary = replayed
    held = {topic: [one for _, one in found] for topic, found in decoded(path).items()}
    plans, outcomes = held["/plan/controls"], held["/plan/outcome"]
    # the first fix not below the surface depth after each dive
    surfaced = [
        after
        for before, after in pairwise(held["/vehicle/fix"])
        if -before.altitude > 3.0 >= -after.altitude
    ]
    times = [ns(fix.timestamp) for fix in surfaced]
    assert len(times) >= 3
    # four minutes adrift after each surfacing; one more plan at the log's end
    assert [ns(plan.timestamp) - 240 * 10**9 for plan in plans[:-1]] == times
    assert [ns(outcome.timestamp) for outcome in outcomes] == times[1:]
    for outcome, plan, fix in zip(outcomes, plans, surfaced[1:], strict=False):
        assert ns(outcome.planned_time) == ns(plan.timestamp)
        here, there = ((one.longitude, one.latitude) for one in (outcome.actual, outcome.predicted))
        assert here == (fix.longitude, fix.latitude)
        assert outcome.distance == pytest.approx(float(distance(*there, *here)), rel=1e-6)
        late = ns(outcome.timestamp) - ns(outcome.predicted_time)
        assert outcome.delay == pytest.approx(late / 1e9)
        # the first leg in the plan ends after its drift, at the surface
        leg = json.loads(next(item.value for item in plan.statistics if item.name == "leg_001"))
        reached = (ns(outcome.predicted_time) - ns(plan.timestamp)) / 1e9
        assert leg["surfacing_s"] - reached == pytest.approx(240.0, abs=1e-6)
        assert outcome.ellipse_major >= outcome.ellipse_minor > 0.0
    figures, away = summary.surfacings, [outcome.distance for outcome in outcomes]
    assert figures["count"] == len(outcomes) == len(figures["each"])
    assert figures["distance_median_m"] == pytest.approx(np.median(away))
    assert figures["inside_ellipse"] == np.mean([outcome.inside_ellipse for outcome in outcomes])


def test_plans_are_for_a_vehicle_that_flies_as_its_dives_so_far_and_say_so(replayed, tmp_path):
    """The twin glides at 0.3 m/s and 19 to 35 degrees to the last level, of 300 m; its depth is stated here, its speed is not."""
    path, words = replayed[0], "as flown: 0.30 m/s, 19 to 35 degrees"
    result = rk.open_result(path)
    plans, held = result.plans, read_held(result.reader)
    # the first one is made when the first dive has ended
    assert (
        plans["message"].iloc[0].endswith("; as flown in a single dive: 0.30 m/s, 19 to 35 degrees")
    )
    assert plans["message"].iloc[1:].str.endswith(f"; {words}").all()
    flown = AsFlown.in_metadata(held.metadata)
    found = flown.speed, flown.glide_angle_deg, flown.depth, flown.dives
    assert found == (0.3, 19.0, 290.0, len(held.outcomes) + 1)
    assert words in " ".join(" ".join(detail_lines(status_of(held))).split())
    last = held.fixes[-1]
    places = f"--start={last.longitude},{last.latitude},0 --goal={GOAL.longitude},{GOAL.latitude},0"

    def said(file, more=""):
        return json.loads(succeed(f"plan {file} {more} --samples=0 --json -").stdout)

    made = said(path, f"{places} --depth 280")
    stated = said(path, f"{places} --speed 0.3 --depth 280 --angles 19,35")
    assert (made["message"], made["legs"]) == (f"{stated['message']}; {words}", stated["legs"])
    assert (made["statistics"]["dives"], "dives" in stated["statistics"]) == (words, False)
    # the dives went as deep, and so do those of a plan that states nothing, which begins at the last fix and leads to the run's goal
    whole = said(path, places)
    assert whole["message"].endswith(
        "; as flown: 0.30 m/s, dives to 290 m, 1.6 h, 19 to 35 degrees"
    )
    assert said(path)["legs"] == whole["legs"]
    # a saved estimate knows its vehicle too
    about = result.estimate.about | {AS_FLOWN: json.dumps(flown.to_record())}
    replace(result.estimate, about=about).save(tmp_path / "flow.nc")
    assert said(tmp_path / "flow.nc", places)["message"] == whole["message"]


def at(seconds, depth=np.nan, reckoned=False):
    return position(seconds, depth=depth, reckoned=reckoned)


def of(seconds, dive):
    """A profile of a dive."""
    given = synthetic.ensemble().grid, 0.0, 0.0, np.array([50.0]), np.zeros((1, 2))
    return synthetic.profile(*given, time_ns=int(seconds * 1e9), dive=dive)


@pytest.mark.parametrize(
    ("events", "seen"),
    [
        # 4 m is no dive, a computed position no fix
        (
            [
                *(at(0, 0.0), at(10, 4.0), at(20, 0.0), at(30, 90.0), at(40, 1.0, True)),
                *(at(50, 1.0), at(60, 0.0), at(70, 50.0), at(80)),
            ],
            [50.0, 80.0],
        ),
        # positions without depths: the last before the next dive's first profile, and none where there is no position
        ([at(10), of(15, 1), of(20, 1), at(30), at(40), of(45, 2), of(75, 3)], [40.0]),
        ([at(t, 0.0) for t in range(5)], []),
    ],
)
def test_a_surfacing_is_a_fix_after_a_dive_or_before_the_next_one(events, seen):
    watch, found = SurfacingState(), []
    for event in events:
        watch, fix = detect_surfacing(watch, event, 3.0)
        found += [] if fix is None else [fix.time_ns / 1e9]
    assert found == seen


def test_dives_deeper_than_the_forecast_are_refused_where_there_are_dives(ocean, tmp_path):
    # a mission is asked for on the command line; a glide has no dives that could be too deep
    (tmp_path / "run.toml").write_text("planner.depth = 900.0\nestimator.modes = 6\n")
    files = f"{ocean}/glider.mcap --ensemble {ocean}/ensemble.nc -o {tmp_path}/out.mcap"
    done = invoke(
        f"replay {files} --config {tmp_path}/run.toml --goal=152.42,-39.66,0 --planner mission"
    )
    assert "[planner] depth is 900 m" in str(done.exception)


def test_a_stated_number_of_legs_is_that_of_the_first_plan():
    flow = embed_member(synthetic.ensemble(), 0, EstimatorConfig())
    planner = planner_of(PlannerConfig(kind="mission", depth=300.0, legs=4), flow.grid)
    start, goal = Place(152.2, -39.8, 0.0), Place(152.3, -39.75, 0.0)
    first = planner.plan(flow, PlanQuery(start, goal, 0))
    assert len(first.memory.headings_deg) == 4
    after = int(first.memory.surfacing_times[1] * 1e9)
    here = Place(*map(float, first.memory.surfacings[1, :2]), 0.0)
    again = planner.plan(flow, PlanQuery(here, goal, after, first))
    # the second is a plan of its own, not the first anew
    assert (len(again.memory.headings_deg), again.memory.start_time_ns) == (2, after)


@pytest.mark.full
def test_the_last_plan_has_the_status_and_the_odds_that_the_command_plan_states_and_those_before_it_have_none(
    ocean, tmp_path
):
    out, planner = tmp_path / "out.mcap", DIVES | {"speed": 0.3, "tolerance": 100.0}
    replay(
        job_in(ocean, out, GOAL),
        CONFIG.model_copy(update={"planner": PlannerConfig(**planner)}),
        planner_of,
    )
    # the number of samples is not recorded where none was stated, or the plans before the last would have odds when it is made again
    assert verify(out, [ocean], planner_of).same
    plans = read_result(out).plans
    last, figures = plans.iloc[-1], [name for name in plans if name.startswith("odds_")]
    assert len(plans) > 3
    assert plans[figures].iloc[:-1].isna().all(axis=None)
    start = f"--start={last.start_longitude},{last.start_latitude},{last.start_depth}"
    begin = f"{start} --start-time {plans.index[-1].isoformat()}Z --goal=152.42,-39.66,0"
    (tmp_path / "run.toml").write_text("[planner]\ntolerance = 100.0\n")
    dives = f"--speed=0.3 --depth=300 --surface-time=240 --config {tmp_path}/run.toml"
    said = json.loads(succeed(f"plan {out} {begin} {dives} --json -").stdout)
    samples = said["samples"]
    stated = [samples[name] for name in ("count", "reached", "safe", "radius_m")]
    assert last[["odds_n_samples", "odds_reached", "odds_safe", "odds_radius"]].tolist() == stated
    assert 0.0 < samples["reached"] < 0.9
    assert (last.status, said["status"], samples["count"]) == ("uncertain", "uncertain", 100)
    # the plan is the same, but one that begins from the plan before is not compared with the earliest arrival
    assert said["message"].startswith(last.message)


@pytest.mark.full
def test_a_run_stopped_between_surfacings_is_that_of_a_run_that_was_not(ocean, tmp_path):
    goes_on(job_in(ocean, tmp_path / "out.mcap", GOAL), often(CONFIG), 80)


def test_an_outcome_says_how_far_and_which_way_the_surfacing_was():
    place = map(float, to_geographic(Projection(152.0, -40.0), -300.0, 400.0))
    found = surfacing_outcome(0, Surfacing(100 * 10**9, 152.0, -40.0), position(90, *place))
    assert found.distance == pytest.approx(500.0)
    assert found.direction_deg == pytest.approx(360.0 - np.rad2deg(np.arctan2(3.0, 4.0)))
    assert (found.late, found.inside) == (-10.0, None)
