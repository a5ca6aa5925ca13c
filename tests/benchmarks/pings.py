"""``python -m tests.benchmarks pings``: error and stated uncertainty of the estimate after some profiles at random places of a truth.

A truth is another file, or a member left out with its copies. A profile has 22 bins of 32 m, each with a noise of 9 cm/s. Scored are the
wet points of the forecast's grid. ``relative_error`` is the RMS length of the error over the RMS speed of the truth; ``coverage_90`` the
share of components in their 90 % intervals; ``crps`` the continuous ranked probability score of a component [m/s], that of a normal
distribution with the stated standard error (Gneiting and Raftery 2007, eq. 21).

Not measured are points above the first or below the last bin of all profiles that has water, and those farther from every profile than the
set's ``length`` along the ground: ``crps_elsewhere`` is that of them alone.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import norm

import replay_kit as rk
from replay_kit import Ensemble, FlowEstimate, Observation
from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.estimator import build
from replay_kit.forecast import read_truth
from replay_kit.studies.paper.cases import random_observations
from replay_kit.studies.twins.field import build_field
from tests.benchmarks.measure import Row, row
from tests.places import DATA, SAMPLES

COUNTS, SEEDS, NOISE = (5, 10, 25, 50, 150, 450), (0, 1, 2), 0.09
#: Figures of an estimate that are one number; ``coverage_by_level`` is a list.
FIGURES = ("relative_error", "coverage_90", "crps", "crps_elsewhere")
_90 = 1.6448536269514722


@dataclass(frozen=True, slots=True)
class Sea:
    """A forecast and a truth.

    Attributes:
        ensemble: Its file.
        length: Correlation length of the currents [km]; part of the definition of what was not measured.
        truth: A file; None where a member is left out.
        member: The member left out, from 0.
        lead: Of the forecast [days]; None where it has none.
    """

    ensemble: Path
    length: float
    truth: Path | None = None
    member: int = 0
    lead: float | None = None

    def read(self) -> tuple[Ensemble, Ensemble]:
        """Return the members that do not know the truth, and the truth."""
        settings = {} if self.lead is None else {"forecast": {"lead": self.lead}}
        members = rk.open_ensemble(self.ensemble, settings=settings)
        if self.truth is not None:
            return members, read_truth(str(self.truth), ForecastConfig())
        wet = members.velocity[:, :, members.grid.wet]
        other = np.abs(wet - wet[self.member]).max(axis=(1, 2)) > 1e-6
        return _of(members, other), _of(members, np.arange(len(wet)) == self.member)


def _of(members: Ensemble, chosen) -> Ensemble:
    return Ensemble(members.grid, members.velocity[chosen], members.time_ns, members.source)


SEAS = {
    "natl_nemo": Sea(
        DATA / "natl_nemo" / "ensemble.nc", 43.0, truth=DATA / "natl_nemo" / "truth.nc"
    ),
    "qg_forecast": Sea(DATA / "qg" / "forecast.nc", 22.0, member=20, lead=8.0),
    "qg_climatology": Sea(DATA / "qg" / "climatology.nc", 42.0, member=40),
    "sample": Sea(SAMPLES / "ensemble.nc", 22.0, truth=SAMPLES / "truth.nc"),
}


def estimates(
    ensemble: Ensemble, surveys: Sequence[Sequence[Observation]], counts: Sequence[int]
) -> Iterator[list[FlowEstimate]]:
    """Yield the estimates of each survey after some numbers of profiles, as the estimator makes them by default.

    All that is particular to an estimator is here.
    """
    estimator = build([ensemble], EstimatorConfig())
    for profiles in surveys:
        state, done, flows = estimator.initial(), 0, list[FlowEstimate]()
        for n in counts:
            state, _ = estimator.assimilate(state, profiles[done:n])
            done = n
            flows.append(estimator.flow(state))
        yield flows


def scores(
    sea: Sea, counts: Sequence[int] = COUNTS, seeds: Sequence[int] = SEEDS
) -> dict[str, dict[str, Any]]:
    """Return the figures of a set by number of profiles and seed."""
    ensemble, truth = sea.read()
    field = build_field(truth)
    # of as many profiles always: the first of them depend on their number
    surveys = [random_observations(field, COUNTS[-1], NOISE, seed)[: max(counts)] for seed in seeds]
    found: dict[str, dict[str, Any]] = {str(n): {} for n in counts}
    of_each = estimates(ensemble, surveys, counts)
    for seed, profiles, after in zip(seeds, surveys, of_each, strict=True):
        for n, estimate in zip(counts, after, strict=True):
            elsewhere = _elsewhere(truth, profiles[:n], sea.length)
            found[str(n)][str(seed)] = _scored(estimate, truth, elsewhere)
    return found


def means(found: Mapping[str, Mapping[str, Any]]) -> dict[str, list[float | None]]:
    """Return the means over the seeds of each figure, by number of profiles in order; None where nothing is to be scored.

    Args:
        found: As ``scores`` gives it.
    """
    return {
        figure: [
            None
            if (values := [one[figure] for one in of_seed.values()])[0] is None
            else float(np.mean(values))
            for of_seed in found.values()
        ]
        for figure in FIGURES
    }


def _points(truth: Ensemble) -> tuple[np.ndarray, ...]:
    """Return the positions of a truth's wet points in its grid: levels, rows, columns."""
    return np.nonzero(truth.grid.wet)


