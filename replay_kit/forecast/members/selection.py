"""Selection of the fields that become members, at one time, and their change into members."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Times, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.words.text import count_text
from replay_kit.forecast.field import Field
from replay_kit.forecast.members.collection import Collection
from replay_kit.forecast.members.rules import WARNING
from replay_kit.forecast.members.times import choose_time, date_text, nearest_position, wanted_time

_DAY_NS = 86_400 * 10**9
_YEAR_NS = 365.25 * _DAY_NS
_LEAST_TIMES = 5
#: A change of velocities, shape (E, 2, Z, J, I), and what it did.
Change = Callable[[Values], tuple[Values, tuple[str, ...]]]


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Fields to be read and their change into members.

    Attributes:
        fields: Fields in order, ``extra`` ones last.
        time_ns: Time of the ensemble [ns, UTC]; None if the files state none.
        change: Function from fields to members; None if they are members.
        notes: Choices made.
    """

    fields: tuple[Field, ...]
    time_ns: int | None
    change: Change | None
    notes: tuple[str, ...]


def select(found: Collection, config: ForecastConfig, near_ns: int | None) -> Selection:
    """Return the selected fields of an ensemble at one time.

    Args:
        found: Opened files.
        config: Lead and time, if chosen.
        near_ns: Time of the log [ns, UTC]; None without a log.

    Raises:
        ForecastError: The files lack fields that the definition of a member requires.
    """
    kind = found.rule.kind
    if kind == "lags":
        return _lagged(found, config, near_ns)
    if kind == "times":
        return _season_fields(found, found.rule.days, config, near_ns)
    fields, times, notes = [], [], list[str]()
    for member in found.members:
        field, time_ns, more = _at_time(member, config, near_ns)
        fields.append(field)
        times.append(time_ns)
        notes += more
    notes += _unequal_times(fields, times)
    change: Change | None = None
    if kind == "models":
        means = [_fields_of_all_times(member) for member in found.members]
        fields += [field for field_of_mean in means for field in field_of_mean]
        change = _without_bias(
            [[len(field.labels) for field in field_of_mean] for field_of_mean in means]
        )
    elif found.background:
        about = _at_time(found.background, config, near_ns)[0]
        fields.append(replace(about, labels=("background",), extra=True))
        change = _about_background
    return Selection(tuple(fields), times[0], change, tuple(dict.fromkeys(notes)))


def _at_time(
    member: Sequence[Field], config: ForecastConfig, near_ns: int | None
) -> tuple[Field, int | None, tuple[str, ...]]:
    """Return the field of a member, or of members read together, at the chosen time."""
    field = member[0]
    if len(member) > 1:
        wanted = wanted_time(config, near_ns)
        if wanted is not None and all(field.times.size for field in member):
            field = min(member, key=lambda field: int(np.abs(field.times - wanted).min()))
    at, time_ns, notes = choose_time(field, config, near_ns)
    if len(member) > 1:
        notes = (f"{field.names}, one of {len(member)} files of other times, was used", *notes)
    return replace(field, at=at, labels=_labels(field)), time_ns, notes


def _unequal_times(fields: Sequence[Field], times: Sequence[int | None]) -> list[str]:
    """Return warnings of members of different times, and of undated members among dated ones."""
    notes, dated = [], [time for time in times if time is not None]
    if len(set(dated)) > 1:
        first, last = date_text(min(dated)), date_text(max(dated))
        notes.append(
            f"{WARNING}members are of different times, {first} to {last}: choose one that all have with forecast.time"
        )
    if 0 < len(dated) < len(times):
        without = [field.names for field, time in zip(fields, times, strict=True) if time is None]
        notes.append(
            f"{WARNING}{count_text(len(without), 'member')} of {len(times)} without a date that can be aligned with the others, such as "
            f"{without[0]}: check the attributes units and calendar of its times"
        )
    return notes


def _labels(field: Field) -> tuple[str, ...]:
    """Return the origin of each member of a file."""
    names, label, member, ds = field.names, field.label, field.member, field.ds
    if member is None:
        return (f"{names} {label}".strip() if label and label not in names else names,)
    if member not in ds.coords:
        return tuple(f"{names} {member}[{k}]" for k in range(ds.sizes[member]))
    values = ds[member].values
    return tuple(
        f"{names} {member} {date_text(value.astype('M8[ns]').astype(int)) if values.dtype.kind == 'M' else value}"
        for value in values
    )


def _all_times(found: Collection, need: str) -> tuple[Field, ...]:
    """Return the fields of all files.

    Raises:
        ForecastError: A file has no dated times.
    """
    fields = tuple(field for member in found.members for field in member)
    for field in fields:
        if not field.times.size:
            raise ForecastError(
                f"{field.where}: {need} needs dated fields; the file has no dimension of times with an epoch"
            )
        if field.lead is not None:
            raise ForecastError(
                f"{field.where}: {need} takes files of dated times, and this one has a dimension of leads"
            )
    return fields


def _one_time(field: Field, time: int, label: str, extra: bool = False) -> Field:
    at = {str(field.time): int(np.flatnonzero(field.times == time)[0])}
    return replace(field, at=at, member=None, labels=(label,), extra=extra)


