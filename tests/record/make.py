"""Makes the files of ``files/``, as the version that writes them does: small logs, few modes, all through public functions.

The files of another version differ; those kept are of 0.3.0, and ``record.py`` holds their digests.
"""

import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import xarray as xr

import replay_kit as rk
from tests import synthetic
from tests.command import succeed
from tests.places import SAMPLES

_FEW: Mapping[str, Any] = {
    "forecast": {"levels": [5, 300]},
    "estimator": {"modes": 4},
    "output": {"interval": 1e6, "depths": [100]},
}
_ENSEMBLE, _TRUTH = SAMPLES / "ensemble.nc", SAMPLES / "truth.nc"
_GOAL = (152.7, -40.1, 0.0)
# By what a member turns into another one in a day [rad].
_TURNED = 0.3


def make(folder: Path) -> None:
    """Write results and estimates into a folder."""
    with TemporaryDirectory() as scratch:
        logs = _logs(Path(scratch))
        survey = _replayed(logs["survey"], _ENSEMBLE, folder / "survey.mcap")
        survey.estimate.save(folder / "static.nc")
        planner = {"when": "surfacing", "samples": 10, "depth": 300.0}
        _replayed(logs["sg1"], _ENSEMBLE, folder / "glider.mcap", _GOAL, planner=planner)
        only = {"without": ["profiles"]}
        _replayed(logs["sg1"], _ENSEMBLE, folder / "mean_currents.mcap", measurements=only)
        three = {name: logs[name] for name in ("sg1", "sg2", "sg3")}
        _replayed(three, _ENSEMBLE, folder / "three_vehicles.mcap")
        changing = _replayed(logs["survey"], _changing(), Path(scratch) / "changing.mcap")
        changing.estimate.save(folder / "through_time.nc")
        _windowed(Path(scratch) / "windowed.mcap")
        shutil.copy(Path(scratch) / "windowed.mcap", folder)
        modes = {"forecast": {"levels": [5, 150, 500]}, "estimator": {"modes": 60}}
        whole = rk.replay(SAMPLES / "survey.mcap", _ENSEMBLE, settings=modes)
        whole.estimate.mean_flow().save(folder / "missions_flow.nc")


def _logs(folder: Path) -> dict[str, Path]:
    """Write a vessel's log and those of three gliders, and return them by name."""
    found = {"survey": folder / "survey.mcap"}
    succeed(["twin", "--truth", str(_TRUTH), "--pings", "20", "-o", str(found["survey"])])
    for seed, name in enumerate(("sg1", "sg2", "sg3")):
        found[name] = folder / f"{name}.mcap"
        how = ["--vehicle", "glider", "--pings", "32", "--seed", str(seed)]
        succeed(["twin", "--truth", str(_TRUTH), *how, "-o", str(found[name])])
    return found


def _replayed(logs: Any, ensemble: Any, out: Path, goal: Any = None, **settings: Any) -> rk.Result:
    return rk.replay(logs, ensemble, out=out, goal=goal, settings={**_FEW, **settings})


def _changing() -> xr.Dataset:
    """Return members of the samples as a forecast of two times, at the second of which each is partly another one."""
    with xr.open_dataset(_ENSEMBLE) as held:
        first = held.isel(member=slice(12)).load()
    later = np.cos(_TURNED) * first + np.sin(_TURNED) * first.roll(member=1)
    begin = np.datetime64("2018-11-16T00:00:00", "ns")
    times = [begin, begin + np.timedelta64(1, "D")]
    both = (each.assign_coords(time=at) for each, at in zip((first, later), times, strict=True))
    found = xr.concat(both, "time")
    for name in first.variables:
        found[name].attrs.update(first[name].attrs)
    return found


def _windowed(out: Path) -> None:
    """Write what a vessel's way through a wide sea gives, which no window holds whole."""
    levels = np.array([5.0, 150.0])
    members = synthetic.dataset(seed=3, n_members=13, shape=(14, 90), levels=levels)
    truth, sea = members.isel(member=12, lat=7), members.isel(member=slice(12))
    profiles = []
    for k, column in enumerate(range(8, 36, 3)):
        here = truth.isel(lon=column)
        time_ns = 1_542_326_400_000_000_000 + k * 600_000_000_000
        place = time_ns, float(here["lon"]), float(here["lat"])
        u, v = here["uo"].values, here["vo"].values
        profiles.append(rk.Observation.profile(*place, levels, u, v, 0.05))
    settings = {"forecast": {"window_points": 250}, "estimator": {"modes": 4, "sample_share": 0.4}}
    rk.replay(profiles, sea, out=out, settings=settings)


if __name__ == "__main__":
    make(Path(sys.argv[1]))
