"""Which fields of an ensemble's files become members, at which time, and what is made of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.text import count_text
from replay_kit.forecast.blocks import Block, Collection
from replay_kit.forecast.layout import U
from replay_kit.forecast.members import WARNING, kind_of
from replay_kit.forecast.names import find_lead, find_time
from replay_kit.forecast.pairs import Part
from replay_kit.forecast.times import choose_time, wanted_time

_YEAR = np.timedelta64(365, "D") + np.timedelta64(6, "h")
_LEAST_TIMES = 5
#: A change of velocities, shape (E, 2, Z, J, I), and what it did.
Change = Callable[[Values], tuple[Values, tuple[str, ...]]]


@dataclass(frozen=True, slots=True, eq=False)
class Selected:
    """Members to be read from one file.

    Attributes:
        part: The file.
        ds: Its dataset at the time chosen.
        member: Dimension of the members; None for one.
        labels: Where each comes from.
        extra: Whether the fields, or the mean of several, only serve to make the members, and are none themselves.
    """

    part: Part
    ds: xr.Dataset
    member: str | None
    labels: tuple[str, ...]
    extra: bool = False

    @property
    def last_time(self) -> xr.Dataset | None:
        """The first member of the file at the last of its leads or times, from which one was chosen; None where it has but one."""
        whole = self.part.ds
        chosen = {
            dim: -1 for dim in whole[U].dims if dim not in self.ds[U].dims and whole.sizes[dim] > 1
        }
        if not chosen:
            return None
        last = whole.isel(chosen)
        return last if self.member is None else last.isel({self.member: [0]})


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Fields to be read, and what makes members of them.

    Attributes:
        fields: In order; those that are ``extra`` last.
        time_ns: Time of the ensemble [ns, UTC]; None where the files give none.
        change: What makes members of the fields; None where they are members.
        notes: What was chosen.
    """

    fields: tuple[Selected, ...]
    time_ns: int | None
    change: Change | None
    notes: tuple[str, ...]


def select(found: Collection, config: ForecastConfig, near_ns: int | None) -> Selection:
    """Return the fields of an ensemble that are used at one time.

    Args:
        found: The files.
        config: Lead and time, where chosen.
        near_ns: The log's time [ns, UTC]; None without a log.

    Raises:
        ForecastError: The files do not hold what the rule of the members needs.
    """
    kind = kind_of(found.rule)
    if kind == "lags":
        return _lagged(found, config, near_ns)
    if found.rule is not None and kind == "times":
        return _of_season(found, found.rule.days, config, near_ns)
    fields, times, notes = [], [], list[str]()
    for block in found.blocks:
        field, time_ns, more = _at_time(block, config, near_ns)
        fields.append(field)
        times.append(time_ns)
        notes += more
    notes += _unequal_times(fields, times)
    change: Change | None = None
    if kind == "models":
        means = [_fields_of_all_times(block) for block in found.blocks]
        fields += [field for own in means for field in own]
        change = _without_bias([[len(field.labels) for field in own] for own in means])
    elif found.background is not None:
        fields.append(_at_time(found.background, config, near_ns)[0])
        fields[-1] = Selected(fields[-1].part, fields[-1].ds, None, ("background",), extra=True)
        change = _about_background
    return Selection(tuple(fields), times[0], change, tuple(dict.fromkeys(notes)))


def _at_time(
    block: Block, config: ForecastConfig, near_ns: int | None
) -> tuple[Selected, int | None, tuple[str, ...]]:
    """Return the members of a block at the time chosen."""
    part = block.parts[0]
    if len(block.parts) > 1:
        wanted = wanted_time(config, near_ns)
        if wanted is not None and all(part.times.size for part in block.parts):
            part = min(
                block.parts,
                key=lambda part: int(np.abs(part.times.astype(np.int64) - wanted).min()),
            )
    where = str(part.paths[0])
    dims = [dim for dim in part.ds[U].dims if dim != block.member]
    ds, time_ns, notes = choose_time(part.ds, dims, config, near_ns, where)
    if len(block.parts) > 1:
        notes = (f"{part.names}, one of {len(block.parts)} files of other times, was used", *notes)
    return (
        Selected(part, ds, block.member, _labels(part, block.member, block.label)),
        time_ns,
        notes,
    )


