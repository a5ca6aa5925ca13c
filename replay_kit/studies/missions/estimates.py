"""Studies of the estimate: through time against static filters, and the coverage of its intervals now and days ahead."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import ndtri

from replay_kit.config.time import TimeConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Measurement
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving import build_evolving
from replay_kit.estimator.evolving.smoother import smooth
from replay_kit.studies.missions.flights import measurements
from replay_kit.studies.missions.follow import RMSE, Figure, error_figures, evaluated_after, follow
from replay_kit.studies.missions.scene import Scene, goes_through_time
from replay_kit.studies.twins.vehicle import DAY_NS

# a day; the best one is chosen with the truth, which no real static filter could
INFLATIONS = (1.02, 1.05, 1.1, 1.2, 1.4, 2.0)
_OVER_STATIC, _OVER_INFLATED = 0.75, 0.9


def through_time(scene: Scene) -> list[Figure]:
    """Return the figures of one mission."""
    given = measurements(scene.flight)
    own = scene.errors("through time", scene.own, given)
    error = own.mean()
    statics = _statics(scene, given)
    lead = min(statics, key=lambda name: statics[name][1])
    static = statics[lead][1]
    inflation, inflated = _best_inflated(scene, statics[lead][0], given)
    times_ns = [
        given[number - 1].time_ns for number in evaluated_after(len(given), scene.job.evaluations)
    ]
    # no inflation is one of the constants
    peer = min(inflated, static)
    return [
        Figure("ensemble mean", RMSE, scene.case.mean_rmse(times_ns)),
        *(Figure(f"static, {name} time", RMSE, rmse) for name, (_, rmse) in statics.items()),
        Figure("static, best inflation", RMSE, peer),
        Figure(
            "static, best inflation", "best factor a day", inflation if inflated < static else 1.0
        ),
        *error_figures("through time", error, "the best static one's", static, _OVER_STATIC),
        Figure(
            "through time", "RMSE over the best inflated one's", error, peer, at_most=_OVER_INFLATED
        ),
        *own.nis("through time", required=True),
        Figure("through time", "rejected or softened", own.not_accepted(), len(own.innovations)),
        *_smoothed(scene, given, times_ns, error),
    ]


def _statics(scene: Scene, given: Sequence[Measurement]) -> dict[str, tuple[Ensemble, float]]:
    """Return forecasts of one time, each with the error of the static estimator that a replay would build of it."""
    forecasts = scene.case.forecasts
    chosen = {
        "first": forecasts[0],
        "middle": forecasts[len(forecasts) // 2],
        "last": forecasts[-1],
    }
    out = {}
    for name, forecast in chosen.items():
        estimator = build_estimator(forecast, scene.config.estimator, scene.config.gating)
        out[name] = (forecast, scene.errors(f"static, {name} time", estimator, given).mean())
    return out


def _best_inflated(
    scene: Scene, forecast: Ensemble, given: Sequence[Measurement]
) -> tuple[float, float]:
    """Return the constant inflation that errs least, and its error: a plain filter without gate, as those have none that inflate."""
    estimator = build_evolving([forecast], scene.config.estimator, TimeConfig(scale="static"))
    errors = {
        factor: scene.errors(f"inflated by {factor:g} a day", estimator, given, None, factor).mean()
        for factor in INFLATIONS
    }
    best = min(errors, key=lambda factor: errors[factor])
    return best, errors[best]


def _smoothed(
    scene: Scene, given: Sequence[Measurement], times_ns: Sequence[int], filtered: float
) -> list[Figure]:
    if not goes_through_time(scene.case, scene.config):
        return []
    scene.report("smoother")
    estimator = build_evolving(
        scene.case.forecasts, scene.config.estimator, scene.config.time, scene.config.gating
    )
    flows = smooth(estimator, given, times_ns)
    errors = [
        scene.case.flow_rmse(flow, time_ns) for flow, time_ns in zip(flows, times_ns, strict=True)
    ]
    return error_figures("smoother", float(np.mean(errors)), "the filter's", filtered, 1.0)


AHEAD_DAYS = 5.0
OBSERVED_M = 10e3
REQUIRED = {0.5: (0.45, 0.55), 0.9: (0.86, 0.94)}


#: Where, when, which interval, to how many components lie inside, of how many.
_Hits = dict[tuple[str, str, float], tuple[int, int]]


def coverage(scene: Scene) -> list[Figure]:
    """Return the figures of one mission."""
    scene.report("intervals")
    ahead_ns = int(AHEAD_DAYS * DAY_NS)
    last_ns = int(scene.case.times_ns[-1])
    pinged_ns, places = scene.flight.mission.pings.time_ns, scene.flight.places

    def evaluate(flow: FlowEstimate, time_ns: int) -> _Hits:
        near = _near(scene.case.at.points, places[pinged_ns <= time_ns])
        hits = _hits(scene, flow, time_ns, near, "now")
        if scene.case.changes and time_ns + ahead_ns <= last_ns:
            hits |= _hits(
                scene,
                flow.at(time_ns + ahead_ns),
                time_ns + ahead_ns,
                near,
                f"{AHEAD_DAYS:g} days ahead",
            )
        return hits

    followed = follow(scene.own, measurements(scene.flight), scene.job.evaluations, evaluate)
    figures = []
    for key in dict.fromkeys(key for hits in followed.values for key in hits):
        where, when, share = key
        hits, trials = np.sum([hits[key] for hits in followed.values if key in hits], axis=0)
        name = f"share inside {100 * share:g} % intervals"
        figures.append(
            Figure(f"{where} places, {when}", name, float(hits), float(trials), *REQUIRED[share])
        )
    return figures


def _near(points: Array, pinged: Array) -> NDArray[np.bool_]:
    """Return which points, shape (P,), are within ``OBSERVED_M`` of a ping."""
    distance, _ = cKDTree(pinged).query(points)
    return np.asarray(distance <= OBSERVED_M, dtype=np.bool_)


def _hits(
    scene: Scene, flow: FlowEstimate, time_ns: int, near: NDArray[np.bool_], when: str
) -> _Hits:
    place = scene.case.at.place
    error = np.abs(flow.velocity(*place) - scene.case.at_time(scene.case.truth, time_ns))
    std = flow.standard_error(*place)
    out: _Hits = {}
    for where, chosen in (("observed", near), ("unobserved", ~near)):
        for share in REQUIRED:
            inside = (error <= ndtri(0.5 + 0.5 * share) * std)[chosen]
            known = np.isfinite(std[chosen])
            out[where, when, share] = int(inside[known].sum()), int(known.sum())
    return out
