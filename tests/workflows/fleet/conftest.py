"""A fleet and its workers: threads of this process, which take no time to begin; tests of killed workers make processes."""

import pytest

from replay_kit.workflows.fleet.cluster import open_workers
from tests.workflows.fleet.missions import make_fleet


@pytest.fixture(scope="package")
def table(tmp_path_factory):
    return make_fleet(tmp_path_factory.mktemp("fleet"), 2)


@pytest.fixture(scope="package")
def scheduler():
    from distributed import LocalCluster

    made = LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0", protocol="tcp"
    )
    yield made.scheduler_address
    made.close()


@pytest.fixture(scope="package")
def cluster(scheduler):
    with open_workers(scheduler, None) as opened:
        yield opened
