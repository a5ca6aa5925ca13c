"""What mean currents of dives tell when there is nothing else."""

from functools import partial

from replay_kit.experiments.missions.flights import fly_dives, measurements, staying
from replay_kit.experiments.missions.rows import Figure
from replay_kit.experiments.missions.scene import Scene
from replay_kit.experiments.missions.through_time import RMSE
from replay_kit.twin.glider import GliderLimits

STUDY = "dac"
_OVER_MEAN = 0.7
DEPTHS = (500.0, 1000.0)  # m; a glider's dives as the twin has them, and as deep as gliders go


def mean_currents_alone(scene: Scene) -> list[Figure]:
    """Return the figures of one mission for each depth of dives; its error is that after the last dive."""
    figures = []
    for depth in DEPTHS:
        method = f"{scene.job.dives} dives to {depth:g} m"
        limits = GliderLimits(max_depth=depth)
        flight = staying(partial(fly_dives, scene.flight.sea, scene.job.dives, scene.job.noise, limits), scene.flight.seed)
        given = measurements(flight, pings=False, mean_currents=True)[: scene.job.dives]
        followed = scene.errors(method, scene.own, given, looks=1)
        (error,), mean = followed.looks, scene.case.mean_rmse([given[-1].time_ns])
        figures += [
            Figure(STUDY, method, RMSE, error),
            Figure(STUDY, method, "RMSE over the ensemble mean's", error, mean, at_most=_OVER_MEAN),
            Figure(STUDY, method, "mean currents", float(len(given))),
            *followed.nis(STUDY, method),
        ]
    return figures
