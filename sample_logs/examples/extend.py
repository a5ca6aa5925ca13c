"""The package beside this script installed and used: python sample_logs/examples/extend.py FOLDER.

``extension`` adds a dialect of glider files, an estimator, a check of pings, a section of the report and an objective of missions. It is
installed into the folder, so that the Python environment stays as it is.
"""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import xarray as xr

SAMPLES = Path(__file__).resolve().parents[1]
EXTENSION = Path(__file__).resolve().parent / "extension"


def install(folder: Path) -> None:
    """Install the package into a folder: with the build tool of this environment, or else with one that pip fetches."""
    words = ["--quiet", "--no-deps", "--disable-pip-version-check"]
    if find_spec("hatchling"):
        words.append("--no-build-isolation")
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *words, "--target", str(folder), str(EXTENSION)],
        check=True,
    )


def use(folder: Path) -> None:
    """Run the program with the package: read a file of the new dialect, and see the section and the objective."""
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
    replay = ["replay", str(SAMPLES / "survey.mcap")]
    estimate = ["--ensemble", str(SAMPLES / "ensemble.nc"), "--levels", "5,150", "--modes", "6"]
    paths = [str(folder / "installed"), str(SAMPLES.parent)]
    for words in (
        ["info", "ego.nc"],
        [*replay, *estimate, "-o", "survey.mcap", "--report"],
        [*replay, *estimate, "--estimator", "closest", "-o", "closest.mcap"],
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
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            check=True,
        )
    print(
        "the report has the section:",
        "The deepest position lies at" in (folder / "survey.html").read_text(encoding="utf-8"),
    )


if __name__ == "__main__":
    where = Path(sys.argv[1]).resolve()
    install(where / "installed")
    use(where)
