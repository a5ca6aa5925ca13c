"""Results of the sample log and of real dives, for pages in a browser."""

import subprocess
import sys
from pathlib import Path

import pytest

import replay_kit as rk
from replay_kit.config.run import ForecastConfig
from replay_kit.forecast import read_truth
from replay_kit.studies.twins.make import Twin, make_twin
from tests.places import DATA, ROOT, SAMPLES

# The resident memory that the kernel remembers of a process is, unlike that of ``getrusage``, not its parent's before it.
_MEASURED = """
import sys
from replay_kit.cli.app import main
peak = sys.argv.pop(1)
try:
    main()
finally:
    open(peak, "w").write(open("/proc/self/status").read())
"""
DIVES = sorted(DATA.glob("seaglider/p17101*.nc"))


def peak_of_report(result: Path, page: Path) -> int:
    """Write a page with the command, and return the peak of its memory [kB]."""
    peak = page.with_suffix(".peak")
    command = [sys.executable, "-c", _MEASURED, str(peak), "report", str(result), "-o", str(page)]
    assert subprocess.run(command, cwd=ROOT, check=False).returncode == 0
    (line,) = (line for line in peak.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1])


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


def month(folder: Path) -> Path:
    """Return a result of 30 days with a ping every ten minutes."""
    log, out = folder / "twin.mcap", folder / "month.mcap"
    make_twin(
        read_truth(str(SAMPLES / "truth.nc"), ForecastConfig()), Twin("glider", 4320, 0.05, 3), log
    )
    settings = {"estimator": {"modes": 10}, "forecast": {"levels": [5, 150, 500]}}
    rk.replay(log, SAMPLES / "ensemble.nc", settings=settings, out=out)
    return out
