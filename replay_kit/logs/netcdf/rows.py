"""NetCDF files of unknown dialect: a message per time, for ``[[measurements.map]]``."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.core.text import some_text
from replay_kit.logs.netcdf import units
from replay_kit.logs.netcdf.columns import entries
from replay_kit.logs.netcdf.dialects import Dialect, Entries, Told
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored
from replay_kit.logs.shared.payloads import numbers

#: First part of the topic, before the name of the time variable.
TOPIC = "netcdf/"
_VELOCITY = (
    "eastward_sea_water_velocity",
    "northward_sea_water_velocity",
    "sea_water_x_velocity",
    "sea_water_y_velocity",
)
# names of currents in forecasts
_USUAL = ("u", "uo", "water_u", "vozocrtx", "uvel", "u_eastward", "ucur", "vxo")
_NOT_A_LOG = "; a forecast is given with --ensemble, not as a log"
_EXPECTED = "expected a Seaglider basestation file or a glider file of another known dialect"


def require_no_grid(path: Path, held: Mapping[str, Stored]) -> None:
    """Raise LogError if a file with these variables is a forecast given as a log."""
    for name, stored in held.items():
        is_current = name.lower() in _USUAL or stored.standard in _VELOCITY
        if is_current and stored.values.ndim > 2:
            raise LogError(
                f"{path}: {_EXPECTED}, got currents on a grid: {some_text(list(held))}{_NOT_A_LOG}"
            )


def _read_rows(
    files: Sequence[NetcdfFile], dialect: Dialect, config: LogConfig, told: Told
) -> Entries:
    """Return the messages of a file with rows over one time; rows without a time are counted and excluded.

    Raises:
        LogError: The file has no time, or no variable along it.
    """
    del dialect, config
    file = files[0]
    name = _time_name(file)
    said: list[str] = []
    time_ns = units.times_of(file, name, said).ravel()
    # one row per time, or constant, such as levels
    rows, fixed = dict[str, Array](), dict[str, Array]()
    n = time_ns.size
    for other, stored in file.variables.items():
        kind, size = stored.values.dtype.kind, stored.values.ndim
        if other == name or "." in other or kind not in "iufb" or size > 2:
            continue
        values = stored.unpacked()
        values = values.T if values.ndim == 2 and values.shape[0] != n else values
        if values.ndim in (1, 2) and values.shape[0] == n:
            rows[other] = values
        elif values.ndim < 2 and values.size < n:
            fixed[other] = values
    if not rows:
        raise LogError(
            f"{file.path}: {_EXPECTED}, got no variable along {name} alone: {', '.join(file.variables)}{_NOT_A_LOG}"
        )
    told.notes.append(
        f"of no known glider dialect: each row over {name} is a message on {TOPIC}{name}, with {', '.join(rows)}"
        + (f", and at each row {', '.join(fixed)}" if fixed else "")
    )
    told.notes += said
    unknown = int((time_ns == 0).sum())
    at = np.argsort(time_ns, kind="stable")[unknown:]
    topic = f"{TOPIC}{name}"
    told.skipped[topic, "row without a time"] += unknown
    common = {key: numbers(values) for key, values in fixed.items()}
    return lambda: [(), entries((topic, "netcdf"), time_ns, rows, at, common, stamped=False)]


def _time_name(file: NetcdfFile) -> str:
    """Return the name of the time variable: the longest of those with an epoch, else of those named so."""
    sized = {
        name: stored
        for name, stored in file.variables.items()
        if stored.values.size and stored.values.dtype.kind in "iuf" and stored.values.ndim < 2
    }
    stated = [name for name, stored in sized.items() if " since " in stored.units]
    named = [name for name in sized if "time" in name.lower() and sized[name].values.ndim]
    found = stated or named
    if not found:
        raise LogError(
            f"{file.path}: {_EXPECTED}, or any NetCDF with a variable of time (units 'seconds since 1970-01-01'); got variables "
            f"{', '.join(file.variables) or 'none'}{_NOT_A_LOG}"
        )
    return max(
        found,
        key=lambda name: (sized[name].values.size, sized[name].text("standard_name") == "time"),
    )


#: All variables of any file.
ROWS = Dialect("netcdf", "NetCDF of no known dialect", "", {}, beside=".*", read=_read_rows)
