"""What a replay's loop gives its estimator: mean currents go to those that take them, and are counted otherwise."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from replay_kit.config import RunConfig
from replay_kit.estimator.screening import rejected
from replay_kit.job import ReplayJob
from replay_kit.run import Run, handle, work_off
from replay_kit.tally import Stopwatch, Tally
from replay_kit.types import PathMean
from tests import synthetic

GRID = synthetic.ensemble(n_members=2).grid
PROFILE = synthetic.random_profiles(GRID, 1)[0]


class Recorder:
    """An estimator that notes what it is given."""

    def __init__(self, takes_paths):
        self.takes_paths = takes_paths

    def steps(self, state, measurements):
        for measurement in measurements:
            state = (*state, measurement)
            yield state, replace(rejected(PROFILE, PROFILE.flags, PROFILE.reasons), accepted=True)

    def misfit(self, state, measurement):
        return np.zeros((PROFILE.depth.size, 2))

    def flow(self, state):
        return None


def mean_current():
    two = np.array([1.0, 2.0])
    return PathMean(5, np.array([1, 4]), two, two, two, two / 3.0, (0.1, 0.2), 0.02, "dac", 1, PROFILE.source)


def given(takes_paths):
    estimator = Recorder(takes_paths)
    job = ReplayJob((Path("a"),), Path("b"))
    run = Run(estimator, None, None, job, RunConfig(), GRID.levels, Stopwatch(), Tally(), (), ())
    for event in (PROFILE, mean_current(), PROFILE):
        handle(run, event)
    work_off(run)
    return run


def test_an_estimator_that_takes_paths_is_given_them_in_order():
    run = given(True)
    assert [isinstance(each, PathMean) for each in run.state] == [False, True, False]
    assert run.positions[1] == (2.0, 2.0)
    assert run.tally.notes([]) == []


def test_another_is_not_and_the_report_counts_them():
    run = given(False)
    assert run.state == (PROFILE, PROFILE)
    assert run.tally.notes([]) == ["1 mean currents (dac): not used by this estimator"]
