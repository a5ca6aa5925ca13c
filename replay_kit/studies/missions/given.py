"""What an estimator is given: profiles relative to the platform, pings that are wrong as a whole, mean currents alone."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from replay_kit.core.observation import Measurement, Observation
from replay_kit.studies.missions.flights import fly_dives, measurements, staying
from replay_kit.studies.missions.rows import RMSE, Figure, error_figures
from replay_kit.studies.missions.scene import Scene, own_estimator
from replay_kit.studies.twins.adcp import OUTLIER, Faults
from replay_kit.studies.twins.glider import GliderLimits

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
