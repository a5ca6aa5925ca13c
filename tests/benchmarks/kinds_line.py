"""Lines of a glider through seas that are known: the geopotential that its CTD sees, and the mean currents of its dives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import gsw
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import lsqr

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig, ForecastConfig, RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.observation import Observation, PathMean
from replay_kit.estimator import ReducedBasisEstimator, build_estimator
from replay_kit.forecast import read_ensemble
from replay_kit.measurements.section.hydrography import Section
from replay_kit.measurements.section.noise import garrett_munk
from replay_kit.measurements.section.thermal_wind import (
    depth_weights,
    geopotential_matrix,
)
from replay_kit.measurements.steps.water import for_region
from replay_kit.studies.twins.field import Field, build_field
from tests.places import DATA

_NS, _DAY = 1e9, 86_400.0
_SPACING, _SPEED = 2200.0, 0.28  # m between profiles, m/s over the ground
_MEAN_STD = 0.02
_PRIOR_LEAD, _LEADS = 8.0, (6.0, 8.0, 10.0, 12.0)
# members that are copies of each other
_COPIES = {3: 4, 4: 3, 38: 45, 45: 38}


@dataclass(frozen=True, eq=False)
class Sea:
    """A truth and its forecast.

    Attributes:
        ensemble: Without the truth.
        estimator: Of the ensemble, as a replay builds it.
        truth: shape (T, 2, Z, J, I) [m/s], local axes, at the times.
        days: shape (T,).
    """

    ensemble: Ensemble
    estimator: ReducedBasisEstimator
    truth: Array
    days: Array

    @property
    def grid(self) -> Grid:
        """Of the forecast."""
        return self.ensemble.grid

    @cached_property
    def fields(self) -> tuple[list[Field], list[Field]]:
        """The truth at its times, and its stream function [m2/s], twice."""
        psi = [np.stack([stream_function(self.grid, each)] * 2) for each in self.truth]
        one = replace(self.ensemble, time_ns=None)
        of_truth, of_psi = (
            [build_field(replace(one, velocity=each[None])) for each in values]
            for values in (self.truth, psi)
        )
        return of_truth, of_psi

    @property
    def coriolis(self) -> float:
        """Coriolis parameter [1/s]."""
        return float(gsw.f(self.grid.projection.latitude))

    @cached_property
    def speed(self) -> float:
        """RMS speed of the ensemble as a replay takes it [m/s]."""
        return for_region(RunConfig(), self.ensemble).measurements.regional_speed or 0.0


def quasi_geostrophic(members: Sequence[int], climatology: bool) -> list[Sea]:
    """Return members of the forecast as truths, each with the climatology, or the others of one lead, as ensemble."""
    path = DATA / "qg" / "forecast.nc"
    read = {lead: read_ensemble(path, ForecastConfig(lead=lead)) for lead in _LEADS}
    prior = read[_PRIOR_LEAD]
    left = [k for k in range(prior.n_members) if not {k, _COPIES.get(k)} & set(members)]
    others = Ensemble(prior.grid, prior.velocity[left], prior.time_ns, prior.source)
    if climatology:
        others = read_ensemble(DATA / "qg" / "climatology.nc", ForecastConfig())
    estimator = build_estimator(others, EstimatorConfig(), GatingConfig())
    truths = (np.stack([read[lead].velocity[k] for lead in _LEADS]) for k in members)
    return [Sea(others, estimator, truth, np.array(_LEADS)) for truth in truths]


def stream_function(grid: Grid, velocity: Array) -> Array:
    """Return the stream function whose differences along the grid's edges are nearest to velocities, shape (Z, J, I) [m2/s].

    Args:
        grid: Of J x I columns.
        velocity: shape (2, Z, J, I) [m/s], taken as a cubic spline along each row and column.
    """
    number = np.arange(grid.east.size).reshape(grid.east.shape)
    pairs, found = [], []
    for axis in (0, 1):
        at = np.arange(number.shape[axis])
        integral = CubicSpline(at, velocity, axis=axis + 2).antiderivative()(at)
        u, v = np.diff(integral, axis=axis + 2)
        dx, dy = (np.diff(each, axis=axis) for each in (grid.east, grid.north))
        found.append((v * dx - u * dy).reshape(len(u), -1))
        pairs.append(
            np.column_stack([np.take(number, ends, axis).ravel() for ends in (at[:-1], at[1:])])
        )
    edges, right = np.concatenate(pairs), np.concatenate(found, axis=1)
    row_of = np.repeat(np.arange(len(edges)), 2)
    signs = np.tile([-1.0, 1.0], len(edges))
    matrix = coo_matrix((signs, (row_of, edges.ravel())), (len(edges), number.size)).tocsr()
    psi = [lsqr(matrix, each, atol=1e-10, btol=1e-10)[0] for each in right]
    return np.reshape(psi, (-1, *number.shape))


@dataclass(frozen=True, eq=False)
class Line:
    """A glider's line through a sea, of n profiles on Z levels.

    Attributes:
        along: shape (n,) [m], from the first profile.
        seconds: shape (n,), from the first.
        places: shape (n, 2) [m], local east and north.
        direction: Counter-clockwise from east [rad].
        levels: shape (Z,) [m].
        geopotential: shape (n, Z) [m2/s2], of the truth at the time of each profile, with waves.
        truth: shape (T, n, Z, 2) [m/s], at the profiles' places.
        truth_seconds: shape (T,), of it.
    """

    along: Array
    seconds: Array
    places: Array
    direction: float
    levels: Array
    geopotential: Array
    truth: Array
    truth_seconds: Array

    def current(self, seconds: Array) -> Array:
        """Return the current at the profiles' places at a time of each, shape (n, Z, 2) [m/s]."""
        return _in_time(self.truth, self.truth_seconds, np.broadcast_to(seconds, self.along.shape))

    def about_mean(self, current: Array) -> Array:
        """Return currents, shape (..., Z, 2), without their depth mean."""
        mean = np.einsum("z,...zc->...c", depth_weights(self.levels), current)
        return current - mean[..., None, :]


