"""Missions in a current that changes: what is known of it, departures compared, and plans as far as a forecast goes."""

import json
from dataclasses import replace

import numpy as np
import pytest

import replay_kit as rk
from planners import (
    MissionRequest,
    MissionSettings,
    Weights,
    best_departure,
    cut_at_horizon,
    plan_departures,
    plan_mission,
)
from planners.odds.departures import first_legs
from planners.odds.flights import fly_mission
from replay_kit.config.estimation import TimeConfig
from replay_kit.config.plan import departures_of
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError, PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.file import load
from replay_kit.core.flow.process import Process
from replay_kit.core.flow.unknowns import Unknowns
from replay_kit.core.geodesy import distance
from replay_kit.core.observation import Source, VehicleState
from replay_kit.core.words.quantities import parse_duration
from replay_kit.core.words.text import time_text
from replay_kit.estimator import build
from replay_kit.results import ResultWriter
from replay_kit.workflows.planning.currents import KnownCurrent, known_current
from replay_kit.workflows.planning.inputs import read_flow, read_known
from tests import synthetic
from tests.command import invoke, succeed
from tests.planners.flow_samples import eddying_flow, fitted_flow, place, still_flow, uniform_flow
from tests.results.result_samples import metadata_of
from tests.synthetic_flow import constant

HOUR = 3600 * 10**9
NOON = 1_767_268_800 * 10**9
SETTINGS = MissionSettings(depth=390.0)


