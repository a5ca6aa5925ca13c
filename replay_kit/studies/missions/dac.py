"""Estimates from the mean currents of dives alone."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from replay_kit.core.observation import Measurement
from replay_kit.studies.missions.flights import fly_dives, measurements, staying
from replay_kit.studies.missions.rows import Figure, error_figures
from replay_kit.studies.missions.scene import Scene
from replay_kit.studies.twins.glider import GliderLimits

_OVER_MEAN = 0.7
DEPTHS = (500.0, 1000.0)  # m; a glider's dives as the twin has them, and as deep as gliders go


def mean_currents_alone(scene: Scene) -> list[Figure]:
    """Return the figures of some dives of the mission, and of a mission of dives only for each depth; the error is that after the last."""
    dives = scene.job.dives
    missions = {f"{dives} dives spread over the mission": _spread(measurements(scene.flight, pings=False, mean_currents=True), dives)}
    for depth in DEPTHS:
        fly = partial(fly_dives, scene.flight.sea, dives, scene.job.noise, GliderLimits(max_depth=depth))
        flight = staying(fly, scene.flight.seed)
        missions[f"{dives} dives to {depth:g} m, one after the other"] = measurements(flight, pings=False, mean_currents=True)[:dives]
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
    wanted = np.round(np.linspace(len(given) / count, len(given), count)).astype(int) - 1 if count < len(given) else range(len(given))
    return tuple(given[k] for k in wanted)
