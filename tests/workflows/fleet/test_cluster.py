"""Calls made by workers: their order, what they raise, and workers and schedulers that die or do not fit."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError, MeasurementError
from replay_kit.core.words.progress import called_by, each_call
from replay_kit.estimator import build
from replay_kit.workflows.fleet import cluster as clusters
from replay_kit.workflows.fleet.cluster import LostCallError, UnreachableError, open_workers
from tests import synthetic


def later(first, values, number):
    """Return a sum; of low numbers later than of others."""
    time.sleep(0.1 if number == 0 else 0.0)
    return first + float(values[2, 1]) + number


def refuse(number):
    if number == 1:
        raise MeasurementError("one is no number")
    return number


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
        found = list(each_call(later, ((0.5, large, number) for number in range(4))))
    assert found == [1002.5 + number for number in range(4)]


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


@pytest.mark.full
def test_a_call_that_kills_its_worker_is_made_again_and_given_up_and_others_are_made():
    with open_workers(None, 2) as workers:
        calls = [(number,) for number in range(4)]
        made = {number: (value, error) for number, value, error in workers.completed(die, calls)}
        assert isinstance(made.pop(1)[1], LostCallError)
        assert made == {number: (number, None) for number in (0, 2, 3)}
        with pytest.raises(MeasurementError, match="one is no number"):
            list(workers.starmap(refuse, [(0,), (1,)]))
    with open_workers(None, 1) as workers:
        # an interrupt of a worker ends no call
        assert list(workers.starmap(interrupted, [()])) == ["made"]


def test_a_scheduler_without_workers_is_given_up(monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(clusters, "TIMEOUT_S", 0.3)
    with (
        LocalCluster(n_workers=0, processes=False, dashboard_address=":0", protocol="tcp") as empty,
        pytest.raises(UnreachableError, match=r"no worker in 0.3 s; start one: dask worker"),
        open_workers(empty.scheduler_address, None),
    ):
        pass


def test_workers_are_asked_for_their_versions_and_what_they_see(
    scheduler, table, tmp_path, monkeypatch
):
    def asked(*files):
        with open_workers(scheduler, None, files, tmp_path):
            pass

    def refused(words, *files):
        with pytest.raises(ConfigError, match=words):
            asked(*files)

    def no(path):
        raise PermissionError(path)

    asked(table)
    refused(r"sees another file as .*gone.nc, or none", table, tmp_path / "gone.nc")
    # the command's own file, then that of the worker
    touches = iter((Path.touch, no))
    with monkeypatch.context() as patched:
        patched.setattr(Path, "touch", lambda path: next(touches)(path))
        refused(f"cannot write to {tmp_path}; choose a folder on")
    # the workers are threads of this process: what is asked first are the versions here
    versions = iter([{"replay-kit": "0.0.2"}, {"replay-kit": "0.0.1"}, {}])
    monkeypatch.setattr(clusters, "package_versions", lambda: next(versions))
    refused(r"tcp://.* has other versions, .*: replay-kit 0.0.1 \(here 0.0.2")
    assert not list(tmp_path.iterdir())
