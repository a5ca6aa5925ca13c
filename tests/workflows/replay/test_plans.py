"""When a replay's loop plans, and from where: at intervals, at surfacings, and after the drift at the surface."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Place
from replay_kit.estimator import Estimator, Stepped
from replay_kit.estimator.update.screening import screened
from replay_kit.workflows.replay.follow_up import end
from replay_kit.workflows.replay.stages.planner import PlanResult
from replay_kit.workflows.replay.stages.plans import PlanningProblem
from tests import synthetic
from tests.planners.flow_samples import CENTRE, uniform_flow
from tests.workflows.replay.given import fed, position, run_of

FLOW = uniform_flow(0.3, -0.4)
PROFILE = synthetic.profile(FLOW.grid, 0.0, 0.0, np.array([10.0]), np.zeros((1, 2)))
SECOND = 10**9


class Still(Estimator):
    """An estimator that learns nothing."""

    def initial(self):
        return ()

    def assimilate(self, state, block):
        unused = screened([PROFILE], FLOW.grid)[0][0].unused(0)
        return state, [Stepped(each, state, state, unused) for each in block]

    def innovation(self, state, measurement):
        return np.zeros((1, 2))

    def flow(self, state):
        return FLOW


@dataclass
class Asked:
    """A planner that notes when and from where it is asked, and finds nothing."""

    calls: list[tuple[float, Place]] = field(default_factory=list)

    def plan(self, flow: Any, query: Any) -> Any:
        self.calls.append((query.start_time_ns / SECOND, query.start))
        raise PlanError("nothing is planned here")


def profile(seconds):
    return replace(PROFILE, time_ns=int(seconds * SECOND))


def fix(seconds, depth):
    return position(seconds, CENTRE.longitude, CENTRE.latitude, depth)


def asked(events, **planner):
    planned, config = Asked(), RunConfig(planner=PlannerConfig(**planner))
    problem = PlanningProblem(
        planned, Place(152.6, -40.0, 0.0), config.planner, config.measurements.surface_depth
    )
    fed(run_of(Still(), config, problem), events)
    return planned.calls


def test_plans_are_an_interval_apart():
    events = [fix(0, 0.0), *map(profile, (0, 50, 99, 100, 101, 150, 199, 230, 250, 329, 330))]
    # the first interval begins with the first profile, each further one with the plan before
    assert [time for time, _ in asked(events, interval=100.0)] == [100.0, 230.0, 330.0]


def test_a_plan_at_a_surfacing_puts_the_next_one_off_by_an_interval():
    events = [
        fix(0, 0.0),
        profile(10),
        fix(20, 50.0),
        fix(90, 0.0),
        fix(95, 0.0),
        *map(profile, (120, 189, 190, 200, 289, 290)),
    ]
    calls = asked(events, when="surfacing", interval=100.0, surface_time=600.0)
    # planned at the surfacing for the end of its drift; then nothing surfaces for an interval, twice
    assert [time for time, _ in calls] == [690.0, 190.0, 290.0]


def test_a_mission_that_is_due_waits_for_a_surfacing_an_interval_at_most():
    dives = [
        event
        for end in (60, 120, 180, 220)
        for event in (fix(end - 30, 50.0), fix(end, 0.0), fix(end + 5, 0.0))
    ]
    events = sorted(
        [fix(0, 0.0), *dives, *map(profile, (10, 20, 110, 350, 419, 420, 619, 620))],
        key=lambda event: event.time_ns,
    )
    # due at 110 and at 220, planned at the surfacings of 120 and 220; then nothing surfaces: due at 320 and 520, planned an interval later
    assert [time for time, _ in asked(events, kind="mission", interval=100.0)] == [
        120.0,
        220.0,
        420.0,
        620.0,
    ]


@pytest.mark.parametrize("seconds", [0.0, 600.0, 3600.0])
def test_a_plan_at_a_surfacing_begins_where_the_current_takes_the_vehicle(seconds):
    events = [fix(0, 0.0), fix(20, 50.0), fix(90, 0.0), fix(95, 0.0)]
    ((time, start),) = asked(events, when="surfacing", surface_time=seconds)
    assert time == 90.0 + seconds
    drift = to_local(Projection(CENTRE.longitude, CENTRE.latitude), start.longitude, start.latitude)
    np.testing.assert_allclose(drift, [0.3 * seconds, -0.4 * seconds], rtol=0.02, atol=1e-6)
    assert start.depth == 0.0


class Counting:
    """A planner, of a speed, that notes when its plans begin."""

    def __init__(self, speed: float, asked: list[int]):
        self.speed, self.asked = speed, asked

    def plan(self, flow: Any, query: Any) -> PlanResult:
        self.asked.append(query.start_time_ns // SECOND)
        plan = SimpleNamespace(start=query.start, start_time_ns=query.start_time_ns)
        return PlanResult(plan, None, len(self.asked))

    def with_odds(self):
        return self

    def __reduce__(self):
        return float, (self.speed,)


@pytest.mark.parametrize(
    ("more", "settings", "starts"),
    [
        ([], {"samples": 10}, [90]),
        ([fix(95, 0.0)], {"samples": 10}, [90, 95]),
        ([], {"samples": 10, "surface_time": 600.0}, [690, 90]),
        ([], {}, [90, 90]),
    ],
)
def test_the_plan_at_a_surfacing_where_the_log_ends_is_the_last_one_if_it_has_odds(
    more, settings, starts
):
    planner, config = Counting(0.3, []), PlannerConfig(when="surfacing", **settings)
    problem = PlanningProblem(planner, Place(152.6, -40.0, 0.0), config, 5.0)
    events = [fix(0, 0.0), profile(10), fix(20, 50.0), fix(90, 0.0), *more]
    end(fed(run_of(Still(), RunConfig(planner=config), problem), events), 0)
    assert planner.asked == starts
