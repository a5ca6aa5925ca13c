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
import pandas as pd
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
# Times of a forecast that changes, from the samples' own on [h].
_HOURS = (0.0, 24.0)


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
    """Return the samples' ensemble as a forecast of several times, at which each member is more and more another one."""
    with xr.open_dataset(_ENSEMBLE) as held:
        first = held.isel(member=slice(12)).load()
    begin = np.datetime64("2018-11-16T00:00:00", "ns")
    at = [
        (np.cos(turned) * first + np.sin(turned) * first.roll(member=1)).assign_coords(
            time=begin + np.timedelta64(round(hours * 3600), "s")
        )
        for hours, turned in zip(_HOURS, (0.0, 0.3), strict=True)
    ]
    found = xr.concat(at, "time")
    for name in found.variables:
        found[name].attrs.update(first[name].attrs if name in first.variables else {})
    return found


def _windowed(out: Path) -> None:
    """Return what a vessel's way through a wide sea gives, which no window holds whole."""
    members = synthetic.dataset(seed=3, n_members=13, shape=(14, 90), levels=np.array([5.0, 150.0]))
    truth = members.isel(member=12)
    sea = members.isel(member=slice(12))
    rows = []
    for k, column in enumerate(range(8, 36, 3)):
        here = truth.isel(lat=7, lon=column)
        for depth in (5.0, 150.0):
            u, v = (float(here[name].sel(depth=depth)) for name in ("uo", "vo"))
            time = np.datetime64("2018-11-16T00:00:00", "ns") + np.timedelta64(10 * k, "m")
            rows.append((time, float(here["lon"]), float(here["lat"]), depth, u, v, 0.05))
    table = pd.DataFrame(rows, columns=["time", "lon", "lat", "depth", "u", "v", "error"])
    settings = {"forecast": {"window_points": 250}, "estimator": {"modes": 4, "sample_share": 0.4}}
    rk.replay(table, sea, out=out, settings=settings)


if __name__ == "__main__":
    make(Path(sys.argv[1]))
