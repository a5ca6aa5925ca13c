"""A current beside the estimate: how well the mean currents of coming dives are foretold with it, and with the estimate alone.

Members are left out in turn and dived through, with a uniform Ornstein-Uhlenbeck current on top, or none. After some dives the mean
current is foretold one dive ahead and several. Errors are RMS lengths, and the share of what came that the ellipses of 90 % held.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.config.run import EstimatorConfig, ForecastConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth_means import depth_means
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.observation import PathMean, Source
from replay_kit.estimator import build_estimator
from replay_kit.estimator.next_dive.flight import local_current, local_step
from replay_kit.forecast import read_ensemble
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.truths import leave_out
from tests import synthetic
from tests.benchmarks.measure import Row, row
from tests.places import DATA

_SEAS = {
    "North Atlantic": DATA / "natl_nemo" / "ensemble.nc",
    "quasi-geostrophic": DATA / "qg" / "forecast.nc",
}
_BEGIN, _DIVE, _SPEED, _NOISE = 1_600_000_000, 10_800, 0.25, 0.02
_AHEAD, _AFTER = (1, 4, 16), (3, 6, 9, 12)
_DIVES = 28
# m/s and s: none, and two seas with one
_CURRENTS = ((0.0, 86_400.0), (0.05, 345_600.0), (0.1, 86_400.0))
# Radius of 90 % of a Gaussian in the plane, squared.
_NINETY = -2.0 * np.log(0.1)


@dataclass(frozen=True, slots=True, eq=False)
class _Foretold:
    """One mean current: dives ahead, error, covariances of the estimate, expected current beside it and its variance."""

    ahead: int
    error: Array
    cov: Array
    beside: Array
    variance: float


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    seas = [name for name, path in _SEAS.items() if path.exists()]
    if tiny or not seas:
        return [
            _row("synthetic", synthetic.ensemble(n_members=6, shape=(8, 9)), current, 1, 1, 12)
            for current in _CURRENTS[-1:]
        ]
    return [
        _row(name, ensemble, current, 5, 3, 60)
        for name in seas
        for ensemble in (read_ensemble(_SEAS[name], ForecastConfig()),)
        for current in _CURRENTS
    ]


def _row(
    sea: str, ensemble: Any, current: tuple[float, float], members: int, missions: int, modes: int
) -> dict[str, Any]:
    spent = {"estimate": 0.0, "beside": 0.0}
    found: list[_Foretold] = []
    for member in range(members):
        case = leave_out(ensemble, member)
        estimator, field = (
            build_estimator(case.ensemble, EstimatorConfig(modes=modes)),
            build_field(case.truth),
        )
        for mission in range(missions):
            found += _mission(
                estimator, field, np.random.default_rng([member, mission]), current, spent
            )
    error = {}
    for ahead in _AHEAD:
        chosen = [one for one in found if one.ahead == ahead]
        for name, reckons in (("alone", 0.0), ("beside", 1.0)):
            off = np.array([one.error - reckons * one.beside for one in chosen])
            cov = np.array(
                [one.cov + (reckons * one.variance + 1e-8) * np.eye(2) for one in chosen]
            )
            square = np.einsum("ni,ni->n", off, np.linalg.solve(cov, off[..., None])[..., 0])
            error |= {
                f"rms_{name}_{ahead}": float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
                f"held_{name}_{ahead}": float(np.mean(square < _NINETY)),
            }
    name = f"{sea}, {100.0 * current[0]:.0f} cm/s beside the members over {current[1] / 3600.0:.0f} h: 0.9 held asked"
    return row(
        name, spent["beside"], "the estimate alone", error=error, estimate_s=spent["estimate"]
    )


def _mission(
    estimator: Any,
    field: Any,
    rng: np.random.Generator,
    current: tuple[float, float],
    spent: dict[str, float],
) -> Iterator[_Foretold]:
    grid, depth = field.grid, np.linspace(2.0, min(field.grid.levels[-1], 500.0) - 1.0, 24)
    track, truth = _track(field, rng, depth)
    truth = truth + _course(rng, *current)
    state, local = estimator.initial(), None
    flow = estimator.flow(state)
    weights = depth_weights(flow.depth_functions, depth, grid.levels).mean(axis=0)
    for k in range(_DIVES):
        if k in _AFTER:
            flow, beside = estimator.flow(state), local_current(local)
            means = depth_means(flow, weights[None])
            for ahead in _AHEAD:
                at = k - 1 + ahead
                modes = np.einsum("cr,rk->ck", means.modes(track[at : at + 1])[0], means.root)
                expected = flow.velocity(*track[at], depth).mean(axis=0)
                middle_ns = (_BEGIN + at * _DIVE + _DIVE // 2) * 10**9
                yield _Foretold(
                    ahead,
                    truth[at] - expected,
                    modes @ modes.T,
                    beside.velocity(middle_ns),
                    beside.standard_error(middle_ns) ** 2,
                )
        mean = _measured(grid, track[k], depth, truth[k] + _NOISE * rng.standard_normal(2), k)
        began = time.process_time()
        state, innovation = estimator.step(state, mean)
        between = time.process_time()
        local = local_step(
            local,
            mean.time_ns - _DIVE * 10**9 // 2,
            innovation.innovation[0],
            innovation.innovation_std[0],
        )
        spent["estimate"] += between - began
        spent["beside"] += time.process_time() - between


def _track(field: Any, rng: np.random.Generator, depth: Array) -> tuple[Array, Array]:
    """Return a straight track that stays in the water, shape (dives, 2) [m], and the truth's mean current at its points."""
    along = _SPEED * _DIVE * (np.arange(_DIVES) + 0.5)
    while True:
        begin, angle = (
            field.grid.nodes[rng.integers(len(field.grid.nodes))],
            rng.uniform(0.0, 2.0 * np.pi),
        )
        track = begin + along[:, None] * np.array([np.cos(angle), np.sin(angle)])
        truth = field.velocity(track[:, :1], track[:, 1:], depth).mean(axis=1)
        if np.isfinite(truth).all():
            return track, truth


def _course(rng: np.random.Generator, std: float, scale: float) -> Array:
    """Return an Ornstein-Uhlenbeck current at the dives, shape (dives, 2) [m/s]."""
    kept, course = np.exp(-_DIVE / scale), [std * rng.standard_normal(2)]
    for _ in range(_DIVES - 1):
        course.append(kept * course[-1] + std * np.sqrt(1.0 - kept**2) * rng.standard_normal(2))
    return np.array(course)


def _measured(grid: Any, place: Array, depth: Array, velocity: Array, dive: int) -> PathMean:
    longitude, latitude = (
        np.full(depth.size, float(value)) for value in to_geographic(grid.projection, *place)
    )
    begin = _BEGIN + dive * _DIVE
    times = (begin + np.linspace(60, _DIVE - 60, depth.size).astype(np.int64)) * 10**9
    error = float(np.hypot(_NOISE, 60.0 / _DIVE))
    source, weight = Source(0, "/dac", dive, int(times[-1])), np.full(depth.size, 1.0 / depth.size)
    east, north = velocity.tolist()
    return PathMean(
        (begin + _DIVE) * 10**9,
        times,
        longitude,
        latitude,
        depth,
        weight,
        (east, north),
        error,
        "dac",
        dive + 1,
        source,
    )
