"""Missions in a current that changes: what is known of it and beside it, departures compared, and plans as far as a forecast goes."""

import json
from dataclasses import replace

import numpy as np
import pytest

import replay_kit as rk
from planners import MissionRequest, MissionSettings, plan_mission
from planners.odds.mission import currents_of_estimate
from planners.plan import first_legs, fly_mission
from planners.simulation.currents import local_notes
from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.core.flow.process import Process, Unknowns
from replay_kit.core.geodesy import distance
from replay_kit.core.words.text import time_text
from replay_kit.estimator import build
from replay_kit.results import ResultWriter
from replay_kit.workflows.planning.currents import KnownCurrent, known_current
from replay_kit.workflows.planning.request import read_flow, read_known
from tests import synthetic
from tests.command import invoke, succeed
from tests.planners.flow_samples import eddying_flow, fitted_flow, place, still_flow, uniform_flow
from tests.results.result_samples import metadata_of
from tests.synthetic_flow import constant, with_weights
from tests.workflows.replay.given import position

HOUR = 3600 * 10**9
# 2026-01-01
NOON = 1_767_268_800 * 10**9
BEGIN, SECONDS = NOON + 2 * HOUR, 20 * 3600.0


def evolving(hours=(0.0, 24.0, 48.0), scale=1e6, ends=((0.15, 0.0), (-0.15, 0.05))) -> FlowEstimate:
    """An estimate that changes from one flow to another within a day, with a small uncertainty that grows."""
    before, after = (uniform_flow(*end) for end in ends)
    modes = np.column_stack([flow.latent[:, 0] for flow in (before, after)])
    n_levels, mean = before.levels.size, np.zeros((len(hours), before.levels.size, 2))
    mean[0, :, 0] = mean[1:, :, 1] = 1.0
    local = np.zeros((2, n_levels, 2))
    local[0, :, 0], local[1, :, 1] = 0.2, 0.2
    process = Process(
        NOON + np.array([round(hour * HOUR) for hour in hours]),
        mean,
        np.zeros((len(hours), 0, n_levels, 2)),
        local,
        np.ones(len(hours)),
        np.eye(n_levels),
        np.full(2, scale),
    )
    nothing = np.zeros((n_levels, len(before.nodes)))
    unknowns = Unknowns(
        process, np.zeros_like(before.latent), np.zeros(2), 0.01 * np.eye(2), NOON, nothing
    )
    return replace(before, modes=modes, unknowns=unknowns).moved(NOON)


CHANGING = evolving()
START, GOAL = place(CHANGING, -4e3, 0.0, 0.0), place(CHANGING, 3e3, 0.0, 0.0)
ASKED = MissionRequest(START, (GOAL,), settings=MissionSettings(depth=390.0), start_time_ns=NOON)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("currents") / "changing.nc"
    CHANGING.save(path)
    return path


def clock(hours):
    """A time after noon, as an option takes it."""
    return time_text(NOON + round(hours * HOUR)).replace(" ", "T")


def ask(flow, more, places=(START, GOAL)):
    start, goal = (f"{one.longitude},{one.latitude},0" for one in places)
    return invoke(f"plan {flow} --start={start} --goal={goal} --depth 390 {more}")


def answer(flow, more="--samples 0", **places):
    done = ask(flow, f"{more} --json -", **places)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_a_saved_estimate_is_planned_through_its_evolution_and_not_frozen(saved):
    said = answer(saved)
    begins = f"it begins at {time_text(NOON)}, the time of the estimate; --start-time sets another"
    assert (said["status"], said["notes"]) == ("reached", [begins])
    plan = plan_mission(KnownCurrent((CHANGING,), 43200.0).flow(NOON, 2e5), ASKED)
    assert said["duration_s"] == pytest.approx(plan.duration, rel=1e-3)
    # flown on finer steps it meets the goal as well; what is planned on the first current alone misses it
    finer = [CHANGING.at(NOON + k * HOUR) for k in range(49)]
    frozen = plan_mission(replace(CHANGING, unknowns=None), ASKED)
    changing, held = (fly_mission([finer], one)[1][0, 0] for one in (plan, frozen))
    assert changing < 60.0 < 200.0 < held


