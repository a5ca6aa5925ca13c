"""Calls made by workers: their order, what they raise, and workers and schedulers that die."""

import os
import signal
import time

import dask
import numpy as np
import pytest

from replay_kit.core.errors import MeasurementError
from replay_kit.core.progress import called_by, each_call
from replay_kit.workflows.fleet.cluster import LostCallError, open_cluster
from replay_kit.workflows.fleet.expected import Expected, grown, in_all_s


def later(first, values, number):
    """Return a sum; of low numbers later than of others."""
    time.sleep(0.1 if number == 0 else 0.0)
    return first + float(values[2, 1]) + number


def refuse(number):
    if number == 1:
        raise MeasurementError("one is no number")
    return number


def die(number):
    os.kill(os.getpid(), signal.SIGKILL)


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


def test_growth_is_a_power_of_the_size_between_and_beyond_what_was_measured():
    measured = [(10.0, 1.0), (100.0, 100.0), (1000.0, 1000.0)]
    for size, expected in (
        (10.0, 1.0),
        (31.6227766, 10.0),
        (100.0, 100.0),
        (500.0, 500.0),
        (1e4, 1e4),
        (1.0, 0.01),
    ):
        assert grown(size, measured) == pytest.approx(expected)


def test_missions_are_given_to_whoever_is_free():
    each = [Expected("", 0, 0, 0, set_up, 1.0, 0.0) for set_up in (9.0, 2.0, 3.0, 1.0)]
    assert in_all_s(each, 1) == 19.0
    assert in_all_s(each, 2) == 10.0
    assert in_all_s(each, 4) == 10.0


@pytest.mark.full
def test_an_interrupt_ends_no_worker_and_none_holds_frames():
    with open_cluster(None, 1) as cluster:
        ((name, process),) = cluster.on_each(os.getpid).items()
        os.kill(process, signal.SIGINT)
        time.sleep(1.0)
        assert cluster.on_each(os.getpid) == {name: process}
        assert cluster.on_each(dask.config.get, "distributed.worker.profile.enabled") == {
            name: False
        }


@pytest.mark.full
def test_a_call_that_kills_its_workers_ends_with_an_error_and_others_are_made():
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        open_cluster(None, 2) as cluster,
    ):
        by_number = {number: error for number, _, error in cluster.completed(die, [(0,)])}
        assert isinstance(by_number[0], LostCallError)
        assert list(cluster.starmap(refuse, [(0,), (2,)])) == [0, 2]
