"""Profiles relative to a platform of unknown or roughly known velocity, compared with absolute ones."""

from replay_kit.studies.missions.flights import measurements
from replay_kit.studies.missions.rows import RMSE, Figure, error_figures
from replay_kit.studies.missions.scene import Scene
from replay_kit.studies.twins.adcp import Faults

KNOWN_STD = 0.02  # m/s
_UNKNOWN, _KNOWN = 1.25, 1.08


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
        ("unknown platform velocity", Faults("platform"), False, _UNKNOWN),
        ("unknown platform velocity, with mean currents", Faults("platform"), True, _UNKNOWN),
        ("platform velocity to 2 cm/s", known, False, _KNOWN),
    ):
        followed = scene.errors(method, scene.own, measurements(scene.flight, faults, mean_currents=mean_currents))
        figures += error_figures(method, followed.mean(), "that of absolute profiles", absolute.mean(), most) + followed.nis(method)
    return figures
