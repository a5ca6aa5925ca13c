"""Studies of what is measured: relative profiles, outliers, mean currents alone, and biases of compass and scale."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from replay_kit.core.observation import Measurement, Observation
from replay_kit.estimator.evolving import EvolvingEstimator, build_evolving
from replay_kit.studies.missions.flights import (
    fly_dives,
    fly_pings,
    measurements,
    pinging_seconds,
    staying,
)
from replay_kit.studies.missions.follow import RMSE, Figure, Followed, error_figures
from replay_kit.studies.missions.scene import Scene, own_estimator
from replay_kit.studies.twins.adcp import OUTLIER, Faults
from replay_kit.studies.twins.glider import GliderLimits
from replay_kit.studies.twins.messages import Flight

KNOWN_STD = 0.02  # m/s
_OVER_ABSOLUTE, _OVER_ABSOLUTE_KNOWN = 1.25, 1.08
SHARE = 0.1
_OVER_CLEAN = 1.05
_GATES = ("reject", "soften", "off")
_OVER_MEAN = 0.7
DEPTHS = (500.0, 1000.0)  # m; a glider's dives as the twin has them, and as deep as gliders go


def relative(scene: Scene) -> list[Figure]:
    """Return the figures of one mission, whose course and noise are the same each time."""
    known = Faults("platform", KNOWN_STD)
    absolute = scene.errors("absolute", scene.own, measurements(scene.flight))
    with_means = scene.errors("absolute", scene.own, measurements(scene.flight, mean_currents=True))
    figures = [
        Figure("absolute", RMSE, absolute.mean()),
        Figure("absolute, with mean currents", RMSE, with_means.mean()),
    ]
    for method, faults, mean_currents, most in (
        ("unknown platform velocity", Faults("platform"), False, _OVER_ABSOLUTE),
        ("unknown platform velocity, with mean currents", Faults("platform"), True, _OVER_ABSOLUTE),
        ("platform velocity to 2 cm/s", known, False, _OVER_ABSOLUTE_KNOWN),
    ):
        followed = scene.errors(
            method, scene.own, measurements(scene.flight, faults, mean_currents=mean_currents)
        )
        figures += error_figures(
            method, followed.mean(), "that of absolute profiles", absolute.mean(), most
        ) + followed.nis(method)
    return figures


def outliers(scene: Scene) -> list[Figure]:
    """Return the figures of one mission: the run without outliers has the gate of the settings."""
    sound, spoilt = measurements(scene.flight), measurements(scene.flight, Faults(outliers=SHARE))
    wrong = _moved(sound, spoilt)
    clean = scene.errors("without outliers", scene.own, sound)
    figures = [
        Figure("without outliers", RMSE, clean.mean()),
        Figure(
            "without outliers",
            "pings rejected or softened",
            clean.not_accepted(),
            len(clean.innovations),
        ),
    ]
    for gate in _GATES:
        method = f"with outliers, gate {gate}"
        gating = scene.config.gating.model_copy(update={"gate": gate})
        followed = scene.errors(
            method,
            own_estimator(scene.case, scene.config.model_copy(update={"gating": gating})),
            spoilt,
        )
        most = _OVER_CLEAN if gate == scene.config.gating.gate else np.nan
        figures += error_figures(
            method, followed.mean(), "that without outliers", clean.mean(), most
        )
        if gate == "reject":
            caught = followed.not_accepted() - followed.not_accepted(wrong)
            figures += [
                Figure(method, "outliers rejected or softened", caught, len(wrong)),
                Figure(
                    method,
                    "sound pings rejected or softened",
                    followed.not_accepted(wrong),
                    len(followed.innovations) - len(wrong),
                ),
            ]
    return figures


def _moved(sound: Sequence[Measurement], spoilt: Sequence[Measurement]) -> frozenset[int]:
    """Return the times [ns, UTC] of the pings that are outliers."""
    velocity = {of.time_ns: of.velocity for of in sound if isinstance(of, Observation)}
    pairs = [
        (of.time_ns, of.velocity - velocity[of.time_ns])
        for of in spoilt
        if isinstance(of, Observation)
    ]
    return frozenset(
        time_ns for time_ns, off in pairs if (np.hypot(off[:, 0], off[:, 1]) > 0.5 * OUTLIER).any()
    )


def mean_currents_alone(scene: Scene) -> list[Figure]:
    """Return the figures of some dives of the mission, and of a mission of dives only for each depth; the error is that after the last."""
    dives = scene.job.dives
    missions = {
        f"{dives} dives spread over the mission": _spread(
            measurements(scene.flight, pings=False, mean_currents=True), dives
        )
    }
    for depth in DEPTHS:
        fly = partial(
            fly_dives, scene.flight.field, dives, scene.job.noise, GliderLimits(max_depth=depth)
        )
        flight = staying(fly, scene.flight.seed)
        missions[f"{dives} dives to {depth:g} m, one after the other"] = measurements(
            flight, pings=False, mean_currents=True
        )[:dives]
    figures = []
    for method, given in missions.items():
        followed = scene.errors(method, scene.own, given, evaluations=1)
        (error,), mean = followed.values, scene.case.mean_rmse([given[-1].time_ns])
        figures += [
            *error_figures(method, error, "the ensemble mean's", mean, _OVER_MEAN),
            Figure(method, "mean currents", float(len(given))),
            *followed.nis(method),
        ]
    return figures


def _spread(given: Sequence[Measurement], count: int) -> tuple[Measurement, ...]:
    """Return some of the mean currents, evenly spread, the last among them; all where there are fewer."""
    wanted = (
        np.round(np.linspace(len(given) / count, len(given), count)).astype(int) - 1
        if count < len(given)
        else range(len(given))
    )
    return tuple(given[k] for k in wanted)


HEADING_DEG, SCALE = 5.0, 0.03
PLANTED = {"heading": math.radians(HEADING_DEG), "scale": SCALE}
_OVER_SOUND = 1.1
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
        ("biased, with bias states", estimating, biased, _OVER_SOUND),
        ("sound, with bias states", estimating, sound, _OVER_SOUND),
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
