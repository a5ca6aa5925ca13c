"""When forecasts were started, and what the members of several files are where neither an option nor their names say it."""

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import ForecastError
from replay_kit.forecast.members import MemberRule
from replay_kit.forecast.names import find_time
from replay_kit.forecast.pairs import OpenedFile
from replay_kit.forecast.times import scalar_time

# Of one run, files that follow one another share one time at most.
_LEAST_COMMON = 2
# Attributes of a file that differ between products.
_PRODUCT = ("title", "source", "institution", "product", "challenger")


def start_of(file: OpenedFile) -> str:
    """Return when a forecast was started: stated, or its first time.

    Raises:
        ForecastError: It has no date.
    """
    times = _dates(file)
    if (stated := _stated_start(file)) is None and not times.size:
        raise ForecastError(
            f"{file.path}: --members lags needs dated forecasts; expected a dimension of times with an epoch"
        )
    return stated or _minute(times.min())


def rule_of(holders: Sequence[OpenedFile]) -> tuple[MemberRule | None, tuple[str, ...]]:
    """Return what a member is of files with currents, and a note on it; None where they may be of one run, or of several products.

    Files of one grid that hold the same times are members. So are forecasts of several starts that hold a time in common.
    """
    files = [file for file in holders if file.current and file.current.u]
    if len(files) < 2 or len({_form(file) for file in files}) > 1:
        return None, ()
    times = [_times(file) for file in files]
    if all(each.size and np.array_equal(each, times[0]) for each in times):
        note = f"members: the {len(files)} files, as all hold the same times (--members files)"
        return MemberRule("files"), (note,)
    if not all(_dates(file).size for file in files):
        return None, ()
    stated = all(_stated_start(file) is not None for file in files)
    runs: dict[str, NDArray[np.datetime64]] = {}
    for file in files:
        start = start_of(file)
        runs[start] = np.union1d(runs.get(start, _dates(file)), _dates(file))
    common = reduce(np.intersect1d, runs.values())
    if len(runs) < 2 or common.size < (1 if stated else _LEAST_COMMON):
        return None, ()
    note = (
        f"members: forecasts of {len(runs)} starts, as all hold a time in common (--members lags)"
    )
    return MemberRule("lags"), (note,)


def _form(file: OpenedFile) -> tuple[object, ...]:
    """Return what files of one product share: attributes, the name of the component, and its dimensions but for that of times."""
    assert file.current is not None
    sizes = file.ds[file.current.u or file.current.v].sizes
    time = find_time(file.ds, file.dims)
    product = tuple(str(file.ds.attrs.get(name, "")) for name in _PRODUCT)
    return *product, file.current.u, tuple(item for item in sizes.items() if item[0] != time)


def _times(file: OpenedFile) -> NDArray[np.generic]:
    """Return the times of a file, numbers where they have no date; none of a file without a dimension of them."""
    time = find_time(file.ds, file.dims)
    known = time is not None and time in file.ds.coords
    return file.ds[time].values if known else np.zeros(0)


def _dates(file: OpenedFile) -> NDArray[np.datetime64]:
    times = _times(file)
    return times.astype("M8[ns]") if times.dtype.kind == "M" else np.zeros(0, "M8[ns]")


def _minute(time: np.datetime64) -> str:
    return str(np.datetime_as_string(time, unit="m"))


def _stated_start(file: OpenedFile) -> str | None:
    """Return the start that a file states: its reference time, its bulletin's date, or the hours since the analysis (HYCOM's tau)."""
    if (reference := scalar_time(file.ds, "forecast_reference_time")) is not None:
        return _minute(np.datetime64(reference, "ns"))
    if "bulletin_date" in file.ds.attrs:
        return str(file.ds.attrs["bulletin_date"])
    times = _dates(file)
    if not times.size or "tau" not in file.ds.variables:
        return None
    since = file.ds["tau"]
    hours = since.values.ravel()[:1]
    if not str(since.attrs.get("units", "")).startswith("hours") or not np.isfinite(hours).all():
        return None
    return _minute(times[0] - np.timedelta64(round(float(hours[0])), "h"))