def _in_time(fields: Array, times: Array, seconds: Array) -> Array:
    """Return fields, shape (T, n, ...), at a time of each of n places, linearly between their times."""
    shares = np.stack([np.interp(seconds, times, one) for one in np.eye(times.size)])
    return np.einsum("tn,tn...->n...", shares, fields)


def flown(sea: Sea, length: float, rng: np.random.Generator) -> Line:
    """Return a line at a place and in a direction at random."""
    grid, n = sea.grid, round(length / _SPACING) + 1
    along = np.linspace(0.0, length, n)
    corners = np.quantile([grid.east.ravel(), grid.north.ravel()], (0.1, 0.9), axis=1)
    inside = False
    while not inside:
        direction = rng.uniform(0.0, 2.0 * np.pi)
        unit = np.array([np.cos(direction), np.sin(direction)])
        places = rng.uniform(*corners) + along[:, None] * unit
        inside = bool(np.all((places[-1] > corners[0]) & (places[-1] < corners[1])))
    first = np.ceil(max(grid.levels[0], 10.0) / 10.0) * 10.0
    levels = np.arange(first, grid.levels[-1], 20.0)
    east, north = places.T[..., None]
    truth, psi = (
        np.stack([each.velocity(east, north, levels) for each in fields]) for fields in sea.fields
    )
    seconds, times = along / _SPEED, (sea.days - sea.days[0]) * _DAY
    waves = _waves(levels, seconds, sea.coriolis, rng)
    geopotential = sea.coriolis * _in_time(psi[..., 0], times, seconds)
    geopotential = geopotential - (geopotential @ depth_weights(levels))[:, None] + waves
    return Line(along, seconds, places, direction, levels, geopotential, truth, times)


def _stratification(levels: Array) -> Array:
    return (5.24e-3) ** 2 * np.exp(-2.0 * levels / 1300.0)


def _waves(levels: Array, seconds: Array, coriolis: float, rng: np.random.Generator) -> Array:
    """Return the geopotential of internal waves in each profile, shape (n, Z) [m2/s2], forgotten within 0.4/f."""
    matrix = geopotential_matrix(levels)
    covariance = garrett_munk(levels, _stratification(levels), matrix)
    root = np.linalg.cholesky(covariance + 1e-8 * np.eye(levels.size))
    found = rng.standard_normal((seconds.size, levels.size)) @ root.T
    for k, kept in enumerate(np.exp(-abs(coriolis) / 0.4 * np.diff(seconds)), 1):
        found[k] = kept * found[k - 1] + np.sqrt(1.0 - kept**2) * found[k]
    return found


def section(sea: Sea, line: Line, part: slice) -> Section:
    """Return profiles of a line as a section, whose specific volume has the line's geopotential."""
    along, seconds = line.along[part], line.seconds[part]
    longitude, latitude = to_geographic(sea.grid.projection, *line.places[part].mean(axis=0))
    inverse = np.linalg.pinv(geopotential_matrix(line.levels), rcond=1e-12)
    anomaly = line.geopotential[part] @ inverse.T
    return Section(
        line.levels,
        along - along.mean(),
        seconds - seconds.mean(),
        anomaly - anomaly.mean(axis=0),
        _stratification(line.levels),
        float(latitude),
        float(longitude),
        int(seconds.mean() * _NS),
        line.direction,
    )


def means(sea: Sea, line: Line, rng: np.random.Generator) -> list[PathMean]:
    """Return the mean current of each dive, of two profiles."""
    longitude, latitude = to_geographic(sea.grid.projection, *line.places.T)
    by_profile = np.einsum("z,nzc->nc", depth_weights(line.levels), line.current(line.seconds))
    found = []
    for k in range(0, line.along.size - 1, 2):
        u, v = by_profile[k : k + 2].mean(axis=0) + _MEAN_STD * rng.standard_normal(2)
        ends = [(int(line.seconds[j] * _NS), longitude[j], latitude[j]) for j in (k, k + 1)]
        found.append(Observation.mean(*ends, float(line.levels[-1]), u, v, _MEAN_STD))
    return found