def evolving(hours=(0.0, 24.0, 48.0), scale=1e6) -> FlowEstimate:
    """An estimate that changes from one flow to another within a day, with a small uncertainty that grows."""
    before, after = uniform_flow(0.15, 0.0), uniform_flow(-0.15, 0.05)
    modes = np.column_stack([flow.latent[:, 0] for flow in (before, after)])
    n_levels, mean = before.levels.size, np.zeros((len(hours), before.levels.size, 2))
    mean[0, :, 0] = mean[1:, :, 1] = 1.0
    local = np.zeros((2, n_levels, 2))
    local[0, :, 0], local[1, :, 1] = 0.2, 0.2
    times = NOON + np.array([round(hour * HOUR) for hour in hours])
    process = Process(
        times,
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


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("currents") / "changing.nc"
    CHANGING.save(path)
    return path


def clock(time_ns):
    return time_text(time_ns).replace(" ", "T")


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
    known = KnownCurrent((CHANGING,), 43200.0)
    plan = plan_mission(
        known.flow(NOON, 2e5), MissionRequest(START, (GOAL,), settings=SETTINGS, start_time_ns=NOON)
    )
    assert said["duration_s"] == pytest.approx(plan.duration, rel=1e-3)
    # flown on finer steps it meets the goal as well; what is planned on the first current alone misses it
    finer = [CHANGING.at(NOON + k * HOUR) for k in range(49)]
    frozen = plan_mission(
        replace(CHANGING, unknowns=None),
        MissionRequest(START, (GOAL,), settings=SETTINGS, start_time_ns=NOON),
    )
    changing, held = (float(fly_mission([finer], one).miss[0, 0]) for one in (plan, frozen))
    assert changing < 60.0 < 200.0 < held


def test_the_error_of_an_estimate_grows_at_the_ensemble_s_rate():
    quick, slow = (KnownCurrent((evolving(scale=scale),), 43200.0) for scale in (2e4, 1e9))
    spread = []
    for known in (quick, slow):
        drawn = known.samples(NOON, 86400.0, 200, 1)
        spread.append([np.std([through[k].latent[0, 0] for through in drawn]) for k in (0, 2)])
    assert spread[0][1] > 4.0 * spread[0][0]
    assert spread[1][1] == pytest.approx(spread[1][0], rel=0.8)
    assert spread[1][1] < 0.5 * spread[0][1]


def test_a_departure_table_has_the_best_of_single_plans_in_it(saved):
    said = answer(saved, f"--samples 0 --depart {clock(NOON)},{clock(NOON + 12 * HOUR)},6h")
    rows = said["departures"]
    times = (row["departure"].replace(" ", "T") for row in rows)
    single = [answer(saved, f"--samples 0 --start-time {time}") for time in times]
    assert [row["departure"] for row in rows] == [time_text(NOON + k * 6 * HOUR) for k in range(3)]
    # a plan that starts from its neighbour may be better than one by itself
    assert all(
        row["duration_s"] <= 1.002 * one["duration_s"]
        for row, one in zip(rows, single, strict=True)
    )
    best = min(single, key=lambda one: one["duration_s"])
    assert said["duration_s"] == pytest.approx(best["duration_s"], rel=1e-3)
    assert [row["best"] for row in rows if "planned" in row["best"]] == [
        rows[single.index(best)]["best"]
    ]
    arrivals = [row["arrival"] for row in rows]
    assert [row["arrival"] for row in rows if "arrives first" in row["best"]] == [min(arrivals)]
    # leaving at once, the current sets towards the goal, later against it
    assert single[0]["duration_s"] < single[1]["duration_s"] < single[2]["duration_s"]


def test_a_time_limit_is_that_of_all_departures(saved):
    departures = f"--depart {clock(NOON)},{clock(NOON + 12 * HOUR)},6h"
    said = answer(saved, f"--samples 0 {departures} --time-limit 1e-9")
    assert [row["departure"] for row in said["departures"]] == [time_text(NOON)]
    assert "--time-limit excluded the last 2 departures" in said["notes"]


@pytest.mark.parametrize(("objective", "planned"), [("", 0), ("--objective time=1", 1)])
def test_waiting_for_a_shorter_way_is_advised_only_to_those_who_ask_for_the_shortest(
    saved, objective, planned
):
    # from the goal to the start the current sets against the glider, and a day later with it
    departures = f"--samples 0 --depart {clock(NOON)},{clock(NOON + 24 * HOUR)},24h"
    rows = answer(saved, f"{departures} {objective}", places=(GOAL, START))["departures"]
    assert rows[1]["duration_s"] < 0.6 * rows[0]["duration_s"]
    assert rows[0]["arrival"] < rows[1]["arrival"]
    assert ["planned" in row["best"] for row in rows] == [k == planned for k in (0, 1)]
    assert "arrives first" in rows[0]["best"]


def test_odds_of_departures_and_the_result_name_them(saved, tmp_path):
    departures = f"{clock(NOON)},{clock(NOON + 8 * HOUR)},8h"
    done = ask(saved, f"--samples 5 --depart {departures} -o {tmp_path}/plan.mcap")
    assert done.exit_code == 0, done.output
    assert "Departures compared" in done.output
    assert "arrives first" in done.output
    rows = metadata_of(tmp_path / "plan.mcap")["departures"]
    said = [json.loads(row) for row in rows.values()]
    assert [0.0 <= row["reached"] <= 1.0 for row in said] == [True, True]
    succeed(f"report {tmp_path}/plan.mcap -o {tmp_path}/plan.html")
    page = (tmp_path / "plan.html").read_text()
    assert "Departures compared" in page
    assert all(row["arrival"] in page for row in said)


@pytest.mark.full
def test_fewer_legs_are_tried_where_a_later_departure_needs_fewer():
    speeds = ((-0.1, 0), (-0.1, 20), (0.2, 24), (0.2, 96))
    flows = [
        replace(uniform_flow(speed, 0.0), time_ns=NOON + hours * HOUR) for speed, hours in speeds
    ]
    request = MissionRequest(START, (GOAL,), settings=SETTINGS)
    against, along = plan_departures(flows, request, [NOON, NOON + 26 * HOUR])
    alone = plan_mission(flows, replace(request, start_time_ns=NOON + 26 * HOUR))
    assert len(along.headings_deg) == len(alone.headings_deg) < len(against.headings_deg)
    assert along.duration == pytest.approx(alone.duration, rel=1e-3)
    # leaving a day later it is there later, but sooner after it left
    assert best_departure([against, along]) == 0
    shortest = replace(SETTINGS, objective=Weights(time=1.0))
    assert best_departure([replace(one, settings=shortest) for one in (against, along)]) == 1
    assert best_departure([replace(against, status="unreachable"), along]) == 1
    with pytest.raises(PlanError, match="expected one or more that increase"):
        plan_departures(flows, request, [NOON, NOON])


def test_a_plan_ends_at_its_horizon_and_says_what_is_left(saved):
    whole, cut = (answer(saved, f"--samples 5 {more}") for more in ("", "--horizon 4h"))
    assert cut["status"] == "partial"
    assert 0.0 < cut["duration_s"] <= 4 * 3600.0 < whole["duration_s"]
    kept = len(cut["legs"])
    assert cut["legs"][-1]["surfacing_s"] <= 4 * 3600.0
    end = cut["legs"][-1]
    left = float(distance(end["longitude"], end["latitude"], GOAL.longitude, GOAL.latitude))
    assert cut["closest_approach_m"][0] == pytest.approx(left)
    assert f"{left / 1e3:.1f} km left to the goal" in cut["message"]
    assert f"{kept} of " in cut["message"]
    # samples are compared with where the plan ends
    assert cut["samples"]["miss_median_m"] < 1000.0 < left
    assert answer(saved, "--samples 0 --horizon 47h")["status"] == "reached"


def test_the_first_legs_of_a_mission_end_where_it_surfaces_first():
    known = KnownCurrent((CHANGING,), 43200.0)
    flow, settings = known.flow(NOON, 2e5), replace(SETTINGS, surface_time=900.0)
    plan = plan_mission(flow, MissionRequest(START, (GOAL,), settings=settings, start_time_ns=NOON))
    projection = CHANGING.grid.projection
    first = first_legs(plan, 1, projection)
    assert first.duration == pytest.approx(plan.surfacing_times[0] - 900.0)
    flown = fly_mission([flow], first)
    np.testing.assert_allclose(flown.place[0, -1], first.track[-1, :2], atol=1.0)
    assert first.track[-1, 2] == pytest.approx(0.0, abs=1e-6)
    assert first_legs(plan, len(plan.headings_deg), projection).duration == pytest.approx(
        plan.duration
    )
    assert first_legs(plan, len(plan.headings_deg), projection).energy == pytest.approx(plan.energy)
    pumped = plan.vehicle.pump_work(max(plan.yo_depths[0]))
    assert first.energy == pytest.approx(plan.vehicle.hotel * first.duration + pumped)
    assert cut_at_horizon(plan, plan.duration + 1.0, projection) is plan
    with pytest.raises(PlanError, match="the first leg ends after"):
        cut_at_horizon(plan, 0.5 * plan.surfacing_times[0], projection)


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        (
            "--start-time 2025-01-01T00:00Z",
            3,
            "--start-time: expected a time within the forecast, 2026-01-01 12:00:00Z to 2026-01-03",
        ),
        ("--start-time tomorrow", 2, "--start-time: 'tomorrow' is no time"),
        (
            "--depart 2026-01-01T12:00Z,2026-01-09T00:00Z,24h",
            3,
            "--depart: expected a time within the forecast",
        ),
        (
            "--depart 2026-01-01T12:00Z,2026-01-02T00:00Z,0h",
            2,
            "--depart: expected a duration above 0, got '0h'",
        ),
        ("--depart 2026-01-01T12:00Z,2026-01-02T00:00Z", 2, "--depart: expected T0,T1,STEP"),
        (
            "--depart 2026-01-02T12:00Z,2026-01-02T00:00Z,6h",
            2,
            "the first departure before the last",
        ),
        (
            "--depart 2026-01-01T12:00Z,2026-01-02T12:00Z,1min",
            2,
            "at most 100 departures, got 1441",
        ),
        (
            "--depart 2026-01-01T12:00Z,2026-01-02T00:00Z,6h --start-time 2026-01-02T00:00Z",
            2,
            "--depart: cannot be combined with --start-time",
        ),
        (
            "--depart 2026-01-01T12:00Z,2026-01-02T00:00Z,6h --risk 0.1",
            2,
            "--depart: cannot be combined with --risk",
        ),
        (
            "--depart 2026-01-01T12:00Z,2026-01-02T00:00Z,6h --horizon 9h",
            2,
            "--depart: cannot be combined with",
        ),
        (
            "--horizon 72h",
            3,
            "--horizon: expected at most 48.0 h, to the end of the forecast at 2026-01-03 12:00:00Z, got 72 h",
        ),
        ("--horizon 0h", 2, "--horizon: expected a duration above 0"),
        ("--horizon 1h", 3, "the first leg ends after"),
        ("--horizon 20h --line", 2, "--line: cannot be combined with --horizon"),
    ],
)
def test_times_that_it_refuses(saved, more, code, words):
    done = ask(saved, f"--samples 0 {more}")
    assert words in str(done.exception)
    assert getattr(done.exception, "exit_code", None) == code