def test_a_current_changes_for_as_long_as_a_mission_against_it_takes(tmp_path):
    """5 h through still water, 19 h against a current that turns aside: it was held from 10 h on, and the way took 17 h."""
    flow = evolving((0.0, 20.0, 80.0), ends=((-0.2, 0.0), (-0.2, 0.2)))
    flow.save(path := tmp_path / "head.nc")
    (fine := tmp_path / "fine.toml").write_text("[planner]\nflow_step = 2400.0\n")
    start, goal = (
        (one.longitude, one.latitude, 0.0) for one in (place(flow, 0, 0), place(flow, 5e3, 0))
    )
    one, two = (",".join(map(str, at)) for at in (start, goal))
    pair = f"--glider one={one} --glider two={two} --goal one={two} --goal two={two}"
    settings = {"planner": {"kind": "mission", "depth": 390, "flow_step": 2400.0}}
    hours = [rk.plan(flow, start, goal, settings=settings).duration]
    for ends in f"--start={one} --goal={two}", pair:
        asked = f"plan {path} {ends} --depth 390 --samples 0 --config {fine} --json -"
        said = json.loads(succeed(asked).stdout)
        hours.append(said.get("vehicles", {"one": said})["one"]["duration_s"])
    np.testing.assert_allclose(hours, 19.0 * 3600.0, rtol=0.01)


def test_a_plan_ends_at_its_horizon_and_says_what_is_left(saved):
    whole, cut = (answer(saved, f"--samples 5 {more}") for more in ("", "--horizon 4h"))
    assert cut["status"] == "partial"
    assert 0.0 < cut["duration_s"] <= 4 * 3600.0 < whole["duration_s"]
    end = cut["legs"][-1]
    assert end["surfacing_s"] <= 4 * 3600.0
    left = float(distance(end["longitude"], end["latitude"], GOAL.longitude, GOAL.latitude))
    assert cut["closest_approach_m"][0] == pytest.approx(left)
    assert f"{left / 1e3:.1f} km left to the goal" in cut["message"]
    # samples are compared with where the plan ends
    assert cut["samples"]["miss_median_m"] < 1000.0 < left


def test_the_first_legs_of_a_mission_end_where_it_surfaces_first():
    flow = KnownCurrent((CHANGING,), 43200.0).flow(NOON, 2e5)
    plan = plan_mission(
        flow, replace(ASKED, settings=MissionSettings(depth=390.0, surface_time=900.0))
    )
    projection = CHANGING.grid.projection
    first = first_legs(plan, 1, projection)
    assert first.duration == pytest.approx(plan.surfacing_times[0] - 900.0)
    flown, _ = fly_mission([flow], first)
    np.testing.assert_allclose(flown.place[0, -1], first.track[-1, :2], atol=1.0)
    pumped = plan.vehicle.pump_work(max(plan.yo_depths[0]))
    assert first.energy == pytest.approx(plan.vehicle.hotel * first.duration + pumped)


def test_a_departure_table_has_the_best_of_single_plans_in_it(saved):
    span = f"--depart {clock(0)},{clock(12)},6h"
    said = answer(saved, f"--samples 0 {span}")
    rows = said["departures"]
    assert [row["departure"].replace(" ", "T") for row in rows] == [clock(k) for k in (0, 6, 12)]
    single = [answer(saved, f"--samples 0 --start-time {clock(k)}")["duration_s"] for k in (0, 12)]
    # leaving at once, the current sets towards the goal, later against it
    assert single[0] < rows[1]["duration_s"] < 1.002 * single[1]
    # a plan that starts from its neighbour may be better than one by itself
    assert rows[2]["duration_s"] <= 1.002 * single[1]
    assert said["duration_s"] == pytest.approx(single[0], rel=1e-3)
    assert ["planned" in row["best"] for row in rows] == [True, False, False]
    limited = answer(saved, f"--samples 0 {span} --time-limit 1e-9")
    assert [row["departure"] for row in limited["departures"]] == [time_text(NOON)]
    assert "--time-limit excluded the last 2 departures" in limited["notes"]


