"""A small page of every kind that the program makes."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from replay_kit.show.notebook import read_result
from replay_kit.show.report.pages import report_html
from replay_kit.show.status.page import status_page
from replay_kit.show.status.status import status_of
from tests import synthetic
from tests.command import succeed
from tests.results.cases import write
from tests.show.status.held_samples import held
from tests.synthetic_flow import synthetic_flow

#: Makes a page, of files in a folder and of the fixtures of a request.
Make = Callable[[Path, pytest.FixtureRequest], str]


def _report(folder: Path, request: pytest.FixtureRequest) -> str:
    innovation = request.getfixturevalue("innovation")
    innovations = [replace(innovation, dive=k + 1) for k in range(4)]
    write(folder / "result.mcap", synthetic_flow(), innovations, request.getfixturevalue("plan"))
    return report_html(read_result(folder / "result.mcap"))


def _paper(folder: Path, request: pytest.FixtureRequest) -> str:
    synthetic.write_ocean(folder, 5)
    small = "--leave-out 1 --levels 5,150 --modes 4 --pairs 1"
    # the page names its inputs as they are given
    with contextlib.chdir(folder):
        succeed(f"experiment paper --ensemble ensemble.nc {small} -o paper")
    return (folder / "paper" / "index.html").read_text(encoding="utf-8")


#: By the folder of the module that makes it.
QUICK: dict[str, Make] = {
    "show/report": _report,
    "show/status": lambda folder, request: status_page(status_of(held())),
}
#: Those that take long to make.
SLOW: dict[str, Make] = {"studies/paper": _paper}
