"""What is read of the files of 0.3: an estimate's currents, a result's tables, what the commands report and export of it."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

import replay_kit as rk
from replay_kit.core.errors import ForecastError
from tests.command import succeed
from tests.record.record import FILES, checked

#: The files by their names.
ESTIMATES = ("static.nc", "through_time.nc", "missions_flow.nc")
RESULTS = (
    "survey.mcap",
    "glider.mcap",
    "three_vehicles.mcap",
    "mean_currents.mcap",
    "windowed.mcap",
)
# Tables of a result, and columns of which the sums are kept.
_TABLES = {
    "fixes": ("longitude", "latitude", "depth"),
    "innovations": ("depth", "innovation_east", "innovation_north", "prior_innovation_east"),
    "dives": ("profiles", "rms_innovation"),
    "surfacings": ("actual_longitude", "actual_latitude", "distance", "delay"),
    "plans": ("heading_deg", "duration", "closest_approach", "energy"),
}
# Shares of the region at which currents are asked for, and depths [m].
_AT, _DEPTHS = ((0.3, 0.4), (0.5, 0.5), (0.7, 0.6)), (5.0, 60.0, 150.0)
_DAY_NS = 86_400_000_000_000


def answers(names: Sequence[str] = (*ESTIMATES, *RESULTS)) -> dict[str, Any]:
    """Return what is read of some files, by name."""
    return {
        name: _opened(partial(_saved, name))
        if name in ESTIMATES
        else _result(checked(FILES / name))
        for name in names
    }


def _saved(name: str) -> Any:
    return _estimate(rk.open_estimate(checked(FILES / name)))


def _opened(read: Callable[[], Any]) -> Any:
    """Return what is read, or the sentence with which an estimate of 0.3 is refused."""
    try:
        return read()
    except ForecastError as error:
        return str(error).partition(": ")[2]


def _estimate(flow: rk.FlowEstimate) -> dict[str, Any]:
    """Return currents and their standard errors at some points, at the estimate's time and, where it changes, a day later."""
    ends = [(axis.min(), np.ptp(axis)) for axis in (flow.grid.longitude, flow.grid.latitude)]
    places = [
        [low + share * long for share, (low, long) in zip(at, ends, strict=True)] for at in _AT
    ]
    points = np.array([(*place, depth) for place in places for depth in _DEPTHS]).T
    found: dict[str, Any] = {"time_ns": flow.time_ns}
    changes = flow.process is not None
    times = {"now": None} | ({"a day later": flow.time_ns + _DAY_NS} if changes else {})
    for name, time_ns in times.items():
        said = flow.velocity_at(*points, time_ns)
        values = said.u, said.v, said.u_standard_error, said.v_standard_error
        found[name] = np.stack(values).T.tolist()
    return found


def _result(path: Path) -> dict[str, Any]:
    """Return sums of a result's tables, what is exported and the title of what is reported of it, and its estimates."""
    result = rk.open_result(path)
    with TemporaryDirectory() as folder:
        page, track = Path(folder) / "page.html", Path(folder) / "track.csv"
        succeed(["report", str(path), "-o", str(page)])
        succeed(["export", str(path), "-o", str(track), "--table", "track"])
        exported = pd.read_csv(track, comment="#")
        title = page.read_text().partition("<title>")[2].partition("</title>")[0]
    held = {name: getattr(result, name) for name in _TABLES}
    # 0.3 counted mean currents as profiles
    both = held["dives"][["profiles", "mean_currents"]].sum(axis=1)
    held["dives"] = held["dives"].assign(profiles=both)
    return {
        "vehicles": list(result.vehicles),
        "title": title,
        "tables": {name: _sums(held[name], columns) for name, columns in _TABLES.items()},
        "exported": _sums(exported, _TABLES["fixes"]),
        "estimates": _opened(lambda: [_estimate(flow) for flow in result.estimates]),
    }


def _sums(table: pd.DataFrame, columns: Sequence[str]) -> dict[str, float]:
    """Return the number of rows of a table, and the sums of some columns where there are rows."""
    rows = len(table)
    return {"rows": rows} | {name: float(table[name].sum()) for name in columns if rows}
