"""An estimate that changes in time, compared with a static filter, one whose covariance grows at the best rate, and the forecast alone."""

from collections.abc import Sequence

import numpy as np

from replay_kit.config.time import TimeConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Measurement
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving import build_evolving
from replay_kit.estimator.evolving.smoother import smooth
from replay_kit.studies.missions.flights import measurements
from replay_kit.studies.missions.follow import evaluated_after
from replay_kit.studies.missions.rows import RMSE, Figure, error_figures
from replay_kit.studies.missions.scene import Scene, goes_through_time

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
