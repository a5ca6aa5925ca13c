"""A small ocean with a log of a glider in it, and replays that are stopped after some messages."""

from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest

from replay_kit.forecast import read_truth
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.replay.run import Run
from replay_kit.workflows.verify import verify
from tests import synthetic

#: Settings of an estimator that is made at once: few modes, and a prior that is not fitted.
QUICK = {"modes": 6, "sample_share": 0.5, "shift_distance": 0.0}


class Killed(BaseException):
    """What stops a run in these tests and no code of the project knows."""


def make_ocean(folder: Path, config, n_pings: int, shape=(6, 7)) -> Path:
    """A folder with an ensemble, the truth withheld from it, and a glider's log; ``truth_in`` reads the truth."""
    synthetic.write_ocean(folder, 12, shape)
    make_twin(truth_in(folder, config), Twin("glider", n_pings, 0.05, 1), folder / "glider.mcap")
    return folder


def truth_in(folder: Path, config):
    return read_truth(str(folder / "truth.nc"), config.forecast)


def job_in(ocean: Path, out=None, goal=None, logs=("glider.mcap",), **more) -> ReplayJob:
    """The replay of some of the logs of an ocean."""
    more = {"ensemble": ocean / "ensemble.nc", "overwrite": True} | more
    return ReplayJob(tuple(ocean / log for log in logs), out=out, goal=goal, **more)


def run_until(job, config, stop_after):
    """The replay of a job; stopped by ``Killed`` after some messages, if a number is given."""
    seen, take = 0, Run.take

    def taken(run, messages):
        nonlocal seen
        take(run, messages)
        seen += len(messages)
        if stop_after is not None and seen >= stop_after:
            raise Killed

    with mock.patch.object(Run, "take", taken):
        return replay(job, config, planner_of)


def often(config):
    """The settings of a run that keeps a state every ten minutes of its log."""
    output = config.output.model_copy(update={"checkpoint_interval": 600.0})
    return config.model_copy(update={"output": output})


def goes_on(job: ReplayJob, config, *stops: int):
    """The summary of a run that was stopped after so many messages each time: its bytes are a whole run's, and are verified."""
    whole, _ = run_until(job, config, None)
    again = replace(
        job, out=job.out.with_name("again.mcap"), checkpoint=job.out.with_name("run.ck")
    )
    for stop_after in stops:
        with pytest.raises(Killed):
            run_until(again, config, stop_after)
        assert again.checkpoint.exists()
        assert not again.out.exists()
    summary, _ = run_until(again, config, None)
    assert not again.checkpoint.exists()
    assert again.out.read_bytes() == job.out.read_bytes()
    # as text, because what a run without a goal does not know is NaN
    for name in ("by_dive", "messages", "truth"):
        assert repr(getattr(summary, name)) == repr(getattr(whole, name))
    verdict = verify(again.out, [path.parent for path in (*job.logs, job.ensemble)], planner_of)
    assert verdict.same, verdict
    return summary