@pytest.mark.parametrize(("objective", "planned"), [("", 0), ("--objective time=1", 1)])
def test_waiting_for_a_shorter_way_is_advised_only_to_those_who_ask_for_the_shortest(
    saved, objective, planned
):
    # from the goal to the start the current sets against the glider, and a day later with it
    departures = f"--samples 0 --depart {clock(0)},{clock(24)},24h"
    rows = answer(saved, f"{departures} {objective}", places=(GOAL, START))["departures"]
    assert rows[1]["duration_s"] < 0.6 * rows[0]["duration_s"]
    assert rows[0]["arrival"] < rows[1]["arrival"]
    assert ["planned" in row["best"] for row in rows] == [k == planned for k in (0, 1)]
    assert "arrives first" in rows[0]["best"]


def test_odds_of_departures_and_the_result_name_them(saved, tmp_path):
    result, page = tmp_path / "plan.mcap", tmp_path / "plan.html"
    files = f"--waypoints {tmp_path}/list.csv --write-unsafe --json {tmp_path}/plan.json"
    ask(saved, f"--samples 5 --depart {clock(0)},{clock(8)},8h -o {result} {files}")
    plan = json.loads((tmp_path / "plan.json").read_text())
    # of the one that is planned the odds along its waypoints
    assert plan["departures"][0]["best"] == ["planned", "arrives first"]
    assert plan["departures"][0]["reached"] == plan["samples"]["reached"]
    said = [json.loads(row) for row in metadata_of(result)["departures"].values()]
    assert [0.0 <= row["reached"] <= 1.0 for row in said] == [True, True]
    succeed(f"report {result} -o {page}")
    assert all(row["arrival"] in page.read_text() for row in said)


SPAN = "--depart 2026-01-01T12:00Z,2026-01-02T00:00Z"


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        ("--start-time 2025-01-01", 3, "within the forecast, 2026-01-01 12:00:00Z to 2026-01-03"),
        ("--depart 2026-01-01T12:00Z,2026-01-09,24h", 3, "--depart: expected a time within the"),
        (SPAN, 2, "--depart: expected T0,T1,STEP"),
        ("--depart 2026-01-02T12:00Z,2026-01-02,6h", 2, "the first departure before the last"),
        (f"{SPAN},30s", 2, "at most 100 departures, got 1441"),
        (f"{SPAN},6h --start-time 2026-01-02", 2, "cannot be combined with --start-time"),
        ("--horizon 72h", 3, "at most 48.0 h, to the end of the forecast at 2026-01-03 12:00:00Z"),
        ("--horizon 1h", 3, "the first leg ends after"),
    ],
)
def test_times_that_it_refuses(saved, more, code, words):
    done = ask(saved, f"--samples 0 {more}")
    assert words in str(done.exception)
    assert done.exit_code == code


def test_notes_say_for_how_long_a_current_is_known():
    changing = KnownCurrent((CHANGING,), 43200.0)
    (note,) = changing.notes(NOON, NOON + 60 * HOUR)
    ends = time_text(NOON + 48 * HOUR)
    assert note.startswith(f"the forecast ends at {ends}, 12.0 h before the mission does")
    assert changing.notes(NOON, NOON + 40 * HOUR) == ()
    turning = fitted_flow(lambda x, y: (-2e-5 * y, 2e-5 * x), (9, 9))
    frozen = KnownCurrent((constant(turning, NOON),), 43200.0)
    # the vorticity of a solid rotation is twice its rate; over the whole grid it errs at the edges
    assert frozen.hours_known == pytest.approx(1.0 / (3600.0 * 4e-5), rel=0.3)
    known = KnownCurrent((evolving(hours=(0.0,), scale=1e5),), 43200.0)
    assert known.hours_known == pytest.approx(1e5 * np.log(2.0) / 3600.0)
    guess = f"frozen at {time_text(NOON)}; beyond {frozen.hours_known:.0f} h this is a guess"
    for current, words in (
        (frozen, guess),
        (KnownCurrent((still_flow(),), 43200.0), "for how long is unknown"),
        (known, "the estimate returns to the forecast"),
    ):
        assert words in current.notes(NOON, NOON + HOUR)[0]


def result_of(flow, path, *fixes):
    """Write a result with an estimate and fixes: hours since noon and whether dead reckoned."""
    with ResultWriter(path) as writer:
        writer.start(flow.grid.projection, NOON, {}, "")
        for hours, reckoned in fixes:
            seconds = NOON / 1e9 + 3600.0 * hours
            writer.fix(position(seconds, START.longitude, START.latitude, 0.0, reckoned))
        writer.finish(flow)
    return path


