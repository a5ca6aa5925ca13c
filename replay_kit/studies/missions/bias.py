"""Errors of compass and scale: whether a run names them, how well it estimates them, and the error of the estimate."""

import math
from functools import partial

import numpy as np

from replay_kit.estimator.evolving import EvolvingEstimator, build_evolving
from replay_kit.studies.missions.flights import fly_pings, measurements, pinging_seconds, staying
from replay_kit.studies.missions.follow import Followed
from replay_kit.studies.missions.given import KNOWN_STD
from replay_kit.studies.missions.rows import RMSE, Figure, error_figures
from replay_kit.studies.missions.scene import Scene
from replay_kit.studies.twins.adcp import Faults
from replay_kit.studies.twins.messages import Flight

HEADING_DEG, SCALE = 5.0, 0.03
PLANTED = {"heading": math.radians(HEADING_DEG), "scale": SCALE}
_OVER_CLEAN = 1.1
# a scale error of 3 % is 8 mm/s at a glider's speed: significant after a thousand pings, not after a few hundred
_DAYS, _EVERY_S = 10.0, 600.0
# standard deviations from zero at which a bias counts as found
_FOUND = 3.0
_UNIT = {"heading": ("degrees", math.degrees(1.0)), "scale": ("%", 100.0), "shear": ("1/s", 1.0)}


def biases(scene: Scene) -> list[Figure]:
    """Return the figures of one mission."""
    flight = _dense(scene)
    sound = measurements(flight, Faults("platform", KNOWN_STD))
    biased = measurements(flight, Faults("platform", KNOWN_STD, HEADING_DEG, SCALE))
    time = scene.config.time.model_copy(update={"biases": ("heading", "scale")})
    estimating = build_evolving(
        scene.case.forecasts, scene.config.estimator, time, scene.config.gating
    )
    clean = scene.errors("sound", scene.own, sound)
    figures = [
        Figure("sound, without bias states", RMSE, clean.mean()),
        *clean.nis("sound, without bias states"),
        *_named("sound, without bias states", clean, planted=False),
    ]
    for method, estimator, given, most in (
        ("biased, without bias states", scene.own, biased, np.nan),
        ("biased, with bias states", estimating, biased, _OVER_CLEAN),
        ("sound, with bias states", estimating, sound, _OVER_CLEAN),
    ):
        followed = scene.errors(method, estimator, given)
        figures += [
            *error_figures(method, followed.mean(), "the sound one's", clean.mean(), most),
            *followed.nis(method),
            *(
                _named(method, followed, planted=True)
                if estimator is scene.own
                else _found(method, estimating, followed, given is biased)
            ),
        ]
    return figures


def _dense(scene: Scene) -> Flight:
    """Return a mission that pings every ten minutes, as an instrument does."""
    field, days = scene.flight.field, min(scene.job.days, _DAYS)
    pings = max(1, int(pinging_seconds(field, days) / _EVERY_S))
    return staying(partial(fly_pings, field, pings, days, scene.job.noise), scene.flight.seed)


def _named(method: str, followed: Followed[float], planted: bool) -> list[Figure]:
    """Return which errors a run that estimates none of them names as significant."""
    significant = followed.state.bias_score.significant()
    figures = []
    for name in PLANTED:
        unit, factor = _UNIT[name]
        least, most = (1.0, np.nan) if planted else (np.nan, 0.0)
        figures.append(
            Figure(
                method, f"{name} is named", float(name in significant), at_least=least, at_most=most
            )
        )
        if name in significant:
            figures.append(
                Figure(method, f"{name} as named [{unit}]", factor * significant[name][0])
            )
    figures.append(
        Figure(method, "shear is named, wrongly", float("shear" in significant), at_most=0.0)
    )
    return figures


def _found(
    method: str, estimator: EvolvingEstimator, followed: Followed[float], planted: bool
) -> list[Figure]:
    """Return each estimated bias, in standard deviations from zero, and its error."""
    figures = []
    for name, (mean, std) in estimator.biases(followed.state).items():
        unit, factor = _UNIT[name]
        true = PLANTED[name] if planted else 0.0
        least, most = (_FOUND, np.nan) if planted else (-_FOUND, _FOUND)
        figures += [
            Figure(method, f"{name} [{unit}]", factor * mean),
            Figure(method, f"{name}, standard deviation [{unit}]", factor * std),
            Figure(
                method,
                f"{name} over its standard deviation",
                mean / std,
                at_least=least,
                at_most=most,
            ),
            Figure(method, f"{name}, error over its standard deviation", (mean - true) / std),
        ]
    return figures
