"""A short replay of the sample log, and its report."""

from pathlib import Path

import pytest

import replay_kit as rk
from replay_kit.show.report.pages import report_html
from tests.places import SAMPLES

SETTINGS = {
    "logs": {"end": "2018-11-16T07:00:00Z"},
    "forecast": {"levels": [5, 150, 500]},
    "estimator": {"modes": 10, "sample_share": 0.5, "shift_distance": 0.0},
    "output": {"depths": [5.0, 150.0], "interval": 7200.0},
    "planner": {"samples": 4, "when": "surfacing"},
}
GOAL = (153.05, -40.2, 150.0)


@pytest.fixture(scope="session")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> rk.Result:
    out = tmp_path_factory.mktemp("report") / "short.mcap"
    return rk.replay(
        SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc", goal=GOAL, settings=SETTINGS, out=out
    )


def page_of(replayed: rk.Result) -> str:
    return report_html(rk.open_result(replayed.path))


@pytest.fixture(scope="session")
def page(replayed: rk.Result) -> str:
    return page_of(replayed)


@pytest.fixture
def result_path(replayed: rk.Result) -> Path:
    return replayed.path