def test_a_current_of_one_time_says_for_how_long_it_holds(tmp_path):
    turning = fitted_flow(lambda x, y: (-2e-5 * y, 2e-5 * x), (9, 9))
    frozen = KnownCurrent((constant(turning, NOON),), 43200.0)
    # the vorticity of a solid rotation is twice its rate; over the whole grid it errs at the edges
    assert frozen.hours_known == pytest.approx(1.0 / (3600.0 * 4e-5), rel=0.3)
    (note,) = frozen.notes(NOON, NOON + HOUR)
    assert f"frozen at {time_text(NOON)}; beyond {frozen.hours_known:.0f} h this is a guess" in note
    assert "The mission" not in note
    (note,) = frozen.notes(NOON - 300 * 24 * HOUR, NOON)
    assert note.endswith(
        "The mission begins 300 days before that time: the current there is little known"
    )
    assert frozen.notes(NOON, NOON + 100 * HOUR)[0].endswith(
        "The mission ends 100 h after that time"
    )
    (still,) = KnownCurrent((still_flow(),), 43200.0).notes(0, HOUR)
    assert "for how long is unknown" in still
    known = KnownCurrent((evolving(hours=(0.0,), scale=1e5),), 43200.0)
    assert known.hours_known == pytest.approx(1e5 * np.log(2.0) / 3600.0)
    assert "returns to it at the ensemble's rate of change" in known.notes(NOON, NOON + HOUR)[0]
    path = tmp_path / "frozen.nc"
    constant(eddying_flow(3), NOON).save(path)
    assert "the current is frozen at 2026-01-01 12:00:00Z; beyond" in answer(path, "")["notes"][-1]
    done = ask(path, "--depart 2026-01-01T12:00Z,2026-01-02T00:00Z,6h")
    assert (
        "--depart: expected a current that changes, got one that is frozen at 2026-01-01 12:00:00Z"
        in str(done.exception)
    )


