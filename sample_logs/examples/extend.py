"""Four additions, each in one or two places, to a copy of the program: python sample_logs/examples/extend.py FOLDER.

A dialect of glider files, a check of pings, a section of the report and an objective of missions are added as the READMEs of their
folders say, and then used.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import xarray as xr

SAMPLES = Path(__file__).resolve().parents[1]

DIALECT = """# EGO, the French gliders' form.
_EGO = Dialect(
    "ego",
    "EGO",
    "juld current_east current_north",
    {
        "time": "juld",
        "longitude": "longitude",
        "latitude": "latitude",
        "depth": "glider_depth",
        "dive": "phase_number",
        "dac_east": "current_east",
        "dac_north": "current_north",
    },
)

"""
CHECK = '''"""Pings whose time repeats: the clock of the instrument stands still."""

from dataclasses import dataclass
from typing import Self

from replay_kit.core.errors import Finding
from replay_kit.core.observation import Observation
from replay_kit.measurements.consistency.summary import PingSummary


@dataclass(frozen=True, slots=True)
class RepeatedTimes:
    """How many pings in a row have one time."""

    last_ns: int = -1
    repeated: int = 0

    def after(self, ping: Observation, summary: PingSummary) -> Self:
        """Return the count after a ping."""
        return type(self)(ping.time_ns, self.repeated + 1 if ping.time_ns == self.last_ns else 0)

    def found(self, ping: Observation, named: frozenset[str]) -> Finding | None:
        """Return that the clock stands still."""
        if self.repeated < 3:
            return None
        evidence = f"{self.repeated} pings of one time"
        return Finding("clock stands still", ping.time_ns, evidence, "a stopped clock", "mend the log", distrusts=True)
'''
SECTION = '''"""How deep the vehicle went."""

import numpy as np

from replay_kit.show.page.section import Section
from replay_kit.results.views.contents import Contents


def depths_section(contents: Contents) -> Section:
    """Return the deepest position in words."""
    return Section("depths", "Depths", f"<p>The deepest position lies at {np.nanmax(contents.track.depth):.0f} m.</p>")
'''
# each surfacing is a risk
OBJECTIVE = """    "surfacings": Objective(Weights(time=1.0), lambda found: float(len(found.yo_depths))),
"""
# Of each addition the files, a line of each and what stands there then; a file without a line is new.
ADDITIONS = (
    ("replay_kit/logs/glider/dialects.py", "#: All dialects", f"{DIALECT}#: All dialects"),
    ("replay_kit/logs/glider/dialects.py", "    _OG1,\n", "    _OG1,\n    _EGO,\n"),
    ("replay_kit/measurements/consistency/repeated_times.py", "", CHECK),
    (
        "replay_kit/measurements/consistency/checks.py",
        "from replay_kit.measurements.consistency.summary",
        "from replay_kit.measurements.consistency.repeated_times import RepeatedTimes\n"
        "from replay_kit.measurements.consistency.summary",
    ),
    (
        "replay_kit/measurements/consistency/checks.py",
        "= (DepthCounts(), ",
        "= (RepeatedTimes(), DepthCounts(), ",
    ),
    ("replay_kit/show/report/sections/depths.py", "", SECTION),
    (
        "replay_kit/show/report/page.py",
        "_LISTED = (\n",
        '_LISTED = (\n    "depths:depths_section",\n',
    ),
    ("planners/mission/values.py", '    "energy": ', f'{OBJECTIVE}    "energy": '),
    ("replay_kit/core/objective.py", '"closest"]', '"closest", "surfacings"]'),
)


def add(folder: Path) -> None:
    """Copy the packages and add to the copy."""
    for package in ("replay_kit", "planners"):
        shutil.copytree(
            SAMPLES.parent / package, folder / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name, before, after in ADDITIONS:
        text = (folder / name).read_text() if before else ""
        assert not before or text.count(before) == 1, f"{name}: expected one line {before!r}"
        (folder / name).write_text(text.replace(before, after) if before else after)


def use(folder: Path) -> None:
    """Run the copy: read a file of the new dialect, and see the section and the objective."""
    rename = {
        "TIME": "JULD",
        "DEPTH": "GLIDER_DEPTH",
        "DIVE_NUMBER": "PHASE_NUMBER",
        "WATERCURRENTS_U": "CURRENT_EAST",
    }
    rows = xr.open_dataset(folder / "og1.nc").rename({**rename, "WATERCURRENTS_V": "CURRENT_NORTH"})
    rows.attrs["Conventions"] = "EGO-1.2"
    rows.drop_vars([name for name in rows if str(name).endswith("_GPS")]).to_netcdf(
        folder / "ego.nc", engine="h5netcdf"
    )
    estimate = ["--ensemble", str(SAMPLES / "ensemble.nc"), "--levels", "5,150", "--modes", "6"]
    for words in (
        ["info", "ego.nc"],
        ["replay", str(SAMPLES / "survey.mcap"), *estimate, "-o", "survey.mcap", "--report"],
        [
            "plan",
            "survey.mcap",
            "--start=152.4,-40.2,0",
            "--goal=152.45,-40.18,0",
            "--depth",
            "100",
            "--objective",
            "surfacings",
        ],
    ):
        subprocess.run(
            [sys.executable, "-m", "replay_kit", *words],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(folder)},
            check=True,
        )
    print(
        "the report has the section:",
        "The deepest position lies at" in (folder / "survey.html").read_text(encoding="utf-8"),
    )


if __name__ == "__main__":
    where = Path(sys.argv[1])
    add(where)
    use(where)
