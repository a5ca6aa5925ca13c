"""Forecast or truth at all dated times: leads after a reference time, or times of a file."""

from dataclasses import replace

import numpy as np

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Times
from replay_kit.core.errors import Caveat, ForecastError
from replay_kit.core.files.paths import Paths
from replay_kit.core.grid import Ensemble
from replay_kit.forecast.field import Field
from replay_kit.forecast.members.collection import Collection, open_collection
from replay_kit.forecast.members.rules import MADE, parse_rule, without_copies
from replay_kit.forecast.members.times import date_text, steps_of
from replay_kit.forecast.reader import read_ensemble, read_members

_DAY_NS = 86_400 * 10**9


def read_series(
    path: Paths | Collection,
    config: ForecastConfig,
    *,
    near_ns: int | None = None,
    place_at: tuple[float, float] | None = None,
) -> tuple[Ensemble, ...]:
    """Return the forecast at each of its dated times, in order; a single one if it has no more or one was chosen.

    Args:
        path: NetCDF files, Zarr stores, folders or patterns.
        config: Region and levels; a chosen lead or time leaves a single one.
        near_ns: See ``read_ensemble``.
        place_at: See ``read_ensemble``.

    Raises:
        ForecastError: See ``read_ensemble``; or land differs between times.
    """
    if config.lead is not None or config.time is not None:
        return (read_ensemble(path, config, near_ns=near_ns, place_at=place_at),)
    with open_collection(path, parse_rule(config.members)) as found:
        dates = dates_of(found, config)
        if dates.size < 2:
            return without_copies(read_members(found, config, near_ns, place_at).series)
        series = without_copies(read_members(found, config, None, place_at, dates).series)
    first, last = int(dates[0]), int(dates[-1])
    notes = [
        f"the forecast at {len(series)} times, {date_text(first)} to {date_text(last)}, linear between them",
        *(
            note
            for note in series[0].notes
            if not note.startswith(("lead ", "the forecast is of "))
        ),
    ]
    outside = 0 if near_ns is None else max(first - near_ns, near_ns - last)
    if outside > _DAY_NS:
        days = f"{outside / _DAY_NS:.1f} days"
        notes.insert(
            0,
            Caveat(
                f"the log begins {days} outside the forecast's times: the nearest of them holds there"
            ),
        )
    return replace(series[0], notes=tuple(notes)), *(replace(part, notes=()) for part in series[1:])


def dates_of(found: Collection, config: ForecastConfig) -> Times:
    """Return the dated times of all members [ns, UTC], in order; empty if members are themselves of several times.

    Raises:
        ForecastError: A file has a time twice.
    """
    none, fields = np.zeros(0, np.int64), found.members[0]
    # members are of several times themselves, or nothing says what they are
    both = fields[0].lead is not None and fields[0].time is not None
    if both or found.rule.kind in ("", *MADE):
        return none
    by_member = []
    for member in found.members if fields[0].lead is None else [fields]:
        each = [_dates(field, config) for field in member]
        if not all(dates.size for dates in each):
            return none
        by_member.append(np.unique(np.concatenate(each)))
    same = all(np.array_equal(dates, by_member[0]) for dates in by_member)
    return by_member[0] if same else none


def _dates(field: Field, config: ForecastConfig) -> Times:
    """Return the dated leads or times of a field [ns, UTC]."""
    if field.lead is None and field.time is None:
        return np.zeros(0, np.int64)
    dates = steps_of(field, config).valid
    if np.unique(dates).size < dates.size:
        raise ForecastError(
            f"{field.where}: two leads or times of the forecast are the same; choose one with --lead or forecast.time, or mend the file"
        )
    return dates
