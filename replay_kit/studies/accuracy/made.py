"""Ensembles made where there is none, of the same truth: lagged forecasts, and anomalies of a long run about one forecast.

They are written as files, as producers write theirs, and read by ``--members lags`` and ``--members times``: what is compared is what a
user of these would get. None of them holds the truth.

The newest forecast is the member opposite to the truth in the ensemble's order. One that was started some days before it differs from it as
other members, another for each start, do after so many days: all lags share the newest one's error, as successive forecasts by one system
do. An ensemble without leads has forecasts that persist: the fields of the long run, those nearest to the truth in its order the newest.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import rotate_to_geographic
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.paths import Paths
from replay_kit.forecast import read_ensemble, read_series
from replay_kit.studies.twins.truths import Case

#: What members can be; the ensemble as it is given first.
KINDS = ("given", "lags", "times")
# Of the truth; the fields of the long run are as many whole years before it.
_TIME = np.datetime64("2020-01-01", "ns")
_YEAR = np.timedelta64(365, "D") + np.timedelta64(6, "h")


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """What ensembles are made of.

    Attributes:
        leads: The ensemble at all its leads but the first, at which members hardly differ; none where it has no leads.
        ages: Of these, the time since the first.
        archive: Fields of a long run as members, on the ensemble's grid.
    """

    leads: tuple[Ensemble, ...]
    ages: tuple[np.timedelta64, ...]
    archive: Ensemble


def read_sources(ensemble: Paths, archive: Paths, config: ForecastConfig) -> Sources:
    """Return what ensembles are made of.

    Args:
        ensemble: Files of the ensemble, with leads or without.
        archive: Files of the fields, whose members are these.
        config: Region, levels and lead.

    Raises:
        ForecastError: The files cannot be read.
    """
    fields = read_ensemble(
        archive, config.model_copy(update={"lead": None, "reference_time": None})
    )
    if config.lead is None:
        return Sources((), (), fields)
    # only the differences between leads matter
    series = read_series(
        ensemble, config.model_copy(update={"lead": None, "reference_time": str(_TIME)})
    )
    times = [np.datetime64(part.time_ns or 0, "ns") for part in series]
    return Sources(series[1:], tuple(time - times[0] for time in times[1:]), fields)


def made_cases(ensemble: Ensemble, case: Case, sources: Sources) -> Iterator[tuple[str, Case]]:
    """Yield a case with the ensemble as given, with lagged forecasts, and with anomalies of the long run, and what its members are.

    Args:
        ensemble: All members.
        case: A truth, and the members that are left.
        sources: What the others are made of.

    Raises:
        ForecastError: The long run is not on the ensemble's grid.
    """
    yield KINDS[0], case
    truth, fields = case.truth.velocity[0], sources.archive.velocity
    if fields.shape[1:] != truth.shape:
        shapes = [" x ".join(map(str, part.shape[-3:])) for part in (fields, truth)]
        raise ForecastError(
            f"{sources.archive.source}: its grid ({shapes[0]}) is not the truth's ({shapes[1]}); choose one --region and --levels"
        )
    apart = [not np.allclose(field, truth, rtol=0.0, atol=1e-9, equal_nan=True) for field in fields]
    place = len(apart) if all(apart) else apart.index(False)
    fields = fields[apart]
    if sources.leads and case.member is not None:
        lags, ages = _lags(ensemble, case.member, sources)
    else:
        order = np.argsort(np.abs(np.flatnonzero(apart) - place), kind="stable")
        lags, ages = list(fields[order]), [np.timedelta64(k, "D") for k in range(len(order))]
        fields = fields[order[1:]]
    with tempfile.TemporaryDirectory() as name:
        folder, grid = Path(name), case.truth.grid
        for age, field in zip(ages, lags, strict=True):
            _write(
                folder / f"started_{_TIME - age}.nc".replace(":", ""),
                grid,
                [field],
                [_TIME],
                _TIME - age,
            )
        lagged = read_ensemble(folder, ForecastConfig(members="lags"))
        years = _TIME - np.arange(len(fields), -1, -1) * _YEAR
        _write(folder / "archive.nc", grid, [*fields, lags[0]], years)
        of_season = read_ensemble(
            folder / "archive.nc", ForecastConfig(members="times:15d", time=str(_TIME))
        )
    for kind, made in zip(KINDS[1:], (lagged, of_season), strict=True):
        yield kind, Case(case.member, case.truth, made)


def _lags(
    ensemble: Ensemble, truth: int, sources: Sources
) -> tuple[list[Array], list[np.timedelta64]]:
    """Return forecasts of the truth's time, the newest first, and how much earlier than the newest each was started."""
    order = np.roll(np.arange(ensemble.n_members), -truth - ensemble.n_members // 2)
    newest, *others = (int(member) for member in order if member != truth)
    later = [
        at.velocity[member] - at.velocity[newest]
        for at, member in zip(sources.leads, others, strict=False)
    ]
    fields = [ensemble.velocity[newest] + difference for difference in (0.0, *later)]
    return fields, [np.timedelta64(0, "ns"), *sources.ages][: len(fields)]


def _write(
    path: Path,
    grid: Grid,
    fields: Sequence[Array],
    times: Sequence[np.datetime64] | NDArray[np.datetime64],
    started: np.datetime64 | None = None,
) -> None:
    """Write fields of some times, shape (2, Z, J, I) each, as a CF file of one forecast or of a long run."""
    u, v = rotate_to_geographic(
        grid.projection, grid.longitude, grid.latitude, *np.stack(fields, axis=1)
    )
    dims, space = ("time", "depth", "y", "x"), ("y", "x")
    ds = xr.Dataset(
        {
            "uo": (dims, u, {"standard_name": "eastward_sea_water_velocity", "units": "m s-1"}),
            "vo": (dims, v, {"standard_name": "northward_sea_water_velocity", "units": "m s-1"}),
        },
        {
            "time": np.asarray(times, "M8[ns]"),
            "depth": ("depth", grid.levels, {"units": "m", "positive": "down"}),
            "longitude": (space, grid.longitude, {"standard_name": "longitude"}),
            "latitude": (space, grid.latitude, {"standard_name": "latitude"}),
        },
    )
    if started is not None:
        ds = ds.assign_coords(forecast_reference_time=started)
    ds.to_netcdf(path, engine="scipy")