def _unequal_times(fields: Sequence[Selected], times: Sequence[int | None]) -> list[str]:
    """Return warnings of members of different times, and of members without a date among others that have one."""
    notes, dated = [], [time for time in times if time is not None]
    if len(set(dated)) > 1:
        first, last = (_date(np.datetime64(time, "ns")) for time in (min(dated), max(dated)))
        notes.append(
            f"{WARNING}members are of different times, {first} to {last}: choose one that all have with forecast.time"
        )
    if 0 < len(dated) < len(times):
        without = [
            field.part.names for field, time in zip(fields, times, strict=True) if time is None
        ]
        notes.append(
            f"{WARNING}{count_text(len(without), 'member')} of {len(times)} without a date that can be aligned with the others, such as "
            f"{without[0]}: check the attributes units and calendar of its times"
        )
    return notes


def _labels(part: Part, member: str | None, label: str) -> tuple[str, ...]:
    """Return where each member of a file comes from."""
    if member is None:
        return (
            f"{part.names} {label}".strip() if label and label not in part.names else part.names,
        )
    if member not in part.ds.coords:
        return tuple(f"{part.names} {member}[{k}]" for k in range(part.ds.sizes[member]))
    values = part.ds[member].values
    return tuple(
        f"{part.names} {member} {_date(value) if values.dtype.kind == 'M' else value}"
        for value in values
    )


def _date(time: np.datetime64) -> str:
    return f"{np.datetime_as_string(time.astype('M8[ns]'), unit='m')}Z"


def _all_times(found: Collection, need: str) -> list[tuple[Block, Part, NDArray[np.datetime64]]]:
    """Return all files with their times.

    Raises:
        ForecastError: One has none.
    """
    parts = [(block, part, part.times) for block in found.blocks for part in block.parts]
    for _, part, times in parts:
        if not times.size:
            raise ForecastError(
                f"{part.paths[0]}: {need} needs dated fields; the file has no dimension of times with an epoch"
            )
        if find_lead(part.ds, part.ds[U].dims) is not None:
            raise ForecastError(
                f"{part.paths[0]}: {need} takes files of dated times, and this one has a dimension of leads"
            )
    return parts


def _one_time(part: Part, time: np.datetime64, label: str, extra: bool = False) -> Selected:
    dim = find_time(part.ds, part.ds[U].dims)
    ds = part.ds.isel({dim: int(np.flatnonzero(part.times == time)[0])})
    return Selected(part, ds, None, (label,), extra)


def _lagged(found: Collection, config: ForecastConfig, near_ns: int | None) -> Selection:
    """Return forecasts of several reference times, all valid at one time that all have."""
    parts = _all_times(found, "--members lags")
    by_block = [
        np.concatenate([times for owner, _, times in parts if owner is block])
        for block in found.blocks
    ]
    common = reduce(np.intersect1d, by_block)
    if not common.size:
        spans = "; ".join(
            f"{block.label}: {_date(times.min())} to {_date(times.max())}"
            for block, times in zip(found.blocks, by_block, strict=True)
        )
        raise ForecastError(
            f"{found.source}: --members lags needs a time that all forecasts hold; they hold {spans}"
        )
    wanted = wanted_time(config, near_ns)
    if config.lead is not None:
        wanted = _time_of_lead(found, config.lead, common)
    time = (
        common[-1]
        if wanted is None
        else common[np.argmin(np.abs(common.astype(np.int64) - wanted))]
    )
    chosen = [
        next(part for owner, part, times in parts if owner is block and time in times)
        for block in found.blocks
    ]
    fields = tuple(
        _one_time(part, time, f"{part.names} started {block.label}")
        for block, part in zip(found.blocks, chosen, strict=True)
    )
    note = f"members: {len(fields)} forecasts started {found.blocks[0].label} to {found.blocks[-1].label}, all valid {_date(time)}"
    return Selection(
        fields,
        int(time.astype("M8[ns]").astype(np.int64)),
        None,
        (note, "lagged forecasts are usually underdispersive"),
    )


