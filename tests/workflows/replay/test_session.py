"""What a replay's loop gives its estimator: mean currents go to those that take them, and are counted otherwise."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.observation import GroupTotals, PathMean
from replay_kit.estimator import Estimator, Stepped
from replay_kit.estimator.update.screening import screened
from replay_kit.workflows.replay.stages.counts import Sums
from tests import synthetic
from tests.benchmarks.windows import QUICK, TINY, mission, sea, windowed
from tests.workflows.replay.given import fed, run_of

GRID = synthetic.ensemble(n_members=2).grid
PROFILE = synthetic.random_profiles(GRID, 1)[0]


class Recorder(Estimator):
    """An estimator that notes what it is given."""

    def __init__(self, supports_path_means):
        self.supports_path_means = supports_path_means

    def initial(self):
        return ()

    def assimilate(self, state, block):
        unused = screened([PROFILE], GRID)[0][0].unused(0)
        done = []
        for measurement in block:
            before, state = state, (*state, measurement)
            done.append(Stepped(measurement, before, state, replace(unused, accepted=True)))
        return state, done

    def innovation(self, state, measurement):
        return np.zeros((PROFILE.depth.size, 2))

    def flow(self, state):
        return None


def mean_current():
    two = np.array([1.0, 2.0])
    return PathMean(
        5, np.array([1, 4]), two, two, two, two / 3.0, (0.1, 0.2), 0.02, "dac", 1, PROFILE.source
    )


def given(supports_path_means):
    return fed(run_of(Recorder(supports_path_means)), [PROFILE, mean_current(), PROFILE])


class Published:
    """A result that notes when grids and digests are written."""

    def __init__(self):
        self.grids_ns, self.digests_ns = [], []

    def of(self, vehicle):
        return nullcontext()

    def innovations(self, found):
        pass

    def grids(self, now_ns, flow, depths):
        self.grids_ns.append(now_ns)

    def digest(self, now_ns):
        self.digests_ns.append(now_ns)


def test_grids_and_digests_come_with_the_first_profile_and_then_at_the_interval_after_the_last_ones():
    config = RunConfig(output={"interval": 60.0, "depths": (10.0,)})
    published, estimator = Published(), Recorder(False)
    estimator.flow = lambda state: SimpleNamespace(levels=GRID.levels)
    run = run_of(estimator, config)
    run.writer = published
    fed(run, [replace(PROFILE, time_ns=seconds * 10**9) for seconds in range(0, 250, 25)])
    assert (
        published.grids_ns
        == published.digests_ns
        == [seconds * 10**9 for seconds in (0, 75, 150, 225)]
    )


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


def test_an_estimator_that_supports_path_means_is_given_them_in_order():
    run = given(True)
    assert [isinstance(each, PathMean) for each in run.current] == [False, True, False]
    assert run.of[0].counts.notes() == []


def test_another_is_not_and_the_report_counts_them():
    run = given(False)
    assert [len(each) for each in run.current] == [1, 1]
    assert run.of[0].counts.unsupported == {"dac": 1}


def test_a_group_counts_as_its_profiles_do():
    rng, names = np.random.default_rng(0), ("innovation", "residual", "prior_innovation")
    unused, n = screened([PROFILE], GRID)[0][0].unused(0), PROFILE.depth.size
    one_by_one, members = Sums(bins=3), []
    for nis in rng.random(5).tolist():
        values = {name: rng.standard_normal((n, 2)) for name in names}
        members.append(replace(unused, nis=nis, dof=2 * n, accepted=True, **values))
        one_by_one = one_by_one.with_profile(members[-1], members[-1].residual)
    squares = [float(sum(np.sum(getattr(each, name) ** 2) for each in members)) for name in names]
    nis, totals = sum(each.nis for each in members), GroupTotals(5 * n, *squares)
    group = replace(unused, nis=nis, dof=10 * n, accepted=True, profiles=5, totals=totals)
    total = Sums(bins=3).with_profile(group, np.concatenate([each.residual for each in members]))
    np.testing.assert_allclose(total, one_by_one, rtol=1e-12)
    assert total.rms_of("before")["before"] == np.sqrt(total.before / (10 * n))
    assert np.isnan(Sums().rms_of("prior")["prior"])
