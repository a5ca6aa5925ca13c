"""A compass and a scale that err: whether a run says so, whether it finds how much, and what the estimate is worth then."""

import math
from functools import partial
from typing import get_args

import numpy as np

from replay_kit.config.time import Bias
from replay_kit.estimator.evolving import EvolvingEstimator
from replay_kit.studies.missions.flights import Flight, fly_pings, measurements, pinging_seconds, staying
from replay_kit.studies.missions.follow import Followed, Own
from replay_kit.studies.missions.relative import KNOWN_STD
from replay_kit.studies.missions.rows import Figure
from replay_kit.studies.missions.scene import Scene, own_estimator
from replay_kit.studies.missions.through_time import RMSE
from replay_kit.studies.twins.faults import Faults

STUDY = "bias"
HEADING_DEG, SCALE = 5.0, 0.03
PLANTED = {"heading": math.radians(HEADING_DEG), "scale": SCALE}
_OVER_CLEAN = 1.1
# a scale error of 3 % is 8 mm/s of a glider's way: a thousand pings tell it, a few hundred do not
_DAYS, _EVERY_S = 10.0, 600.0
# standard deviations from nothing at which a bias counts as found
_FOUND = 3.0
_UNIT = {"heading": ("degrees", math.degrees(1.0)), "scale": ("%", 100.0), "shear": ("1/s", 1.0)}


def biases(scene: Scene) -> list[Figure]:
    """Return the figures of one mission."""
    flight = _dense(scene)
    sound = measurements(flight, Faults("platform", KNOWN_STD))
    biased = measurements(flight, Faults("platform", KNOWN_STD, HEADING_DEG, SCALE))
    time = scene.config.time.model_copy(update={"biases": ("heading", "scale")})
    looking = own_estimator(scene.case, scene.config.model_copy(update={"time": time}))
    clean = scene.errors("sound", scene.own, sound)
    figures = [
        Figure(STUDY, "sound, not looked for", RMSE, clean.mean()),
        *clean.nis(STUDY, "sound, not looked for"),
        *_named("sound, not looked for", clean, planted=False),
    ]
    for method, estimator, given, most in (
        ("biased, not looked for", scene.own, biased, np.nan),
        ("biased, looked for", looking, biased, _OVER_CLEAN),
        ("sound, looked for", looking, sound, _OVER_CLEAN),
    ):
        followed = scene.errors(method, estimator, given)
        figures += [
            Figure(STUDY, method, RMSE, followed.mean()),
            Figure(STUDY, method, "RMSE over the sound one's", followed.mean(), clean.mean(), at_most=most),
            *followed.nis(STUDY, method),
            *(_named(method, followed, planted=True) if estimator is scene.own else _found(method, looking, followed, given is biased)),
        ]
    return figures


def _dense(scene: Scene) -> Flight:
    """Return a mission that pings every ten minutes, as an instrument does."""
    sea, days = scene.flight.sea, min(scene.job.days, _DAYS)
    pings = max(1, int(pinging_seconds(sea, days) / _EVERY_S))
    return staying(partial(fly_pings, sea, pings, days, scene.job.noise), scene.flight.seed)


def _named(method: str, followed: Followed[float], planted: bool) -> list[Figure]:
    """Return the errors that are significant in the log of a run that estimates none."""
    significant = followed.state.bias_score.significant()
    figures = []
    for name in PLANTED:
        unit, factor = _UNIT[name]
        least, most = (1.0, np.nan) if planted else (np.nan, 0.0)
        figures.append(Figure(STUDY, method, f"{name} is named", float(name in significant), at_least=least, at_most=most))
        if name in significant:
            figures.append(Figure(STUDY, method, f"{name} as named [{unit}]", factor * significant[name][0]))
    figures.append(Figure(STUDY, method, "shear is named, wrongly", float("shear" in significant), at_most=0.0))
    return figures


def _found(method: str, estimator: Own, followed: Followed[float], planted: bool) -> list[Figure]:
    """Return each bias as found, how far it is from nothing, and from what was planted."""
    assert isinstance(estimator, EvolvingEstimator), "biases are estimated through time only"
    figures = []
    for name, (mean, std) in estimator.biases(followed.state).items():
        assert name in get_args(Bias)
        unit, factor = _UNIT[name]
        true = PLANTED[name] if planted else 0.0
        least, most = (_FOUND, np.nan) if planted else (-_FOUND, _FOUND)
        figures += [
            Figure(STUDY, method, f"{name} [{unit}]", factor * mean),
            Figure(STUDY, method, f"{name}, standard deviation [{unit}]", factor * std),
            Figure(STUDY, method, f"{name} over its standard deviation", mean / std, at_least=least, at_most=most),
            Figure(STUDY, method, f"{name}, error over its standard deviation", (mean - true) / std),
        ]
    return figures