def _time_of_lead(found: Collection, lead: float, common: NDArray[np.datetime64]) -> int:
    """Return the time [ns, UTC] for which a lead of the newest run is valid, which all runs must hold."""
    run = found.blocks[-1].parts[0].ds
    if "lead" not in run.coords:
        raise ForecastError(
            f"{found.source}: a lead was given, but these runs state times alone; choose one with forecast.time"
        )
    time = run["time"].values[np.argmin(np.abs(run["lead"].values.astype(float) - lead))]
    if time not in common:
        raise ForecastError(
            f"{found.source}: lead {lead:g} of the newest run is valid {_date(time)}; expected {_date(common[0])} to {_date(common[-1])}, "
            "which all runs hold: choose another lead, or leave runs out"
        )
    return int(time.astype("M8[ns]").astype(np.int64))


def _of_season(
    found: Collection, days: float, config: ForecastConfig, near_ns: int | None
) -> Selection:
    """Return fields of the forecast's season of any year, to be used as anomalies about the forecast."""
    parts = _all_times(found, f"--members times:{days:g}d")
    known = np.concatenate([times for _, _, times in parts])
    wanted = wanted_time(config, near_ns)
    forecast = (
        known.max() if wanted is None else known[np.argmin(np.abs(known.astype(np.int64) - wanted))]
    )
    fields, own = [], None
    for _, part, times in parts:
        for time in times:
            if time == forecast:
                own = own or _one_time(part, time, f"{part.names} {_date(time)}", extra=True)
                continue
            apart = abs((time - forecast) / _YEAR)
            if abs(apart - round(apart)) * (_YEAR / np.timedelta64(1, "D")) <= days:
                fields.append(
                    _one_time(
                        part,
                        time,
                        f"{part.names} {_date(time)}, as an anomaly about {_date(forecast)}",
                    )
                )
    if len(fields) < 2:
        raise ForecastError(
            f"{found.source}: {count_text(len(fields), 'field')} within {days:g} days of the season of {_date(forecast)}; at least 2 are "
            "needed: widen the window, or give more files"
        )
    assert own is not None
    note = f"members: the forecast of {_date(forecast)} plus the anomalies of {len(fields)} fields within {days:g} days of its season"
    return Selection(
        (*fields, own), int(forecast.astype("M8[ns]").astype(np.int64)), _about_forecast, (note,)
    )


def _about_forecast(velocity: Values) -> tuple[Values, tuple[str, ...]]:
    """Return the fields' anomalies about their mean, added to the forecast, the last field."""
    fields, forecast = velocity[:-1], velocity[-1]
    return forecast + (fields - fields.mean(axis=0)), ()


def _about_background(velocity: Values) -> tuple[Values, tuple[str, ...]]:
    """Return anomalies added to the background, the last field; states as they are."""
    members, background = velocity[:-1], velocity[-1]
    wet = np.isfinite(velocity).all(axis=0)
    mean = members.mean(axis=0)[wet]
    # anomalies cancel out in their mean; states do not
    if np.sqrt(np.mean(mean**2)) < 0.05 * np.sqrt(np.mean(members[:, wet] ** 2)):
        return background + members, ("the members are anomalies, added to the background",)
    return members, ("the members are states; the background was not used",)


def _fields_of_all_times(block: Block) -> list[Selected]:
    """Return all times of a model, file by file, for its mean; none where they are too few."""
    fields = []
    for part in block.parts:
        dim = find_time(part.ds, part.ds[U].dims)
        fields.append(
            Selected(
                part,
                part.ds,
                dim,
                (block.label,) * (1 if dim is None else part.ds.sizes[dim]),
                extra=True,
            )
        )
    return fields if sum(len(field.labels) for field in fields) >= _LEAST_TIMES else []


def _without_bias(counts: list[list[int]]) -> Change:
    """Return the change that takes the mean of each model from it, and gives all the mean of the models' means.

    Args:
        counts: For each model the numbers of times in its files; none for one whose mean is that over the region, level by level.
    """

    def change(velocity: Values) -> tuple[Values, tuple[str, ...]]:
        members = velocity[: len(counts)]
        averages = iter(velocity[len(counts) :])
        if all(counts):
            means = np.stack(
                [np.average([next(averages) for _ in own], axis=0, weights=own) for own in counts]
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
