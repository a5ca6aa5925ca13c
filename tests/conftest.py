"""What holds for every test: one BLAS thread a worker, no judgement by the clock, and a small synthetic flow."""

import os

# Before numpy is imported, which reads them once: a plugin of zarr for pytest that imports it is left out in `pyproject.toml`.
# The workers divide the cores, so that more threads would only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gc

import pytest
from cyclopts import App
from hypothesis import HealthCheck, settings

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.estimator.prior import fit
from tests.remembered import assemble_argument_collection, score_member
from tests.synthetic_flow import synthetic_flow

# how long an example takes is the machine's affair
settings.register_profile("unhurried", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("unhurried")


def pytest_collection_finish():
    """Let the collector of garbage pass over what is there for good: modules and tests, a million objects that it would look through."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


@pytest.fixture(scope="session")
def make_flow():
    return synthetic_flow


@pytest.fixture
def flow() -> FlowEstimate:
    return synthetic_flow()


@pytest.fixture(scope="session", autouse=True)
def _what_tests_share_is_made_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(App, "assemble_argument_collection", assemble_argument_collection)
        patch.setattr(fit, "_score_member", score_member)
        yield
