"""The values of a small run, as the tests of result files have them."""

from tests.results.conftest import (  # noqa: F401
    failed_plan,
    innovation,
    plan,
    result,
    run,
    state,
)
