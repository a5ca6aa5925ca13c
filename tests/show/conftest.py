"""The values of a small run, as the tests of result files have them."""

from dataclasses import replace

import pytest

from tests.results.cases import write
from tests.results.conftest import (  # noqa: F401
    failed_plan,
    innovation,
    plan,
    result,
    run,
    state,
)
from tests.synthetic_flow import synthetic_flow


@pytest.fixture
def contents(tmp_path, innovation, plan):  # noqa: F811
    """A result of four dives with a plan."""
    innovations = [replace(innovation, dive=k + 1) for k in range(4)]
    return write(tmp_path / "whole.mcap", synthetic_flow(), innovations, plan)
