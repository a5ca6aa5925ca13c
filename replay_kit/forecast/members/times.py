"""Times of forecasts: their steps and starts, and the choice of a step by lead, by time, or nearest to the log."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
import xarray as xr

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Array, Times
from replay_kit.core.errors import Caveat, ForecastError
from replay_kit.core.words.quantities import parse_time, seconds
from replay_kit.forecast.field import PRODUCT, Field
from replay_kit.forecast.files import why_undated
from replay_kit.forecast.members.rules import MemberRule
from replay_kit.forecast.names import find_dimension, find_lead, find_time

_STARTS = ("forecast_reference_time", "reference_time", "init_time", "run")
_DAY_NS = 86_400 * 10**9


def date_text(time_ns: int) -> str:
    """Return a time [ns, UTC] as text to the minute, such as ``2020-01-03T12:00Z``."""
    return f"{np.datetime_as_string(np.datetime64(int(time_ns), 'ns'), unit='m')}Z"


def wanted_time(config: ForecastConfig, near_ns: int | None) -> int | None:
    """Return the chosen time, else that of the log [ns, UTC]; None without either."""
    return parse_time(config.time) if config.time else near_ns


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Steps of a field, of which one is used.

    Attributes:
        at: Positions along other dimensions of time: the start of several runs.
        dim: Dimension of the steps; None for a single one.
        valid: Times [ns, UTC], shape (T,); empty without dates.
        values: What ``--lead`` takes, shape (T,): leads, or undated times since the first; None for dated times.
        unit: Unit of these as text.
        usual: Position without a choice.
    """

    at: dict[str, int]
    dim: str | None
    valid: Times
    values: Array | None = None
    unit: str = ""
    usual: int = 0


def steps_of(field: Field, config: ForecastConfig, wanted: int | None = None) -> Steps:
    """Return the steps of a field: its leads, or else its times.

    Args:
        field: Field with any leads and times.
        config: Settings, of which ``reference_time`` is the start of leads, before that of the file.
        wanted: Time [ns, UTC] to which the start of several runs is the nearest; None for the first.
    """
    times, time = field.times, field.time
    if field.lead is None:
        if time is None or times.size:
            single = scalar_time(field.ds, "time") if time is None else None
            return Steps({}, time, times if single is None else np.array([single]))
        values, unit = _since_first(field.ds, time)
        return Steps({}, time, times, values, unit)
    at, start = dict[str, int](), None
    if time is not None:
        at = {time: 0 if wanted is None or not times.size else nearest_position(times, wanted)}
    if time is not None and times.size:
        start = int(times[at[time]])
    elif config.reference_time:
        start = parse_time(config.reference_time)
    else:
        start = scalar_time(field.ds, "forecast_reference_time")
    lead = field.ds[field.lead]
    periods = _periods_ns(lead)
    valid = np.zeros(0, np.int64) if start is None or periods is None else start + periods
    unit = str(lead.attrs.get("units", ""))
    values = np.asarray(lead.values, np.float64)
    return Steps(at, field.lead, valid, values, unit, -1)


def nearest_position(values: Times | Array, wanted: float) -> int:
    """Return the position of the value nearest to a wanted one."""
    return int(np.argmin(np.abs(values - wanted)))


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
    wanted = wanted_time(config, near_ns)
    steps, where = steps_of(field, config, wanted), field.where
    if (config.lead is not None and steps.values is None) or (
        config.reference_time is not None and field.lead is None
    ):
        raise ForecastError(
            f"{where}: a lead or reference time was given, but the file has no lead dimension; remove the option"
        )
    undated_times = ways = ""
    if steps.dim is not None and field.lead is None and steps.values is not None:
        undated_times = f"{steps.dim} has no dates ({why_undated(field.ds[steps.dim])})"
        ways = (
            f"--lead takes another by its {steps.unit} since the first, 0 to {steps.values[-1]:g}"
        )
    if config.time is not None and not steps.valid.size:
        lacks = f"{undated_times}; {ways}" if ways else "the file has no dates"
        raise ForecastError(f"{where}: a time was chosen, but {lacks}; remove the option")
    position = steps.usual
    if config.lead is not None and steps.values is not None:
        position = nearest_position(steps.values, config.lead)
    elif steps.valid.size and wanted is not None:
        position = nearest_position(steps.valid, wanted)
    notes = list[str]()
    if steps.values is not None:
        value = f"{steps.values[position]:g} {steps.unit}".strip()
        taken = "the first" if config.lead is None else f"that of {value} since the first"
        several = f": {taken} of {steps.values.size} was taken; {ways}"
        if not ways:
            notes.append(f"lead {value} of {steps.values.size} leads")
        else:
            notes.append(undated_times + (several if steps.values.size > 1 else ""))
    at = steps.at | ({} if steps.dim is None else {steps.dim: position})
    if not steps.valid.size:
        return at, None, tuple(notes)
    time_ns = int(steps.valid[position])
    among = f"of {steps.valid.size} times" if steps.values is None and steps.valid.size > 1 else ""
    notes += _notes(time_ns, near_ns, among)
    return at, time_ns, tuple(notes)


