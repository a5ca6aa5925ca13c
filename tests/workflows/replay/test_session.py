"""What a replay's loop gives its estimator: mean currents go to those that take them, and are counted otherwise."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.observation import PathMean
from replay_kit.estimator import Estimator, Stepped
from replay_kit.estimator.update.screening import unused_innovation
from replay_kit.workflows.replay.session import Session
from tests import synthetic
from tests.benchmarks.windows import QUICK, TINY, mission, sea, windowed

GRID = synthetic.ensemble(n_members=2).grid
PROFILE = synthetic.random_profiles(GRID, 1)[0]


class Recorder(Estimator):
    """An estimator that notes what it is given."""

    def __init__(self, supports_path_means):
        self.supports_path_means = supports_path_means

    def initial(self):
        return ()

    def assimilate(self, state, block):
        unused = unused_innovation(PROFILE, PROFILE.flags, PROFILE.reasons)
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
    session = Session(Recorder(supports_path_means), RunConfig())
    session.take_message(0, [(each, ()) for each in (PROFILE, mean_current(), PROFILE)])
    session.shared.assimilate()
    return session.state


class Published:
    """A result that notes when grids and digests are written."""

    def __init__(self):
        self.grids_ns, self.digests_ns = [], []

    def of(self, vehicle):
        return nullcontext()

    def innovations(self, block):
        pass

    def grids(self, now_ns, flow, depths):
        self.grids_ns.append(now_ns)

    def digest(self, now_ns):
        self.digests_ns.append(now_ns)


def test_grids_and_digests_come_with_the_first_profile_and_then_at_the_interval_after_the_last_ones():
    config = RunConfig(output={"interval": 60.0, "depths": (10.0,)})
    published, estimator = Published(), Recorder(False)
    estimator.flow = lambda state: SimpleNamespace(levels=GRID.levels)
    session = Session(estimator, config)
    session.writer = published
    for seconds in range(0, 250, 25):
        ping = replace(PROFILE, time_ns=seconds * 10**9)
        session.take_message(ping.time_ns, [(ping, ())])
    session.shared.assimilate()
    assert (
        published.grids_ns
        == published.digests_ns
        == [seconds * 10**9 for seconds in (0, 75, 150, 225)]
    )


def test_windows_that_were_left_are_published_once_and_forgotten():
    of = sea(TINY)
    pings = mission(of, TINY, of.part(None, slice(TINY.members, None)), 25_000.0)
    session = Session(windowed(of, TINY, pings[0], 25_000.0, QUICK), RunConfig())
    session.writer = MagicMock()
    for ping in pings:
        session.take_message(ping.time_ns, [(ping, ())])
        of = session.state.estimation
        assert of.current.left == of.dive_start.left == ()
    session.shared.assimilate(last=True)
    numbers = [call.args[0] for call in session.writer.window.call_args_list]
    assert numbers == list(range(1, session.estimation.current.number))
    assert len(numbers) > 1


def test_an_estimator_that_supports_path_means_is_given_them_in_order():
    run = given(True)
    assert [isinstance(each, PathMean) for each in run.estimation.current] == [False, True, False]
    assert run.statistics.profiles.positions[1] == (2.0, 2.0)
    assert run.statistics.notes([]) == []


def test_another_is_not_and_the_report_counts_them():
    run = given(False)
    assert run.estimation.current == (PROFILE, PROFILE)
    assert run.statistics.notes([]) == ["1 mean currents (dac): not supported by this estimator"]
