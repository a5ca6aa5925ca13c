"""A small page of every kind that the program makes."""

import contextlib
from collections.abc import Callable
from pathlib import Path

import pytest

from replay_kit.show.report.pages import report_html
from replay_kit.show.status.lines import status_page
from replay_kit.show.status.status import status_of
from replay_kit.workflows.fleet.page import fleet_page
from replay_kit.workflows.fleet.run import Outcome
from tests import synthetic
from tests.command import succeed
from tests.show.status.held_samples import held

#: Makes a page, of files in a folder and of the fixtures of a request.
Make = Callable[[Path, pytest.FixtureRequest], str]


def _paper(folder: Path, request: pytest.FixtureRequest) -> str:
    synthetic.write_ocean(folder, 5)
    small = "--leave-out 1 --levels 5,150 --modes 4 --pairs 1"
    # the page names its inputs as they are given
    with contextlib.chdir(folder):
        succeed(f"experiment paper --ensemble ensemble.nc {small} -o paper")
    return (folder / "paper" / "index.html").read_text(encoding="utf-8")


def _fleet(folder: Path, request: pytest.FixtureRequest) -> str:
    answer = {
        "status": "done",
        "observations": {"used": 40, "rejected": 1},
        "by_dive": [{}, {}],
        "rms_innovation": {"prior": 0.1, "before": 0.09},
        "nis_per_dof": 1.1,
        "seconds_in_all": 3.0,
    }
    done = [Outcome(f"glider-{name}", answer) for name in "abcd"]
    return fleet_page([*done, Outcome("lost", failed="no log", exit_code=3)])


#: By the folder of the module that makes it.
QUICK: dict[str, Make] = {
    "show/report": lambda folder, request: report_html(request.getfixturevalue("contents").result),
    "show/status": lambda folder, request: status_page(status_of(held())),
    "workflows/fleet": _fleet,
}
#: Those that take long to make.
SLOW: dict[str, Make] = {"studies/paper": _paper}