def _notes(time_ns: int, near_ns: int | None, among: str) -> list[str]:
    """Return a note on the time used, if there was a choice or it lies more than a day from the log."""
    note = f"the forecast is of {date_text(time_ns)}"
    days = 0.0 if near_ns is None else (near_ns - time_ns) / _DAY_NS
    if abs(days) > 1.0:
        side = "before" if days > 0 else "after"
        words = f"{note}, {abs(days):.1f} days {side} the log begins: the log lies outside its time"
        return [Caveat(words)]
    return [f"{note}, {among}"] if among else []


def _since_first(ds: xr.Dataset, time: str) -> tuple[Array, str]:
    """Return the undated times since the first, and their unit: the file's, or the number of times."""
    if time in ds.coords and ds[time].dtype.kind in "iuf":
        values = ds[time].values.astype(np.float64)
        if np.isfinite(values).all() and np.ptp(values) > 0.0:
            return values - values[0], str(ds[time].attrs.get("units", "")).strip() or "value"
    return np.arange(ds.sizes[time], dtype=np.float64), "number of times"


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


def valid_times(ds: xr.Dataset, dims: Sequence[Hashable]) -> tuple[Times, tuple[str, str]] | None:
    """Return the valid times of leads of several starts [ns, UTC], shape (starts, leads), and the dimensions; None without starts."""
    start = find_dimension(ds, dims, ("forecast_reference_time",), _STARTS) or find_time(ds, dims)
    lead = find_lead(ds, dims)
    if start is None or lead is None or start not in ds.coords or ds[start].dtype.kind != "M":
        return None
    periods = _periods_ns(ds[lead])
    starts = ds[start].values.astype("M8[ns]").astype(np.int64)
    return None if periods is None else (starts[:, None] + periods, (start, lead))


def scalar_time(ds: xr.Dataset, standard_name: str) -> int | None:
    """Return the single time of a variable, by its name or standard name [ns, UTC]; None if absent."""
    for name, variable in ds.variables.items():
        known = standard_name in (variable.attrs.get("standard_name"), name)
        if known and variable.size == 1 and np.issubdtype(variable.dtype, np.datetime64):
            return int(variable.values.astype("datetime64[ns]").astype(np.int64).ravel()[0])
    return None


def _periods_ns(lead: xr.DataArray) -> Times | None:
    unit = seconds(str(lead.attrs.get("units", "")).strip())
    if unit is None:
        return None
    return np.round(lead.values.astype(np.float64) * unit * 1e9).astype(np.int64)


# Of one run, files that follow one another share one time at most.
_LEAST_COMMON = 2


def start_of(file: Field) -> str:
    """Return the start of a forecast: stated, else its first time.

    Raises:
        ForecastError: The forecast has no date.
    """
    if stated := _stated_start(file):
        return stated
    if not file.times.size:
        raise ForecastError(
            f"{file.where}: --members lags needs dated forecasts; expected a dimension of times with an epoch"
        )
    return date_text(file.times.min())[:-1]


def _stated_start(file: Field) -> str:
    """Return the start stated by a file: reference time, bulletin date, or hours since the analysis (HYCOM's tau); empty if none is."""
    stated = scalar_time(file.like, "forecast_reference_time") is not None
    # most files are not opened, as those of their form state none
    if not stated and "bulletin_date" not in file.like.attrs and "tau" not in file.like.variables:
        return ""
    ds = file.ds
    if (reference := scalar_time(ds, "forecast_reference_time")) is not None:
        return date_text(reference)[:-1]
    if "bulletin_date" in ds.attrs or not file.times.size or "tau" not in ds.variables:
        return str(ds.attrs.get("bulletin_date", ""))
    hours = ds["tau"].values.ravel()[:1].astype(np.float64)
    if (
        not str(ds["tau"].attrs.get("units", "")).startswith("hours")
        or not np.isfinite(hours).all()
    ):
        return ""
    return date_text(file.times[0] - round(float(hours[0])) * _DAY_NS // 24)[:-1]


def rule_of(holders: Sequence[Field]) -> tuple[MemberRule, tuple[str, ...]]:
    """Return the definition of a member for files with currents, and a note; without a kind if they may be one run, or several products.

    Files of one grid with the same times are members. So are forecasts of several starts with a common time.
    """
    files = [file for file in holders if file.holds[0]]
    if len(files) < 2 or len({_form(file) for file in files}) > 1:
        return MemberRule(""), ()
    times = [file.stated_times for file in files]
    if all(each.size and np.array_equal(each, times[0]) for each in times):
        note = f"members: the {len(files)} files, as all hold the same times (--members files)"
        return MemberRule("files"), (note,)
    if not all(file.times.size for file in files):
        return MemberRule(""), ()
    runs: dict[str, Times] = {}
    for file in files:
        start = start_of(file)
        runs[start] = np.union1d(runs.get(start, file.times), file.times)
    least = 1 if all(map(_stated_start, files)) else _LEAST_COMMON
    if len(runs) < 2 or reduce(np.intersect1d, runs.values()).size < least:
        return MemberRule(""), ()
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
