"""Files of no known dialect: tables of pings, and any NetCDF along one time for ``[[measurements.map]]``.

Tables of pings, in files or memory, have a row per depth and columns by request, CF standard name or name. Rows of equal time and position
form a profile.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.observation import Observation, usable
from replay_kit.core.words.quantities import EARLIEST_NS, measured_at
from replay_kit.core.words.text import some_text
from replay_kit.logs.netcdf import units
from replay_kit.logs.netcdf.columns import (
    Table,
    are_known,
    read_values,
    remove_bad,
    rows_of,
    without_bad,
)
from replay_kit.logs.netcdf.dialect import Dialect
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored
from replay_kit.logs.payloads import PING, entries, numbers, stamp
from replay_kit.logs.reader import Entries

TOPIC = "/observations"
_EXPECTED = "expected a table with the columns time, longitude, latitude, depth [m], u, v and error [m/s], a row a depth"
_PLACE = ("time", "longitude", "latitude")

#: By quantity the name of its column, or its value in all rows.
Asked = Mapping[Any, str | float]


def _chosen(file: NetcdfFile, asked: Asked) -> tuple[NetcdfFile, dict[str, str]]:
    """Return a table with a column for each requested constant, and the column of each quantity.

    Raises:
        ConfigError: A requested or required column is missing.
    """
    held = dict(file.variables)
    chosen = PINGS.chosen(held)
    for key, name in asked.items():
        if not isinstance(name, str):
            held[str(name)] = Stored(np.array(float(name)), {})
        elif name not in held:
            raise ConfigError(
                f"logs.columns.{key}: expected a column of {file.path}, one of {some_text(list(held))}, got '{name}'"
            )
        chosen[str(key)] = str(name)
    if lacking := [key for key in PINGS.names if key in NEEDED - chosen.keys()]:
        raise ConfigError(
            f"{file.path}: {_EXPECTED}; it lacks {', '.join(lacking)}"
            f"{'; state the standard error of each component, it is not guessed' if 'error' in lacking else ''}"
            f"; name it with --columns {lacking[0]}=COLUMN, or give a number for all rows"
        )
    return replace(file, variables=held), chosen


def profiles_in_memory(
    name: str, variables: Mapping[str, Stored], asked: Asked
) -> tuple[list[Observation], int, list[str]]:
    """Return the profiles of a table in memory as ``profiles_of``, and notes on assumptions.

    Times without an epoch are text, dates or integer nanoseconds.

    Args:
        name: Name of the table in errors.
        variables: Columns of the table.
        asked: As in ``profiles_of``, also for errors.
    """
    table, chosen = _chosen(NetcdfFile(Path(name), {}, variables, ()), asked)
    time = table.variables[chosen["time"]]
    if " since " not in time.units:
        # dates of earlier years are stated as such
        time_ns = measured_at(time.values, f"{name}['{chosen['time']}']", EARLIEST_NS)
        dated = {chosen["time"]: Stored(time_ns.astype("M8[ns]"), {}, time.dims)}
        table = replace(table, variables={**table.variables, **dated})
    return *profiles_of(table, asked), table.told.notes


def profiles_of(file: NetcdfFile, asked: Asked) -> tuple[list[Observation], int]:
    """Return the profiles of a table in order of time, and the number of excluded rows without time or position.

    Args:
        file: Table; its path is named in errors.
        asked: Columns and constants that override standard names and names.

    Raises:
        ConfigError: A column is missing, or a standard error is invalid.
        LogError: The unit of the times is unknown.
    """
    file, chosen = _chosen(file, asked)
    values = read_values(file, PINGS, chosen)
    remove_bad(file, PINGS, chosen, values)
    rows = _over_rows(file, chosen, values)
    if "height" in rows:
        rows["depth"] = rows["depth"] - rows["height"]
    known = are_known(rows)
    good = np.isfinite(rows["depth"] + rows["u"] + rows["v"])
    if (bad := known & good & ~(rows["error"] > 0.0)).any():
        raise ConfigError(
            f"{file.path}['{chosen['error']}']: expected the standard error of each component [m/s], above 0, got "
            f"{rows['error'][bad][0]:g}; it is not guessed"
        )
    rows["error"] = np.where(good, rows["error"], 1.0)  # of a bin that is missing
    order = np.lexsort([rows[name] for name in ("depth", *_PLACE[::-1])])
    rows = rows_of(rows, order[known[order]])
    apart = np.any([np.diff(rows[name]) != 0 for name in _PLACE], axis=0)
    return [
        Observation.profile(
            *(rows[name][k[0]].item() for name in _PLACE),
            *(rows[name][k] for name in ("depth", "u", "v", "error")),
        )
        for k in np.split(np.arange(rows["time"].size), np.flatnonzero(apart) + 1)
        if k.size
    ], int((~known).sum())


def _over_rows(file: NetcdfFile, chosen: Mapping[str, str], values: Table) -> Table:
    """Return quantities by row in the order of all dimensions; missing dimensions are broadcast."""
    import xarray as xr

    # the place of a mooring may have two dimensions, of one value each
    dims = {
        key: file.variables[chosen[key]].dims or ("row",) * array.ndim
        for key, array in values.items()
    }
    held = {key: xr.DataArray(array, dims=dims[key]).squeeze() for key, array in values.items()}
    try:
        spread = xr.broadcast(*held.values())
    except ValueError as error:
        raise ConfigError(f"{file.path}: {_EXPECTED}, of one length: {error}") from error
    # of a grid, or of columns that have no rows in common
    if spread[0].ndim > 2 or spread[0].size > max(array.size for array in held.values()):
        raise ConfigError(
            f"{file.path}: {_EXPECTED}, got columns over {some_text([*map(str, spread[0].dims)])}"
        )
    placed = {dim for key in (*_PLACE, "depth", "height") if key in held for dim in held[key].dims}
    if bare := {*spread[0].dims} - placed:
        raise ConfigError(
            f"{file.path}: {chosen['u']} varies along {some_text([*map(str, bare)])}, {chosen['depth']} does not; "
            "name the depths with --columns depth=COLUMN"
        )
    return {key: array.values.ravel() for key, array in zip(held, spread, strict=True)}


def _pings(asked: Asked, files: Sequence[NetcdfFile], dialect: Dialect) -> Entries:
    """Return the profiles of a table, on ``/observations``."""
    del dialect
    try:
        found, left_out = profiles_of(files[0], asked)
    except ConfigError as error:
        raise LogError(str(error)) from error
    files[0].told.skipped[TOPIC, "row without a time or a place"] += left_out
    return lambda: [((one.time_ns, TOPIC, PING, ping_of(one, k)) for k, one in enumerate(found))]


def ping_of(profile: Observation, ordinal: int) -> dict[str, Any]:
    """Return a profile as an ``AdcpPing`` with its own position."""
    good = usable(profile.flags)[:, None]
    velocity = np.where(good, profile.velocity, np.nan)
    std = np.hypot(profile.error_std, profile.common_std)
    return {
        "stamp": stamp(profile.time_ns),
        "ping": ordinal,
        **({"dive": profile.dive} if profile.dive else {}),
        "place": {"lon": profile.longitude, "lat": profile.latitude},
        "coordinate_system": "earth",
        "reference": "earth",
        "orientation": "down",
        "bin_mapped": True,
        "n_cells": profile.depth.size,
        "cell_distances": numbers(profile.depth),
        "transducer_depth": 0.0,
        "pressure": 0.0,
        "velocity": numbers(velocity),
        "velocity_std": numbers(std),
        "correlation_depth": profile.correlation_depth,
    }


# what is too fast or too deep is flagged later, and counted
_UNBOUNDED = {
    key: quantity._replace(low=-np.inf, high=np.inf)
    for quantity, keys in ((units.LENGTH, ("depth", "height")), (units.SPEED, ("u", "v", "error")))
    for key in keys
}
PINGS = Dialect(
    "table",
    "Table of pings",
    "",
    {
        "time": "time date datetime",
        "longitude": "longitude lon",
        "latitude": "latitude lat",
        "depth": "depth",
        "height": "height_above_sensor",
        "u": "eastward_sea_water_velocity u east eastward",
        "v": "northward_sea_water_velocity v north northward",
        "error": "error error_std standard_error",
    },
    standard={
        **{key: key for key in (*_PLACE, "depth")},
        "u": "eastward_sea_water_velocity",
        "v": "northward_sea_water_velocity",
        "error": "eastward_sea_water_velocity standard_error",
    },
    quantities=_UNBOUNDED,
    units={
        **dict.fromkeys(("longitude", "latitude"), "degrees"),
        **{key: quantity.unit for key, quantity in _UNBOUNDED.items()},
    },
    beside=".*",
    read=partial(_pings, {}),
)
#: Quantities that a table of pings has; cells of a mooring may have heights above the depth of its instrument.
NEEDED = PINGS.names.keys() - {"height"}


def pings_as(asked: Asked) -> Dialect:
    """Return the dialect of tables of pings with some columns or constants as asked."""
    return replace(PINGS, read=partial(_pings, asked))


# first part of the topic of rows, before the name of the time variable
_ROWS_TOPIC = "netcdf/"
_VELOCITY = (
    "eastward_sea_water_velocity",
    "northward_sea_water_velocity",
    "sea_water_x_velocity",
    "sea_water_y_velocity",
)
# names of currents in forecasts
_USUAL = ("u", "uo", "water_u", "vozocrtx", "uvel", "u_eastward", "ucur", "vxo")
_NOT_A_LOG = "; a forecast is given with --ensemble, not as a log"
_NO_ERROR = "; --columns error=0.05, the standard error of u and v [m/s], makes them profiles"
_OTHER = "expected a glider file of a known dialect"


def require_no_grid(path: Path, held: Mapping[str, Stored]) -> None:
    """Raise LogError if a file with these variables is a forecast given as a log."""
    for name, stored in held.items():
        is_current = name.lower() in _USUAL or stored.standard in _VELOCITY
        if is_current and stored.extents > 2:
            raise LogError(
                f"{path}: {_OTHER}, got currents on a grid: {some_text(list(held))}{_NOT_A_LOG}"
            )


def _read_rows(files: Sequence[NetcdfFile], dialect: Dialect) -> Entries:
    """Return the messages of a file with rows over one time; rows without a time are counted and excluded.

    Raises:
        LogError: The file has no time, or no variable along it.
    """
    del dialect
    file, told = files[0], files[0].told
    name = _time_name(file)
    time_ns = units.times_of(file, name).ravel()
    # one row per time, or constant, such as levels
    rows, fixed = dict[str, Array](), dict[str, Any]()
    n = time_ns.size
    for other, stored in file.variables.items():
        is_number = stored.values.dtype.kind in "iufb"
        if other == name or "." in other or not is_number or stored.values.ndim > 2:
            continue
        values = without_bad(file, other, stored.unpacked())
        values = values if values.shape[:1] == (n,) else values.T
        if values.shape[:1] == (n,):
            rows[other] = values
        elif values.ndim < 2 and values.size < n:
            fixed[other] = numbers(values)
    dims = {
        key: {*file.variables[variable].dims}
        for key, variable in PINGS.chosen(file.variables).items()
    }
    # of depths along which there is no current no row is a bin
    hint = _NO_ERROR * (NEEDED - dims.keys() == {"error"} and dims["depth"] <= dims["u"])
    if not rows:
        raise LogError(
            f"{file.path}: {_OTHER}, got no variable along {name} alone: {', '.join(file.variables)}{hint or _NOT_A_LOG}"
        )
    topic = f"{_ROWS_TOPIC}{name}"
    told.notes.insert(
        0,
        f"of no known glider dialect: each row over {name} is a message on {topic}, with {', '.join(rows)}"
        + (f", and at each row {', '.join(fixed)}" if fixed else "")
        + hint,
    )
    unknown = int((time_ns == 0).sum())
    at = np.argsort(time_ns, kind="stable")[unknown:]
    told.skipped[topic, "row without a time"] += unknown
    return lambda: [(), entries((topic, "netcdf"), time_ns, rows, at, fixed, stamped=False)]


def _time_name(file: NetcdfFile) -> str:
    """Return the name of the time variable: the longest of those with an epoch, else of those named so."""
    sized = {
        name: stored
        for name, stored in file.variables.items()
        if stored.values.size and stored.values.dtype.kind in "iuf" and stored.values.ndim < 2
    }
    found = [name for name, stored in sized.items() if " since " in stored.units] or [
        name for name in sized if "time" in name.lower() and sized[name].values.ndim
    ]
    if not found:
        raise LogError(
            f"{file.path}: {_OTHER}, or any NetCDF with times (units 'seconds since 1970-01-01'); got "
            f"{', '.join(file.variables) or 'none'}{_NOT_A_LOG}"
        )
    return max(
        found,
        key=lambda name: (sized[name].values.size, sized[name].text("standard_name") == "time"),
    )


#: All variables of any file.
ROWS = Dialect("netcdf", "NetCDF of no known dialect", "", {}, beside=".*", read=_read_rows)