def _lagged(found: Collection, config: ForecastConfig, near_ns: int | None) -> Selection:
    """Return the forecasts of several reference times, valid at a common time."""
    _all_times(found, "--members lags")
    by_run = [np.concatenate([field.times for field in run]) for run in found.members]
    labels = [run[0].label for run in found.members]
    common = reduce(np.intersect1d, by_run)
    if not common.size:
        spans = "; ".join(
            f"{label}: {date_text(times.min())} to {date_text(times.max())}"
            for label, times in zip(labels, by_run, strict=True)
        )
        raise ForecastError(
            f"{found.source}: --members lags needs a time that all forecasts hold; they hold {spans}"
        )
    wanted = wanted_time(config, near_ns)
    if config.lead is not None:
        wanted = _time_of_lead(found, config.lead, common)
    time = _nearest(common, wanted)
    chosen = [next(field for field in run if time in field.times) for run in found.members]
    fields = tuple(
        _one_time(field, time, f"{field.names} started {field.label}") for field in chosen
    )
    note = f"members: {len(fields)} forecasts started {labels[0]} to {labels[-1]}, all valid {date_text(time)}"
    return Selection(fields, time, None, (note, "lagged forecasts are usually underdispersive"))


def _nearest(times: Times, wanted: int | None) -> int:
    """Return the time nearest to a wanted one [ns, UTC]; the last if None."""
    return int(times.max() if wanted is None else times[nearest_position(times, wanted)])


def _time_of_lead(found: Collection, lead: float, common: Times) -> int:
    """Return the valid time of a lead of the newest run [ns, UTC], which all runs must hold."""
    run = found.members[-1][0].ds
    if "lead" not in run.coords:
        raise ForecastError(
            f"{found.source}: a lead was given, but these runs state times alone; choose one with forecast.time"
        )
    time = found.members[-1][0].times[nearest_position(run["lead"].values.astype(float), lead)]
    if time not in common:
        raise ForecastError(
            f"{found.source}: lead {lead:g} of the newest run is valid {date_text(time)}; expected {date_text(common[0])} to "
            f"{date_text(common[-1])}, which all runs hold: choose another lead, or leave runs out"
        )
    return int(time)


def _season_fields(
    found: Collection, days: float, config: ForecastConfig, near_ns: int | None
) -> Selection:
    """Return the fields of the forecast's season in any year, for use as anomalies about the forecast."""
    files = _all_times(found, f"--members times:{days:g}d")
    known = np.concatenate([file.times for file in files])
    forecast = _nearest(known, wanted_time(config, near_ns))
    fields, at_start = [], None
    for file in files:
        for time in file.times:
            if time == forecast:
                at_start = at_start or _one_time(
                    file, time, f"{file.names} {date_text(time)}", extra=True
                )
                continue
            apart = abs(time - forecast) / _YEAR_NS
            if abs(apart - round(apart)) * _YEAR_NS <= days * _DAY_NS:
                fields.append(
                    _one_time(
                        file,
                        time,
                        f"{file.names} {date_text(time)}, as an anomaly about {date_text(forecast)}",
                    )
                )
    if len(fields) < 2:
        raise ForecastError(
            f"{found.source}: {count_text(len(fields), 'field')} within {days:g} days of the season of {date_text(forecast)}; at "
            "least 2 are needed: widen the window, or give more files"
        )
    assert at_start is not None
    note = f"members: the forecast of {date_text(forecast)} plus the anomalies of {len(fields)} fields within {days:g} days of its season"
    return Selection((*fields, at_start), forecast, _about_forecast, (note,))


def _about_forecast(velocity: Values) -> tuple[Values, tuple[str, ...]]:
    """Return the anomalies of fields about their mean, added to the forecast, which is the last field."""
    fields, forecast = velocity[:-1], velocity[-1]
    return forecast + (fields - fields.mean(axis=0)), ()


def _about_background(velocity: Values) -> tuple[Values, tuple[str, ...]]:
    """Return anomalies added to the background, which is the last field; states unchanged."""
    members, background = velocity[:-1], velocity[-1]
    wet = np.isfinite(velocity).all(axis=0)
    mean = members.mean(axis=0)[wet]
    # anomalies cancel out in their mean; states do not
    if np.sqrt(np.mean(mean**2)) < 0.05 * np.sqrt(np.mean(members[:, wet] ** 2)):
        return background + members, ("the members are anomalies, added to the background",)
    return members, ("the members are states; the background was not used",)


def _fields_of_all_times(model: Sequence[Field]) -> list[Field]:
    """Return the fields of all times of a model, file by file, for its mean; empty if they are too few."""
    fields = [
        replace(
            field,
            member=field.time,
            labels=(field.label,) * (1 if field.time is None else field.like.sizes[field.time]),
            extra=True,
        )
        for field in model
    ]
    return fields if sum(len(field.labels) for field in fields) >= _LEAST_TIMES else []


def _without_bias(counts: list[list[int]]) -> Change:
    """Return the change that replaces each model's mean by the mean over models.

    Args:
        counts: Numbers of times in the files of each model; empty for a model with its mean over the region, level by level.
    """

    def change(velocity: Values) -> tuple[Values, tuple[str, ...]]:
        members = velocity[: len(counts)]
        averages = iter(velocity[len(counts) :])
        if all(counts):
            means = np.stack(
                [
                    np.average([next(averages) for _ in sizes], axis=0, weights=sizes)
                    for sizes in counts
                ]
            )
            how = "over its times"
        else:
            means = np.broadcast_to(
                np.nanmean(members, axis=(-2, -1), keepdims=True), members.shape
            )
            how = "over the region, as not all have five times"
        note = f"each model's own mean {how} was replaced by that of all {len(counts)} models"
        return members - means + means.mean(axis=0), (note,)

    return change
