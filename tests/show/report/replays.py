"""Results of the sample log and of real dives, for pages in a browser."""

from pathlib import Path

import pytest

import replay_kit as rk
from tests.places import DATA, SAMPLES

DIVES = sorted(DATA.glob("seaglider/p17101*.nc"))


def sample(folder: Path) -> Path:
    """Return a result of the sample log with a plan."""
    settings = {"estimator": {"modes": 40}, "planner": {"samples": 10}}
    logs, out = (SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc"), folder / "sample.mcap"
    rk.replay(*logs, goal=(152.8, -40.1, 300.0), settings=settings, out=out)
    return out


def seaglider(folder: Path) -> Path:
    """Return a result of five real dives, with the sample's ensemble moved to them."""
    if not DIVES:
        pytest.skip("needs the Seaglider dives in ../shared/data")
    settings, out = {"estimator": {"modes": 20}, "forecast": {"place": True}}, folder / "dives.mcap"
    rk.replay(DIVES, SAMPLES / "ensemble.nc", settings=settings, out=out)
    return out
