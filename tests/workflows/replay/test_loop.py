"""What a replay's loop gives its estimator, its planner and its result, and when: with stand-ins that note what they are given."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import GroupTotals
from replay_kit.core.plan import Place
from replay_kit.core.words.progress import Stopwatch
from replay_kit.estimator import Estimator, Stepped
from replay_kit.estimator.update.screening import screened
from replay_kit.workflows.replay.inputs.planner import PlanResult
from replay_kit.workflows.replay.plans import PlanningProblem
from replay_kit.workflows.replay.run import Run, finish_vehicle, follow_up
from replay_kit.workflows.replay.steps import Step, Sums
from replay_kit.workflows.replay.vehicle import Setup
from tests import synthetic
from tests.planners.flow_samples import CENTRE, uniform_flow
from tests.workflows.replay.given import block_of, position

FLOW = uniform_flow(0.3, -0.4)
PROFILE = synthetic.profile(FLOW.grid, 0.0, 0.0, np.array([10.0]), np.zeros((1, 2)))
UNUSED = screened([PROFILE], FLOW.grid)[0][0].unused(0)
SECOND = 10**9


class Untaught(Estimator):
    """An estimator that takes everything and learns nothing."""

    def initial(self):
        return ()

    def assimilate(self, state, block):
        taken = replace(UNUSED, accepted=True)
        return state, [Stepped(one, state, state, taken) for one in block]

    def innovation(self, state, measurement):
        return np.zeros((1, 2))

    def flow(self, state):
        return FLOW


class Asked:
    """A planner that notes when and from where it is asked, and if for odds; a plan of it has the number of those before."""

    def __init__(self, finds=True, calls=None, odds=False):
        self.finds, self.calls, self.odds = finds, [] if calls is None else calls, odds

    def plan(self, flow, query):
        self.calls.append((query.start_time_ns / SECOND, query.start, self.odds))
        if not self.finds:
            raise PlanError("nothing is planned here")
        plan = SimpleNamespace(start=query.start, start_time_ns=query.start_time_ns)
        return PlanResult(plan, None, len(self.calls))

    def with_odds(self):
        return Asked(self.finds, self.calls, odds=True)

    def __reduce__(self):
        return float, (0.3,)


def profile(seconds):
    return replace(PROFILE, time_ns=int(seconds * SECOND))


def fix(seconds, depth=0.0):
    return position(seconds, CENTRE.longitude, CENTRE.latitude, depth)


def planned(events, finds=False, concluded=False, **settings):
    """The times [s] and places of the plans of a run."""
    asked, config = Asked(finds), RunConfig(planner=PlannerConfig(**settings))
    problem = PlanningProblem(asked, Place(152.6, -40.0, 0.0), config.planner, 3.0)
    run = Run([Setup(Untaught(), config, problem)], config.measurements, Stopwatch())
    run.follow_up = follow_up
    run.give(0, block_of(events), 0, len(events))
    run.last_ns = events[-1].time_ns
    run.finish()
    if concluded:
        finish_vehicle(run, run.vehicles[0])
    return asked.calls


DIVES = [
    event for end in (60, 120, 180, 220) for event in (fix(end - 30, 50.0), fix(end), fix(end + 5))
]


@pytest.mark.parametrize(
    ("settings", "events", "times"),
    [
        # the first interval begins with the first profile, each further one with the plan before
        (
            {},
            [fix(0), *map(profile, (0, 50, 99, 100, 101, 150, 199, 230, 250, 329, 330))],
            [100, 230, 330],
        ),
        # planned at the surfacing for the end of its drift; then nothing surfaces for an interval, twice
        (
            {"when": "surfacing", "surface_time": 600.0},
            [
                *(fix(0), profile(10), fix(20, 50.0), fix(90), fix(95)),
                *map(profile, (120, 189, 190, 200, 289, 290)),
            ],
            [690, 190, 290],
        ),
        # due at 110 and at 220, planned at the surfacings of 120 and 220; then due at 320 and 520, planned an interval later
        (
            {"kind": "mission"},
            sorted(
                [fix(0), *DIVES, *map(profile, (10, 20, 110, 350, 419, 420, 619, 620))],
                key=lambda event: event.time_ns,
            ),
            [120, 220, 420, 620],
        ),
    ],
    ids=["intervals", "surfacings", "missions"],
)
def test_plans_are_an_interval_apart_or_wait_for_a_surfacing_an_interval_at_most(
    settings, events, times
):
    assert [time for time, *_ in planned(events, interval=100.0, **settings)] == times


@pytest.mark.parametrize("seconds", [0.0, 600.0, 3600.0])
def test_a_plan_at_a_surfacing_begins_where_the_current_takes_the_vehicle(seconds):
    events = [fix(0), fix(20, 50.0), fix(90), fix(95)]
    ((time, start, _),) = planned(events, when="surfacing", surface_time=seconds)
    assert (time, start.depth) == (90.0 + seconds, 0.0)
    drift = to_local(CENTRE, start.longitude, start.latitude)
    np.testing.assert_allclose(drift, [0.3 * seconds, -0.4 * seconds], rtol=0.02, atol=1e-6)


@pytest.mark.parametrize(
    ("more", "settings", "starts"),
    [
        ([], {"samples": 10}, [90]),
        ([fix(95)], {"samples": 10}, [90, 95]),
        ([], {"samples": 10, "surface_time": 600.0}, [690, 90]),
        ([], {}, [90]),
    ],
)
def test_the_plan_at_a_surfacing_where_the_log_ends_is_the_last_one_and_has_odds(
    more, settings, starts
):
    events = [fix(0), profile(10), fix(20, 50.0), fix(90), *more]
    found = planned(events, finds=True, concluded=True, when="surfacing", **settings)
    assert [time for time, *_ in found] == starts
    assert found[-1][2]


def test_a_group_counts_as_its_profiles_do():
    rng, names = np.random.default_rng(0), ("innovation", "residual", "prior_innovation")
    n = PROFILE.depth.size
    one_by_one, members = Sums(bins=3), []
    for nis in rng.random(5).tolist():
        values = {name: rng.standard_normal((n, 2)) for name in names}
        members.append(replace(UNUSED, nis=nis, dof=2 * n, accepted=True, **values))
        step = Step(PROFILE, None, None, members[-1], members[-1].residual)
        one_by_one = one_by_one.plus(Sums.of(step))
    squares = [float(sum(np.sum(getattr(each, name) ** 2) for each in members)) for name in names]
    nis, totals = sum(each.nis for each in members), GroupTotals(5 * n, *squares)
    group = replace(UNUSED, nis=nis, dof=10 * n, accepted=True, profiles=5, totals=totals)
    residuals = np.concatenate([each.residual for each in members])
    total = Sums(bins=3).plus(Sums.of(Step(PROFILE, None, None, group, residuals)))
    np.testing.assert_allclose(total, one_by_one, rtol=1e-12)
    assert np.isnan(Sums().rms_of("prior")["prior"])
