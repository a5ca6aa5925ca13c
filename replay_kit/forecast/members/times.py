"""Reference times of forecasts, and the choice of a time: by lead, by time, or nearest to the log."""

from collections.abc import Hashable, Sequence
from functools import reduce

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.quantities import parse_time, seconds
from replay_kit.forecast.field import PRODUCT, Field
from replay_kit.forecast.files import undated
from replay_kit.forecast.grids.layout import U
from replay_kit.forecast.members.rules import MemberRule
from replay_kit.forecast.names import find_dimension, find_lead, find_time

_STARTS = ("forecast_reference_time", "reference_time", "init_time", "run")
_DAY_NS = 86_400 * 10**9


def date_text(time: np.datetime64) -> str:
    """Return a time as text to the minute, such as ``2020-01-03T12:00Z``."""
    return f"{_minute(time)}Z"


def wanted_time(config: ForecastConfig, near_ns: int | None) -> int | None:
    """Return the chosen time, else that of the log [ns, UTC]; None without either."""
    return parse_time(config.time) if config.time else near_ns


def nearest_time(times: NDArray[np.datetime64], wanted: int | None) -> np.datetime64:
    """Return the time nearest to a wanted one [ns, UTC]; the last if None."""
    at = np.argmax(times) if wanted is None else np.argmin(np.abs(times.astype(np.int64) - wanted))
    found: np.datetime64 = times[at]
    return found


def choose_time(
    field: Field, config: ForecastConfig, near_ns: int | None
) -> tuple[dict[str, int], int | None, tuple[str, ...]]:
    """Return the positions of the chosen lead and time, their time [ns, UTC] if known, and notes on the choice.

    Args:
        field: Field with any leads and times.
        config: Settings, of which ``lead``, ``time`` and ``reference_time`` have priority.
        near_ns: Otherwise the nearest time to this [ns, UTC]; if None, or for leads without dates, the last lead and first time.

    Raises:
        ForecastError: A setting does not apply to the file.
    """
    ds, where = field.ds, field.where
    dims = [dim for dim in ds[U].dims if dim != field.member]
    lead, time = find_lead(ds, dims), find_time(ds, dims)
    has_dates = time is not None and time in ds.coords and ds[time].dtype.kind == "M"
    since_first = time is not None and not has_dates
    asked = config.reference_time, None if since_first else config.lead
    if lead is None and asked != (None, None):
        raise ForecastError(
            f"{where}: a lead or reference time was given, but the file has no lead dimension; remove the option"
        )
    if time is None and config.time is not None:
        raise ForecastError(
            f"{where}: a time was chosen, but the file has no time dimension; remove the option"
        )
    at, notes = dict[str, int](), list[str]()
    time_ns: int | None = None
    if time is not None and since_first:
        at[time], note = _undated(ds, time, config, where, alone=lead is None)
        notes.append(note)
        ds, config = ds.isel(at), config.model_copy(update={"time": None})
    elif time is not None:
        times = ds[time].values.astype("datetime64[ns]").astype(np.int64)
        wanted = wanted_time(config, near_ns)
        at[time] = 0 if wanted is None else int(np.argmin(np.abs(times - wanted)))
        time_ns = int(times[at[time]])
    if lead is None:
        among = f"of {times.size} times" if has_dates and times.size > 1 else ""
        time_ns = time_ns if has_dates else scalar_time(ds, "time")
        return at, time_ns, (*notes, *_notes(time_ns, near_ns, among))
    reference = time_ns if has_dates else _reference(ds, config)
    at[lead], valid_ns = _choose_lead(ds[lead], config, reference, near_ns)
    chosen = f"{float(ds[lead].values[at[lead]]):g} {ds[lead].attrs.get('units', '')}".strip()
    notes.append(f"lead {chosen} of {ds.sizes[lead]} leads")
    return at, valid_ns, (*notes, *_notes(valid_ns, near_ns, ""))