def result_of(flow, path, *fixes):
    """Write a result with an estimate and fixes: hours since noon and whether dead reckoned."""
    with ResultWriter(path) as writer:
        writer.start(flow.grid.projection, NOON, {}, "")
        for hours, reckoned in fixes:
            source = Source(0, "/vehicle/fix", 0, 0)
            writer.fix(
                VehicleState(
                    NOON + round(hours * HOUR),
                    START.longitude,
                    START.latitude,
                    0.0,
                    reckoned,
                    source,
                )
            )
        writer.finish(flow)
    return path


def test_a_mission_on_a_result_begins_when_the_vehicle_was_fixed_last(tmp_path):
    # dead reckoning went on for an hour; the estimate is of noon
    result = result_of(CHANGING, tmp_path / "log.mcap", (3.0, False), (5.0, False), (6.0, True))
    said = answer(result, f"--samples 0 -o {tmp_path}/plan.mcap")
    begins = time_text(NOON + 5 * HOUR)
    assert said["notes"] == [
        f"it begins at {begins}, the time of the last fix; --start-time sets another"
    ]
    mission = metadata_of(tmp_path / "plan.mcap")["mission"]
    assert int(mission["start_time_ns"]) == NOON + 5 * HOUR
    other = answer(result, f"--samples 0 --start-time {clock(NOON + 12 * HOUR)}")
    assert (other["notes"], other["duration_s"] > said["duration_s"]) == ([], True)
    # as long as no fix is in it, it is an estimate alone
    begin_ns, (note,) = _known_in(result_of(CHANGING, tmp_path / "none.mcap")).begin(None)
    assert (begin_ns, "the time of the estimate" in note) == (NOON, True)


