"""Calls made by workers: their order, what they raise, and workers and schedulers that die."""

import os
import signal
import time

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.words.progress import called_by, each_call
from replay_kit.estimator import build
from replay_kit.workflows.fleet.cluster import LostCallError, open_workers
from tests import synthetic
from tests.command import invoke


def later(first, values, number):
    """Return a sum; of low numbers later than of others."""
    time.sleep(0.1 if number == 0 else 0.0)
    return first + float(values[2, 1]) + number


def refuse(number):
    if number == 1:
        raise MeasurementError("one is no number")
    return number


CALLS = [(number,) for number in range(4)]


def die(number):
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def interrupted():
    os.kill(os.getpid(), signal.SIGINT)
    return "made"


def test_values_come_in_their_order(cluster):
    large = np.arange(100_000.0).reshape(100, 1000).T
    with called_by(cluster.starmap):
        assert list(each_call(later, ((0.5, large, number) for number in range(4)))) == [
            1002.5 + number for number in range(4)
        ]


def test_what_a_call_raises_is_raised_at_its_place(cluster):
    values = cluster.starmap(refuse, zip(range(3)))
    assert next(values) == 0
    with pytest.raises(MeasurementError, match="one is no number"):
        next(values)


def test_a_prior_fitted_by_workers_is_that_of_one_process(cluster):
    sea, modes = synthetic.ensemble(n_members=6, shape=(8, 9)), EstimatorConfig(modes=6)
    here = build([sea], modes).notes()
    with called_by(cluster.starmap):
        assert build([sea], modes).notes() == here


def test_studies_have_the_switch_for_workers():
    words = invoke("experiment paper --help").stdout.split()
    assert {"--scheduler", "--workers"} <= set(words)


@pytest.mark.full
def test_a_call_that_kills_its_worker_is_made_again_and_given_up_and_others_are_made():
    with open_workers(None, 2) as workers:
        made = {number: (value, error) for number, value, error in workers.completed(die, CALLS)}
        assert isinstance(made.pop(1)[1], LostCallError)
        assert made == {number: (number, None) for number in (0, 2, 3)}
        with pytest.raises(MeasurementError, match="one is no number"):
            list(workers.starmap(refuse, [(0,), (1,)]))


@pytest.mark.full
def test_an_interrupt_of_a_worker_ends_no_call():
    with open_workers(None, 1) as workers:
        assert list(workers.starmap(interrupted, [()])) == ["made"]