def _undated(
    ds: xr.Dataset, time: str, config: ForecastConfig, where: str, alone: bool
) -> tuple[int, str]:
    """Return the position of one of the undated times, ``alone`` without leads, and a note on it."""
    since, unit = _since_first(ds, time)
    ways = f"--lead takes another by its {unit} since the first, 0 to {since[-1]:g}"
    if config.time is not None:
        raise ForecastError(
            f"{where}: a time was chosen, but {time} has no dates ({undated(ds[time])}); {ways}"
        )
    position, taken = 0, "the first"
    if alone and config.lead is not None:
        position = int(np.argmin(np.abs(since - config.lead)))
        taken = f"that of {since[position]:g} {unit} since the first"
    note = f"{time} has no dates ({undated(ds[time])})"
    if since.size > 1:
        note += f": {taken} of {since.size} was taken; {ways}"
    return position, note


def _since_first(ds: xr.Dataset, time: str) -> tuple[NDArray[np.float64], str]:
    """Return the undated times since the first, and their unit: the file's, or the number of times."""
    count = np.arange(ds.sizes[time], dtype=np.float64)
    if time not in ds.coords or ds[time].dtype.kind not in "iuf":
        return count, "number of times"
    values = ds[time].values.astype(np.float64)
    if not np.isfinite(values).all() or np.ptp(values) == 0.0:
        return count, "number of times"
    return values - values[0], str(ds[time].attrs.get("units", "")).strip() or "value"


def dated_leads(ds: xr.Dataset, lead: str, config: ForecastConfig) -> list[tuple[float, int]]:
    """Return each lead with its valid time [ns, UTC]; empty without a reference time."""
    reference = _reference(ds, config)
    valid = None if reference is None else _periods_ns(ds[lead])
    if valid is None or reference is None:
        return []
    return [
        (float(value), int(reference + period))
        for value, period in zip(ds[lead].values, valid, strict=True)
    ]


def runs_of(ds: xr.Dataset, dims: Sequence[Hashable]) -> list[xr.Dataset]:
    """Return the runs of a dataset with dimensions of starts and leads, each with times and ``lead``; otherwise the dataset.

    Args:
        ds: Dataset with decoded dates.
        dims: Dimensions of its velocities.
    """
    found = valid_times(ds, dims)
    if found is None:
        return [ds]
    valid, (start, lead) = found
    named = {"standard_name": "forecast_reference_time"}
    return [
        ds.isel({start: k})
        .drop_vars([start, lead])
        .rename_dims({lead: "time"})
        .assign_coords(
            time=("time", times.astype("M8[ns]"), {"standard_name": "time"}),
            lead=("time", ds[lead].values),
            forecast_reference_time=((), ds[start].values[k], named),
        )
        for k, times in enumerate(valid)
    ]


def valid_times(
    ds: xr.Dataset, dims: Sequence[Hashable]
) -> tuple[NDArray[np.int64], tuple[str, str]] | None:
    """Return the valid times of leads of several starts [ns, UTC], shape (starts, leads), and the dimensions; None without starts."""
    start = find_dimension(ds, dims, ("forecast_reference_time",), _STARTS) or find_time(ds, dims)
    lead = find_lead(ds, dims)
    if start is None or lead is None or start not in ds.coords or ds[start].dtype.kind != "M":
        return None
    periods = _periods_ns(ds[lead])
    starts = ds[start].values.astype("M8[ns]").astype(np.int64)
    return None if periods is None else (starts[:, None] + periods, (start, lead))


def _reference(ds: xr.Dataset, config: ForecastConfig) -> int | None:
    """Return the time of lead 0 [ns, UTC]: configured, else stated; None without either."""
    if config.reference_time:
        return parse_time(config.reference_time)
    return scalar_time(ds, "forecast_reference_time")


def _choose_lead(
    lead: xr.DataArray, config: ForecastConfig, reference: int | None, near_ns: int | None
) -> tuple[int, int | None]:
    """Return the position of the lead and its valid time [ns, UTC]."""
    valid = None if reference is None else _periods_ns(lead)
    if valid is not None and reference is not None:
        valid = reference + valid
    if config.lead is not None:
        position = int(np.argmin(np.abs(lead.values.astype(np.float64) - config.lead)))
    elif valid is not None and near_ns is not None:
        position = int(np.argmin(np.abs(valid - near_ns)))
    else:
        position = lead.size - 1
    return position, None if valid is None else int(valid[position])