def _known_in(path):
    return read_known([read_flow(path)], 43200.0)[0]


def test_a_mission_may_begin_at_a_last_fix_before_the_time_of_the_estimate(tmp_path):
    later = replace(CHANGING.at(NOON + 5 * HOUR), time_ns=NOON + 5 * HOUR)
    result = result_of(later, tmp_path / "log.mcap", (3.0, False), (5.0, True))
    assert (
        answer(result, f"--samples 0 --start-time {clock(NOON + 3 * HOUR)}")["status"] == "reached"
    )
    done = ask(result, f"--samples 0 --start-time {clock(NOON + 2 * HOUR)}")
    assert f"expected a time within the forecast, {time_text(NOON + 3 * HOUR)} to" in str(
        done.exception
    )


def test_a_mission_begins_within_a_month_of_the_only_time_that_is_known(tmp_path):
    frozen, path = constant(eddying_flow(3), NOON), tmp_path / "frozen.nc"
    frozen.save(path)
    words = (
        "expected a time within 30 days of the only time that is known, 2026-01-01 12:00:00Z, "
        "2025-12-02 12:00:00Z to 2026-01-31 12:00:00Z"
    )
    for option in (
        "--start-time 1999-01-01",
        "--depart 1999-01-01,1999-01-02,12h",
        "--start-time 2026-01-31T12:01Z",
    ):
        done = ask(path, f"--samples 0 {option}")
        assert f"{option.split()[0]}: {words}" in str(done.exception)
        assert done.exception.exit_code == 3
    assert answer(path, "--samples 0 --start-time 2026-01-31T12:00Z")["status"] == "reached"
    with pytest.raises(
        PlanError, match=r"time: expected a time within 30 days .*, got 1999-01-01 00:00:00Z"
    ):
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
    for estimate in (flow, load(tmp_path / "flow.nc")):
        known = KnownCurrent((estimate,), 43200.0)
        through = known.flow(NOON, 86400.0)
        # eight times in the twelve hours of the tide
        assert through[1].time_ns - through[0].time_ns == pytest.approx(
            12.4206 / 8 * HOUR, rel=1e-4
        )
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
            np.testing.assert_allclose(
                drawn[2][k].latent - plain[2][k].latent, through[k].latent - slow.latent, atol=1e-9
            )


def test_a_mission_longer_than_the_forecast_is_told():
    known = KnownCurrent((CHANGING,), 43200.0)
    (note,) = known.notes(NOON, NOON + 60 * HOUR)
    assert note.startswith(
        f"the forecast ends at {time_text(NOON + 48 * HOUR)}, 12.0 h before the mission does"
    )
    assert known.notes(NOON, NOON + 40 * HOUR) == ()


def test_files_that_do_not_follow_each_other_are_refused(tmp_path):
    first = replace(eddying_flow(1), time_ns=NOON)
    files = [tmp_path / name for name in ("a.nc", "b.nc")]
    for second, words in (
        (first, "b.nc: expected a time after that of .*a.nc"),
        (replace(first, time_ns=None), "got no time"),
        (
            replace(uniform_flow(0.1, 0.0), time_ns=NOON + HOUR),
            "b.nc: expected the region, levels and functions of .*a.nc",
        ),
    ):
        with pytest.raises(PlanError, match=words):
            known_current([(files[0], first), (files[1], second)], 43200.0)
    later = replace(eddying_flow(2), time_ns=NOON + HOUR)
    known = known_current([(files[0], first), (files[1], later)], 43200.0)
    assert (known.changes, known.ends_ns, known.flow(NOON, 1e5)) == (
        True,
        NOON + HOUR,
        (first, later),
    )


def test_durations_and_departures_are_read():
    assert [parse_duration(text) for text in ("90s", "30min", "6h", "1.5d")] == [
        90.0,
        1800.0,
        21600.0,
        129600.0,
    ]
    with pytest.raises(ConfigError, match="'-3h' is no duration"):
        parse_duration("-3h")
    assert departures_of("2026-01-01T12:00Z, 2026-01-02T01:00Z,6h") == tuple(
        NOON + k * 6 * HOUR for k in range(3)
    )