def test_a_mission_on_a_result_begins_when_the_vehicle_was_fixed_last(tmp_path):
    # dead reckoning went on for an hour; the estimate is of noon
    result = result_of(CHANGING, tmp_path / "log.mcap", (3.0, False), (5.0, False), (6.0, True))
    said = answer(result)
    begins = time_text(NOON + 5 * HOUR)
    told = f"it begins at {begins}, the time of the last fix; --start-time sets another"
    assert said["notes"] == [told]
    other = answer(result, f"--samples 0 --start-time {clock(12)}")
    assert not other["notes"]
    assert other["duration_s"] > said["duration_s"]
    # as long as no fix is in it, it is an estimate alone
    alone = read_known([read_flow(result_of(CHANGING, tmp_path / "none.mcap"))], 43200.0)[0]
    begin_ns, (note,) = alone.begin(None)
    assert begin_ns == NOON
    assert "the time of the estimate" in note
    # the last fix may lie before the time of the estimate
    later = replace(CHANGING.at(NOON + 5 * HOUR), time_ns=NOON + 5 * HOUR)
    result = result_of(later, tmp_path / "later.mcap", (3.0, False), (5.0, True))
    assert answer(result, f"--samples 0 --start-time {clock(3)}")["status"] == "reached"
    done = ask(result, f"--samples 0 --start-time {clock(2)}")
    assert f"within the forecast, {time_text(NOON + 3 * HOUR)} to" in str(done.exception)


def test_a_mission_begins_within_a_month_of_the_only_time_that_is_known(tmp_path):
    frozen, path = constant(eddying_flow(3), NOON), tmp_path / "frozen.nc"
    frozen.save(path)
    month = "within 30 days of the only time that is known, 2026-01-01 12:00:00Z"
    for option, words in (
        ("--start-time 1999-01-01", month),
        ("--start-time 2026-01-31T12:01Z", month),
        ("--depart 1999-01-01,1999-01-02,12h", month),
        (f"{SPAN},6h", "--depart: expected a current that changes, got one that is frozen"),
    ):
        done = ask(path, f"--samples 0 {option}")
        assert words in str(done.exception)
        assert done.exit_code == 3
    said = answer(path, "--samples 0 --start-time 2026-01-31T12:00Z")
    assert said["status"] == "reached"
    assert "the current is frozen at 2026-01-01" in said["notes"][-1]
    with pytest.raises(PlanError, match=r"within 30 days .*, got 1999-01-01 00:00:00Z"):
        rk.plan(frozen, START, GOAL, time="1999-01-01")
    # one that states no time holds at any
    KnownCurrent((replace(frozen, time_ns=None),), 43200.0).check_time("time", 0)