def _notes(time_ns: int | None, near_ns: int | None, among: str) -> tuple[str, ...]:
    """Return a note on the time used, if there was a choice or it lies more than a day from the log."""
    if time_ns is None:
        return ()
    note = f"the forecast is of {date_text(np.datetime64(time_ns, 'ns'))}"
    days = 0.0 if near_ns is None else (near_ns - time_ns) / _DAY_NS
    if abs(days) > 1.0:
        return (
            f"{note}, {abs(days):.1f} days {'before' if days > 0 else 'after'} the log begins: the log lies outside its time",
        )
    return (f"{note}, {among}",) if among else ()


def scalar_time(ds: xr.Dataset, standard_name: str) -> int | None:
    """Return the single time of a variable, by its name or standard name [ns, UTC]; None if absent."""
    for name, variable in ds.variables.items():
        known = standard_name in (variable.attrs.get("standard_name"), name)
        if known and variable.size == 1 and np.issubdtype(variable.dtype, np.datetime64):
            return int(variable.values.astype("datetime64[ns]").astype(np.int64).ravel()[0])
    return None


def _periods_ns(lead: xr.DataArray) -> NDArray[np.int64] | None:
    unit = seconds(str(lead.attrs.get("units", "")).strip())
    return (
        None
        if unit is None
        else np.round(lead.values.astype(np.float64) * unit * 1e9).astype(np.int64)
    )


# Of one run, files that follow one another share one time at most.
_LEAST_COMMON = 2


def start_of(file: Field) -> str:
    """Return the start of a forecast: stated, else its first time.

    Raises:
        ForecastError: The forecast has no date.
    """
    times = file.times
    if (stated := _stated_start(file)) is None and not times.size:
        raise ForecastError(
            f"{file.where}: --members lags needs dated forecasts; expected a dimension of times with an epoch"
        )
    return stated or _minute(times.min())


def rule_of(holders: Sequence[Field]) -> tuple[MemberRule | None, tuple[str, ...]]:
    """Return the definition of a member for files with currents, and a note; None if they may be one run, or several products.

    Files of one grid with the same times are members. So are forecasts of several starts with a common time.
    """
    files = [file for file in holders if file.current and file.current.u]
    if len(files) < 2 or len({_form(file) for file in files}) > 1:
        return None, ()
    times = [file.stated_times for file in files]
    if all(each.size and np.array_equal(each, times[0]) for each in times):
        note = f"members: the {len(files)} files, as all hold the same times (--members files)"
        return MemberRule("files"), (note,)
    if not all(file.times.size for file in files):
        return None, ()
    stated = all(_stated_start(file) is not None for file in files)
    runs: dict[str, NDArray[np.datetime64]] = {}
    for file in files:
        start = start_of(file)
        runs[start] = np.union1d(runs.get(start, file.times), file.times)
    common = reduce(np.intersect1d, runs.values())
    if len(runs) < 2 or common.size < (1 if stated else _LEAST_COMMON):
        return None, ()
    note = (
        f"members: forecasts of {len(runs)} starts, as all hold a time in common (--members lags)"
    )
    return MemberRule("lags"), (note,)


def _form(file: Field) -> tuple[object, ...]:
    """Return the properties that files of one product share: attributes, component name, dimensions other than time."""
    assert file.current is not None
    sizes = file.like[file.current.u or file.current.v].sizes
    product = tuple(str(file.like.attrs.get(name, "")) for name in PRODUCT)
    return *product, file.current.u, tuple(item for item in sizes.items() if item[0] != file.time)


def _minute(time: np.datetime64) -> str:
    return str(np.datetime_as_string(time, unit="m"))


def _stated_start(file: Field) -> str | None:
    """Return the start stated by a file: reference time, bulletin date, or hours since the analysis (HYCOM's tau)."""
    stated = scalar_time(file.like, "forecast_reference_time") is not None
    if not stated and "bulletin_date" not in file.like.attrs and "tau" not in file.like.variables:
        return None
    if (reference := scalar_time(file.ds, "forecast_reference_time")) is not None:
        return _minute(np.datetime64(reference, "ns"))
    if "bulletin_date" in file.ds.attrs:
        return str(file.ds.attrs["bulletin_date"])
    times = file.times
    if not times.size or "tau" not in file.ds.variables:
        return None
    since = file.ds["tau"]
    hours = since.values.ravel()[:1]
    if not str(since.attrs.get("units", "")).startswith("hours") or not np.isfinite(hours).all():
        return None
    return _minute(times[0] - np.timedelta64(round(float(hours[0])), "h"))
