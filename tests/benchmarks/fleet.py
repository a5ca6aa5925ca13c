"""A fleet of twins on two workers against one: wall time of all missions, and their bytes."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from replay_kit.config.run import RunConfig
from replay_kit.forecast import read_truth
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.fleet.cluster import Cluster, open_cluster
from replay_kit.workflows.fleet.missions import FleetTable, Mission, missions_of
from replay_kit.workflows.fleet.run import run_fleet, run_mission
from tests import synthetic
from tests.benchmarks.measure import Row, row, seconds
from tests.places import SAMPLES

# Missions, pings and modes of each.
_MISSIONS, _PINGS, _MODES = 40, 300, 60


def rows(tiny: bool) -> list[Row]:
    """Return the wall time of a fleet's missions on two workers beside one."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        count = _make(folder, tiny)
        with _workers(1, tiny) as one:
            alone_s, _ = seconds(lambda: _run(_missions(folder, "one"), one))
        with _workers(2, False) as two:
            both_s, _ = seconds(lambda: _run(_missions(folder, "two"), two))
        differing = _differing(folder, "one", "two")
    name, error = f"fleet of {count} twins, two workers", {"differing": differing}
    return [row(name, both_s, "one worker", alone_s, 1.85, error, missions=count)]


def _make(folder: Path, tiny: bool) -> int:
    """Write an ensemble and the twins' logs, and return how many there are."""
    if tiny:
        synthetic.write_ocean(folder, 6)
    else:
        for name in ("ensemble.nc", "truth.nc"):
            shutil.copy(SAMPLES / name, folder)
    truth = read_truth(str(folder / "truth.nc"), RunConfig().forecast)
    count, pings = (2, 4) if tiny else (_MISSIONS, _PINGS)
    for seed in range(count):
        make_twin(truth, Twin("vessel", pings, 0.05, seed), folder / f"twin{seed:02d}.mcap")
    return count


def _missions(folder: Path, out: str) -> tuple[Mission, ...]:
    settings = {"estimator": {"modes": _MODES}}
    table = FleetTable.model_validate(
        {"mission": [{"each": "twin*.mcap", "ensemble": "ensemble.nc", "settings": settings}]}
    )
    (folder / out / "basis").mkdir(parents=True)
    return missions_of(table, folder, None, folder / out)


@contextmanager
def _workers(count: int, here: bool) -> Iterator[Cluster | None]:
    """Yield workers that have replayed nothing but have begun; None for this process."""
    if here:
        yield None
        return
    with open_cluster(None, count) as cluster:
        cluster.on_each(_ready)
        yield cluster


def _ready() -> bool:
    import replay_kit.workflows.fleet.run  # noqa: F401

    return True


def _run(missions: tuple[Mission, ...], cluster: Cluster | None) -> None:
    outcomes = (
        [run_mission(mission) for mission in missions]
        if cluster is None
        else list(run_fleet(missions, cluster, False))[-1]
    )
    failed = [outcome.failed for outcome in outcomes if outcome.failed]
    assert not failed, failed


def _differing(folder: Path, one: str, other: str) -> int:
    """Return how many results of two runs of a fleet differ."""
    return sum(
        path.read_bytes() != (folder / other / path.name).read_bytes()
        for path in (folder / one).glob("*.mcap")
    )
