"""Forecast or truth at all dated times: leads after a reference time, or times of a file."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.core.inputs import exceeds_claim
from replay_kit.core.paths import Paths
from replay_kit.forecast.grids.layout import U
from replay_kit.forecast.members.collection import Collection, open_collection
from replay_kit.forecast.members.rules import MADE, kind_of, parse_rule, without_copies
from replay_kit.forecast.members.times import date_text, dated_leads
from replay_kit.forecast.names import find_lead, find_time
from replay_kit.forecast.reader import read_ensemble, read_members, truth_in

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
        chosen = dated_choices(found, config)
        if len(chosen) < 2:
            return without_copies((read_members(found, config, near_ns, place_at).ensemble,))
        series, reading = list[Ensemble](), None
        for choice in chosen:
            at = config.model_copy(update=choice)
            reading = read_members(found, at, None, place_at, len(chosen), reading)
            series.append(reading.ensemble)
        where = found.source
    series = list(without_copies(series))
    times = [int(part.time_ns or 0) for part in series]
    if any(after <= before for before, after in pairwise(times)):
        raise ForecastError(
            f"{where}: two leads or times of the forecast are the same; choose one with --lead or forecast.time, or mend the file"
        )
    for member in series[1:]:
        if not np.array_equal(member.grid.wet, series[0].grid.wet):
            raise ForecastError(
                f"{where}: land is not the same at all times of the forecast; choose one with --lead or forecast.time, or mend its mask"
            )
    notes = tuple(
        note for note in series[0].notes if not note.startswith(("lead ", "the forecast is of "))
    )
    first, last = (date_text(np.datetime64(part.time_ns, "ns")) for part in (series[0], series[-1]))
    notes = (
        f"the forecast at {len(series)} times, {first} to {last}, linear between them",
        *notes,
    )
    outside = 0 if near_ns is None else max(times[0] - near_ns, near_ns - times[-1])
    if outside > _DAY_NS:
        notes = (
            f"the log begins {outside / _DAY_NS:.1f} days outside the forecast's times: the nearest of them holds there",
            *notes,
        )
    return tuple(replace(part, notes=notes if k == 0 else ()) for k, part in enumerate(series))


def dated_choices(found: Collection, config: ForecastConfig) -> list[dict[str, object]]:
    """Return the settings that choose each dated time, in order; empty if members are themselves of several times."""
    fields = found.members[0]
    ds, dims = fields[0].ds, [dim for dim in fields[0].ds[U].dims if dim != fields[0].member]
    lead, time = find_lead(ds, dims), find_time(ds, dims)
    # members are of several times themselves, or nothing says what they are
    if kind_of(found.rule) in ("", *MADE) or (lead is not None and time is not None):
        return []
    if lead is not None:
        return [
            {"lead": value}
            for value, time_ns in sorted(dated_leads(ds, lead, config), key=lambda pair: pair[1])
        ]
    if time is None or not all(field.times.size for field in fields):
        return []
    times, *others = (
        np.unique(np.concatenate([field.times for field in member])) for member in found.members
    )
    if any(not np.array_equal(times, other) for other in others):
        return []
    return [{"time": str(value)} for value in times]


def read_changing_truth(
    spec: str, config: ForecastConfig, reference_time: str
) -> tuple[Ensemble, ...]:
    """Return a truth at each lead of its file, or at each time if it has no leads, in order.

    Args:
        spec: See ``read_truth``.
        config: See ``read_truth``; the lead is not used, nor all but the first time of a file with leads.
        reference_time: Time of lead 0, ISO 8601 UTC, used if neither file nor configuration states one.

    Raises:
        ForecastError: See ``read_truth``; or the file has a single time, or leads without a unit of time.
    """
    name = spec.partition("#")[0]
    with open_collection(Path(name), None) as found:
        field = found.members[0][0]
        lead, along = field.lead, field.lead or field.time
        values = np.zeros(0) if along is None else field.ds[along].values
        if why := exceeds_claim(Path(name), 16 * field.ds[U].size // field.count):
            raise ForecastError(f"{name}: cannot be read: {why}; mend the file")
        if config.lead is not None or (lead is None and config.time is not None):
            raise ForecastError(
                f"{name}: a changing truth uses all leads and times; remove --lead or forecast.time"
            )
        if len(values) < 2:
            raise ForecastError(
                f"{name}: a changing truth needs a dimension of at least two leads or times, got {len(values)}"
            )
        steps = [{"lead": float(value)} if lead else {"time": str(value)} for value in values]
        first = truth_in(found, spec, config.model_copy(update=steps[0]))
        if first.time_ns is None:
            config = config.model_copy(update={"reference_time": reference_time})
            first = truth_in(found, spec, config.model_copy(update=steps[0]))
        others = (truth_in(found, spec, config.model_copy(update=step)) for step in steps[1:])
        truths = (first, *others)
    if truths[0].time_ns is None:
        raise ForecastError(
            f"{name}: its leads have no unit of time; give the lead's attribute units, such as days"
        )
    return truths
