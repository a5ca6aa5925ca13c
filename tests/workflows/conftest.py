"""An ocean with logs in it, and the result of a replay, made once for the tests that only read them."""

from pathlib import Path

import pytest

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig
from replay_kit.core.plan import Place
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.replay import replay
from tests.workflows.replay.interrupted import QUICK, job_in, make_ocean, truth_in


@pytest.fixture(scope="package")
def ocean(tmp_path_factory) -> Path:
    """A folder with an ensemble, the truth withheld from it, a glider's log of 45 pings and a vessel's of 40."""
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), RunConfig(), 45)
    make_twin(truth_in(folder, RunConfig()), Twin("vessel", 40, 0.05, 2), folder / "survey.mcap")
    return folder


@pytest.fixture(scope="package")
def run(tmp_path_factory) -> Path:
    """A folder with a log, an ensemble, and the result of a replay with a goal."""
    folder = make_ocean(tmp_path_factory.mktemp("run"), RunConfig(), 30)
    config = RunConfig(planner=PlannerConfig(kind="glide"), estimator=QUICK)
    replay(job_in(folder, folder / "out.mcap", Place(152.3, -39.8, 150.0)), config, planner_of)
    return folder