def test_oscillations_that_the_estimate_knows_carry_a_mission(tmp_path):
    config = TimeConfig(scale=1e6, oscillators=("inertial", "M2"))
    members = replace(synthetic.ensemble(), time_ns=NOON)
    estimator = build([members], EstimatorConfig(modes=8), time=config)
    state, extras = replace(estimator.initial(), time_ns=NOON), estimator.observer.extras
    part = slice(state.x.size - extras.size, state.x.size)
    x = state.x.copy()
    x[part] = np.random.default_rng(2).normal(size=part.stop - part.start)
    flow = estimator.flow(replace(state, x=x))
    flow.save(tmp_path / "flow.nc")
    for estimate in (flow, rk.open_estimate(tmp_path / "flow.nc")):
        known = KnownCurrent((estimate,), 43200.0)
        through = known.flow(NOON, 86400.0)
        # eight times in the twelve hours of the tide
        step = through[1].time_ns - through[0].time_ns
        assert step == pytest.approx(12.4206 / 8 * HOUR, rel=1e-4)
        drawn = known.samples(NOON, 86400.0, 3, 1)
        for k in (0, 3, 7):
            seconds = (through[k].time_ns - NOON) / 1e9
            # its twin: each unknown's column, with its amplitude as the filter predicts it
            column = extras.column(through[k].time_ns, None)
            later = x[part] * np.exp(-seconds / 259200.0)
            expected = (extras.functions(flow.levels) @ column @ later).T
            slow = flow.at(through[k].time_ns)
            here = flow.nodes[len(flow.nodes) // 2]
            found = through[k].velocity(*here, flow.levels) - slow.velocity(*here, flow.levels)
            np.testing.assert_allclose(found, expected, atol=2e-3)
            assert np.abs(found).max() > 0.02
            plain = flow.sample_through([one.time_ns for one in through], 3, 1)
            off = drawn[2][k].latent - plain[2][k].latent
            np.testing.assert_allclose(off, through[k].latent - slow.latent, atol=1e-9)


def test_files_that_do_not_follow_each_other_are_refused(tmp_path):
    first, later = (
        replace(eddying_flow(seed), time_ns=NOON + k * HOUR) for seed, k in ((1, 0), (2, 1))
    )
    a, b = (tmp_path / name for name in ("a.nc", "b.nc"))
    for second, words in (
        (first, "b.nc: expected a time after that of .*a.nc"),
        (replace(first, time_ns=None), "got no time"),
        (
            replace(uniform_flow(0.1, 0.0), time_ns=NOON + HOUR),
            "b.nc: expected the region, levels and functions of .*a.nc",
        ),
    ):
        with pytest.raises(PlanError, match=words):
            known_current([(a, first), (b, second)], 43200.0)
    known = known_current([(a, first), (b, later)], 43200.0)
    assert (known.changes, known.ends_ns) == (True, NOON + HOUR)
    assert known.flow(NOON, 1e5) == (first, later)


def beside(mean, std=0.1, cov=0.0) -> LocalCurrent:
    """A current beside an estimate."""
    one = np.ones(1)
    scale = 24.0 * 3600.0 * one
    return LocalCurrent(one, std * one, scale, np.array([mean]), cov * np.eye(2)[None], NOON)


def constant_with(local) -> FlowEstimate:
    flow = uniform_flow(0.05, 0.0)
    covariance = 1e-4 * np.eye(flow.levels.size)
    return with_weights(replace(flow, time_ns=NOON, local=local), flow.latent[:, :1], covariance)


def known_with(local, make=constant_with):
    return KnownCurrent((make(local),), 6 * 3600.0)


def water(currents, time_ns, count):
    """The current of each flow at a place and a time."""
    weights = currents.weights(np.array([20.0]))[0]
    return currents.velocity(np.zeros((count, 2)), weights, currents.clock(time_ns))


@pytest.mark.parametrize(
    ("local", "told"),
    [
        (beside([0.0, 0.1]), ["10 cm/s towards 0 degrees"]),
        (beside([0.011, 0.0], 0.0), ["1 cm/s towards 90 degrees"]),
        (beside([0.009, 0.0], 0.0), []),
        (None, []),
    ],
)
def test_an_expected_current_is_planned_with_and_forgotten(local, told):
    known = known_with(local)
    flows = known.flow(BEGIN, SECONDS)
    notes = local_notes(known.local, NOON)
    assert [words for words, note in zip(told, notes, strict=True) if words not in note] == []
    if not told:
        # it is planned on as it is
        assert flows is known.first
        return
    assert known.changes
    assert len(flows) > 1
    for flow in flows:
        more = flow.velocity(0.0, 0.0, 20.0) - known.first.velocity(0.0, 0.0, 20.0)
        np.testing.assert_allclose(more, local.velocity(flow.time_ns), atol=2e-3)


@pytest.mark.parametrize(
    ("make", "mean"),
    [(constant_with, [0.05, -0.08]), (lambda local: replace(CHANGING, local=local), [0.0, 0.0])],
)
def test_samples_have_the_mean_and_the_spread_of_estimate_and_current_beside_it(make, mean):
    local, count = beside(mean, 0.1, 1e-3), 400
    currents, without = (
        currents_of_estimate(known.flow(BEGIN, SECONDS), known.samples(BEGIN, SECONDS, count, 3))
        for known in (known_with(local, make), known_with(None, make))
    )
    for time_ns in (BEGIN, BEGIN + 18 * HOUR):
        difference = water(currents, time_ns, count) - water(without, time_ns, count)
        error = local.standard_error(time_ns)
        most = 4.0 * error / np.sqrt(count) + 2e-3
        np.testing.assert_allclose(difference.mean(axis=0), local.velocity(time_ns), atol=most)
        np.testing.assert_allclose(difference.std(axis=0), error, rtol=0.2)
    shifted = water(currents.since(BEGIN).since(0), 0, count)
    np.testing.assert_allclose(shifted, water(currents, BEGIN, count), rtol=1e-9)
