"""The NetCDF files against the IOOS compliance checker, with the table of standard names that it ships."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

with warnings.catch_warnings():
    # of the checker's own dependencies
    warnings.simplefilter("ignore")
    from compliance_checker.base import Result
    from compliance_checker.suite import CheckSuite

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.lossless import save
from replay_kit.core.flow.netcdf import write_grid
from replay_kit.core.geodesy import to_local
from tests.core.flow.test_evolution import evolving


@pytest.fixture(scope="module")
def complaints() -> Callable[[Path], list[str]]:
    """Return a function that gives what the checker finds wrong in a file, errors and warnings of every weight."""
    CheckSuite.load_all_available_checkers()
    suite = CheckSuite()

    def check(path: Path) -> list[str]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            dataset = suite.load_dataset(str(path))
            groups, failed = suite.run_all(dataset, ["cf:1.8"])["cf:1.8"]
            dataset.close()
        assert not failed
        assert len(groups) > 20
        return [message for group in groups for message in messages(group)]

    return check


def messages(result: Result) -> list[str]:
    """Return what a check that did not pass says; one that passed may say how."""
    passed, total = (
        result.value if isinstance(result.value, tuple) else (int(bool(result.value)), 1)
    )
    own = result.msgs if passed < total and not result.children else []
    return [*own, *(message for child in result.children for message in messages(child))]


def regular(flow: FlowEstimate) -> FlowEstimate:
    """Return a flow on a grid of meridians and parallels."""
    longitude, latitude = np.meshgrid(np.linspace(4.8, 5.2, 7), np.linspace(61.9, 62.1, 5))
    east, north = to_local(flow.grid.projection, longitude, latitude)
    grid = replace(flow.grid, longitude=longitude, latitude=latitude, east=east, north=north)
    return replace(flow, grid=grid, horizontal=flow.horizontal.at_nodes(grid.nodes))


@pytest.mark.parametrize("n_modes", [0, 4])
@pytest.mark.parametrize("time_ns", [None, 1_700_000_000_123_456_789])
def test_a_grid_is_compliant(
    make_flow, tmp_path: Path, complaints, n_modes: int, time_ns: int | None
) -> None:
    write_grid(regular(replace(make_flow(n_modes=n_modes), time_ns=time_ns)), tmp_path / "grid.nc")
    assert complaints(tmp_path / "grid.nc") == []


def test_a_curvilinear_grid_is_compliant_but_for_the_names_of_its_dimensions(
    make_flow, tmp_path: Path, complaints
) -> None:
    """CF recommends depth before the two dimensions of a curvilinear grid; the checker takes them for other ones."""
    write_grid(make_flow(), tmp_path / "grid.nc")
    found = complaints(tmp_path / "grid.nc")
    assert len(found) == 4
    assert all("depth (Z), y (A), x (A)" in message for message in found)


@pytest.mark.parametrize("n_modes", [0, 4])
@pytest.mark.parametrize("time_ns", [None, 1_700_000_000_123_456_789])
def test_a_saved_estimate_is_compliant(
    make_flow, tmp_path: Path, complaints, n_modes: int, time_ns: int | None
) -> None:
    save(replace(make_flow(n_modes=n_modes), time_ns=time_ns), tmp_path / "flow.nc")
    assert complaints(tmp_path / "flow.nc") == []


def test_a_saved_estimate_that_changes_with_time_is_compliant(tmp_path: Path, complaints) -> None:
    save(evolving(), tmp_path / "flow.nc")
    assert complaints(tmp_path / "flow.nc") == []
