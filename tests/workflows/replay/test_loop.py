"""What a replay's loop gives its estimator, its planner and its result, and when: with stand-ins that note what they are given."""

from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import GroupTotals, PathMean
from replay_kit.core.plan import Place
from replay_kit.estimator import Estimator, Stepped
from replay_kit.estimator.update.screening import screened
from replay_kit.workflows.replay.inputs.planner import PlanResult
from replay_kit.workflows.replay.plans import PlanningProblem
from replay_kit.workflows.replay.run import end
from replay_kit.workflows.replay.steps import Step, Sums
from tests import synthetic
from tests.benchmarks.windows import QUICK, TINY, mission, sea, windowed
from tests.planners.flow_samples import CENTRE, uniform_flow
from tests.workflows.replay.given import fed, position, run_of

FLOW = uniform_flow(0.3, -0.4)
PROFILE = synthetic.profile(FLOW.grid, 0.0, 0.0, np.array([10.0]), np.zeros((1, 2)))
UNUSED = screened([PROFILE], FLOW.grid)[0][0].unused(0)
SECOND = 10**9


class Recorder(Estimator):
    """An estimator that notes what it is given, and learns nothing."""

    def __init__(self, supports_path_means=False):
        self.supports_path_means = supports_path_means

    def initial(self):
        return ()

    def assimilate(self, state, block):
        done = []
        for measurement in block:
            before, state = state, (*state, measurement)
            done.append(Stepped(measurement, before, state, replace(UNUSED, accepted=True)))
        return state, done

    def innovation(self, state, measurement):
        return np.zeros((1, 2))

    def flow(self, state):
        return FLOW


class Asked:
    """A planner that notes when and from where it is asked; a plan of it has the number of those before."""

    def __init__(self, finds=True):
        self.finds, self.calls = finds, []

    def plan(self, flow, query):
        self.calls.append((query.start_time_ns / SECOND, query.start))
        if not self.finds:
            raise PlanError("nothing is planned here")
        plan = SimpleNamespace(start=query.start, start_time_ns=query.start_time_ns)
        return PlanResult(plan, None, len(self.calls))

    def with_odds(self):
        return self

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
    run = fed(run_of(Recorder(), config, problem), events)
    if concluded:
        end(run, run.of[0])
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
    assert [time for time, _ in planned(events, interval=100.0, **settings)] == times


@pytest.mark.parametrize("seconds", [0.0, 600.0, 3600.0])
def test_a_plan_at_a_surfacing_begins_where_the_current_takes_the_vehicle(seconds):
    events = [fix(0), fix(20, 50.0), fix(90), fix(95)]
    ((time, start),) = planned(events, when="surfacing", surface_time=seconds)
    assert (time, start.depth) == (90.0 + seconds, 0.0)
    drift = to_local(CENTRE, start.longitude, start.latitude)
    np.testing.assert_allclose(drift, [0.3 * seconds, -0.4 * seconds], rtol=0.02, atol=1e-6)


@pytest.mark.parametrize(
    ("more", "settings", "starts"),
    [
        ([], {"samples": 10}, [90]),
        ([fix(95)], {"samples": 10}, [90, 95]),
        ([], {"samples": 10, "surface_time": 600.0}, [690, 90]),
        ([], {}, [90, 90]),
    ],
)
def test_the_plan_at_a_surfacing_where_the_log_ends_is_the_last_one_if_it_has_odds(
    more, settings, starts
):
    events = [fix(0), profile(10), fix(20, 50.0), fix(90), *more]
    found = planned(events, finds=True, concluded=True, when="surfacing", **settings)
    assert [time for time, _ in found] == starts


def test_grids_and_digests_come_with_the_first_profile_and_then_at_the_interval_after_the_last_ones():
    run = run_of(Recorder(), RunConfig(output={"interval": 60.0, "depths": (10.0,)}))
    run.writer = MagicMock(of=lambda vehicle: nullcontext())
    fed(run, [profile(seconds) for seconds in range(0, 250, 25)])
    for written in (run.writer.grids, run.writer.digest):
        times = [call.args[0] / SECOND for call in written.call_args_list]
        assert times == [0, 75, 150, 225]


def test_windows_that_were_left_are_published_once_and_forgotten():
    of = sea(TINY)
    pings = mission(of, TINY, of.part(None, slice(TINY.members, None)), 25_000.0)
    run = run_of(windowed(of, TINY, pings[0], 25_000.0, QUICK))
    run.writer = MagicMock()
    for ping in pings:
        state = fed(run, [ping], last=False)
        assert state.current.left == state.of[0].dive.start.left == ()
    run.finish()
    numbers = [call.args[0] for call in run.writer.window.call_args_list]
    assert numbers == list(range(1, run.current.number))
    assert len(numbers) > 1


@pytest.mark.parametrize(("supports", "unsupported"), [(True, {}), (False, {"dac": 1})])
def test_an_estimator_that_supports_path_means_is_given_them_in_order_and_they_are_counted_otherwise(
    supports, unsupported
):
    two = np.array([1.0, 2.0])
    values = two, two, two, two / 3.0, (0.1, 0.2), 0.02, "dac", 1, PROFILE.source
    events = [PROFILE, PathMean(5, np.array([1, 4]), *values), PROFILE]
    run = fed(run_of(Recorder(supports)), events)
    given = [isinstance(each, PathMean) for each in run.current]
    assert given == ([False, True, False] if supports else [False, False])
    assert run.of[0].counts.unsupported == unsupported


step_of = partial(Step, PROFILE, None, None)


def test_a_group_counts_as_its_profiles_do():
    rng, names = np.random.default_rng(0), ("innovation", "residual", "prior_innovation")
    n = PROFILE.depth.size
    one_by_one, members = Sums(bins=3), []
    for nis in rng.random(5).tolist():
        values = {name: rng.standard_normal((n, 2)) for name in names}
        members.append(replace(UNUSED, nis=nis, dof=2 * n, accepted=True, **values))
        one_by_one = one_by_one.plus(Sums.of(step_of(members[-1], members[-1].residual)))
    squares = [float(sum(np.sum(getattr(each, name) ** 2) for each in members)) for name in names]
    nis, totals = sum(each.nis for each in members), GroupTotals(5 * n, *squares)
    group = replace(UNUSED, nis=nis, dof=10 * n, accepted=True, profiles=5, totals=totals)
    residuals = np.concatenate([each.residual for each in members])
    total = Sums(bins=3).plus(Sums.of(step_of(group, residuals)))
    np.testing.assert_allclose(total, one_by_one, rtol=1e-12)
    assert total.rms_of("before")["before"] == np.sqrt(total.before / (10 * n))
    assert np.isnan(Sums().rms_of("prior")["prior"])
