"""A small fleet for tests: an ensemble, twins of a few pings, and the table that names them."""

from pathlib import Path

from replay_kit.config.run import RunConfig
from replay_kit.forecast import read_truth
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.fleet.missions import Mission, load_fleet, missions_of
from tests import synthetic

TABLE = """
[all]
ensemble = "ensemble.nc"
truth = "truth.nc"
[all.settings]
estimator = { modes = 4, sample_share = 0.5, shift_distance = 0.0 }
output.depths = [5.0]

[[mission]]
each = "twin*.mcap"
"""


def make_fleet(folder: Path, count: int, pings: int = 6) -> Path:
    """Write the files of a fleet of so many missions into a folder, and return its table."""
    synthetic.write_ocean(folder, 6)
    truth = read_truth(str(folder / "truth.nc"), RunConfig().forecast)
    for seed in range(count):
        make_twin(truth, Twin("vessel", pings, 0.05, seed), folder / f"twin{seed:02d}.mcap")
    (folder / "fleet.toml").write_text(TABLE)
    return folder / "fleet.toml"


def missions_in(table: Path, out: Path) -> tuple[Mission, ...]:
    """Return the missions of a table, their results in a folder that is made."""
    out.mkdir(exist_ok=True)
    return missions_of(load_fleet(table), table.parent, None, out)