def _elsewhere(truth: Ensemble, profiles: Sequence[Observation], length: float) -> np.ndarray:
    """Return which wet points of a truth are where nothing was measured, shape (P,)."""
    grid, (level, *at) = truth.grid, _points(truth)
    known = np.any([np.isfinite(one.velocity).all(axis=1) for one in profiles], axis=0)
    bins = profiles[0].depth[known]
    places = np.array([(one.longitude, one.latitude) for one in profiles])
    tree = cKDTree(np.column_stack(to_local(grid.projection, *places.T)))
    away, _ = tree.query(np.column_stack([grid.east[*at], grid.north[*at]]))
    depth = grid.levels[level]
    return (away > 1e3 * length) | (depth < bins.min()) | (depth > bins.max())


def _scored(estimate: FlowEstimate, truth: Ensemble, elsewhere) -> dict[str, Any]:
    """Return the figures of an estimate at the wet points of a truth."""
    grid, (level, *at) = truth.grid, _points(truth)
    place = grid.longitude[*at], grid.latitude[*at]
    said = estimate.velocity_at(*place, grid.levels[level])
    true = rotate_to_geographic(grid.projection, *place, *truth.velocity[0][:, level, *at])
    error = np.stack([said.u, said.v]) - np.stack(true)
    std = np.stack([said.u_standard_error, said.v_standard_error])
    inside = np.abs(error) <= _90 * std
    crps = crps_normal(error, std)
    return {
        "relative_error": float(np.sqrt(np.sum(error**2) / np.sum(np.square(true)))),
        "coverage_90": float(inside.mean()),
        "crps": float(crps.mean()),
        "crps_elsewhere": float(crps[:, elsewhere].mean()) if elsewhere.any() else None,
        "coverage_by_level": [float(inside[:, level == k].mean()) for k in range(grid.levels.size)],
    }


def crps_normal(error, std) -> np.ndarray:
    """Return the continuous ranked probability score of normal distributions by their error and standard deviation."""
    z = error / std
    of_unit: np.ndarray = z * (2.0 * norm.cdf(z) - 1.0) + 2.0 * norm.pdf(z) - 1.0 / np.sqrt(np.pi)
    return std * of_unit


def rows(tiny: bool) -> list[Row]:
    """Return a row for each set: its figures, means over the seeds, by number of profiles."""
    counts, seeds = ((5,), (0,)) if tiny else (COUNTS, SEEDS)
    made = []
    for name, sea in SEAS.items():
        if name == "sample" or not (tiny or not sea.ensemble.exists()):
            began = time.process_time()
            found = means(scores(sea, counts, seeds))
            made.append(row(name, time.process_time() - began, pings=list(counts), **found))
    return made
