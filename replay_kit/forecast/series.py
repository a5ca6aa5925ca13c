"""An ensemble forecast at all of its dated times: leads after a reference time, or times of a file."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import xarray as xr

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.forecast.names import find_lead, find_member, find_time, find_velocity
from replay_kit.forecast.reader import open_forecast, read_ensemble
from replay_kit.forecast.times import dated_leads

_DAY_NS = 86_400 * 10**9


def read_series(
    path: Path, config: ForecastConfig, *, near_ns: int | None = None, place_at: tuple[float, float] | None = None
) -> tuple[Ensemble, ...]:
    """Return the forecast at each of its dated times, in order; one alone where it has no more, or where one was chosen.

    Args:
        path: NetCDF file or Zarr store.
        config: Region and levels; a lead or a time chosen here leaves one alone.
        near_ns: As in ``read_ensemble``.
        place_at: As in ``read_ensemble``.

    Raises:
        ForecastError: As in ``read_ensemble``, or land is not the same at all times.
    """
    if config.lead is not None or config.time is not None:
        return (read_ensemble(path, config, near_ns=near_ns, place_at=place_at),)
    with open_forecast(path) as ds:
        chosen = _choices(ds, config, str(path))
    if len(chosen) < 2:
        return (read_ensemble(path, config, near_ns=near_ns, place_at=place_at),)
    series = [read_ensemble(path, config.model_copy(update=choice), place_at=place_at) for choice in chosen]
    times = [int(part.time_ns or 0) for part in series]
    if any(after <= before for before, after in pairwise(times)):
        raise ForecastError(
            f"{path}: two leads or times of the forecast are the same; choose one with --lead or forecast.time, or mend the file"
        )
    for member in series[1:]:
        if not np.array_equal(member.grid.wet, series[0].grid.wet):
            raise ForecastError(
                f"{path}: land is not the same at all times of the forecast; choose one with --lead or forecast.time, or mend its mask"
            )
    notes = tuple(note for note in series[0].notes if not note.startswith(("lead ", "the forecast is of ")))
    first, last = (np.datetime_as_string(np.datetime64(part.time_ns, "ns"), unit="m") for part in (series[0], series[-1]))
    notes = (f"the forecast at {len(series)} times, {first}Z to {last}Z, linear between them", *notes)
    outside = 0 if near_ns is None else max(times[0] - near_ns, near_ns - times[-1])
    if outside > _DAY_NS:
        notes = (f"the log begins {outside / _DAY_NS:.1f} days outside the forecast's times: the nearest of them holds there", *notes)
    return tuple(Ensemble(part.grid, part.velocity, part.time_ns, part.source, notes if k == 0 else ()) for k, part in enumerate(series))


def _choices(ds: xr.Dataset, config: ForecastConfig, where: str) -> list[dict[str, object]]:
    """Return the settings that choose each dated time in turn, in order."""
    u, _, _ = find_velocity(ds, where)
    lead, time = find_lead(ds, u.dims), find_time(ds, u.dims)
    if find_member(ds, u.dims) is None or (lead is not None and time is not None):
        return []
    if lead is not None:
        return [{"lead": value} for value, time_ns in sorted(dated_leads(ds, lead, config), key=lambda pair: pair[1])]
    if time is not None:
        times = np.unique(ds[time].values.astype("datetime64[ns]"))
        return [{"time": str(value)} for value in times]
    return []
