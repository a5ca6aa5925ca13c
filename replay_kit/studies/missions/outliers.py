"""The effect of pings that are wrong as a whole on the estimate, with each kind of gate."""

from collections.abc import Sequence

import numpy as np

from replay_kit.core.observation import Measurement, Observation
from replay_kit.studies.missions.flights import measurements
from replay_kit.studies.missions.rows import RMSE, Figure, error_figures
from replay_kit.studies.missions.scene import Scene, own_estimator
from replay_kit.studies.twins.adcp import OUTLIER, Faults

SHARE = 0.1
_OVER_CLEAN = 1.05
_GATES = ("reject", "soften", "off")


def outliers(scene: Scene) -> list[Figure]:
    """Return the figures of one mission: the run without outliers has the gate of the settings."""
    sound, spoilt = measurements(scene.flight), measurements(scene.flight, Faults(outliers=SHARE))
    wrong = _moved(sound, spoilt)
    clean = scene.errors("without outliers", scene.own, sound)
    figures = [
        Figure("without outliers", RMSE, clean.mean()),
        Figure("without outliers", "pings rejected or softened", clean.doubted(), len(clean.innovations)),
    ]
    for gate in _GATES:
        method = f"with outliers, gate {gate}"
        gating = scene.config.gating.model_copy(update={"gate": gate})
        followed = scene.errors(method, own_estimator(scene.case, scene.config.model_copy(update={"gating": gating})), spoilt)
        most = _OVER_CLEAN if gate == scene.config.gating.gate else np.nan
        figures += error_figures(method, followed.mean(), "that without outliers", clean.mean(), most)
        if gate == "reject":
            caught = followed.doubted() - followed.doubted(wrong)
            figures += [
                Figure(method, "outliers rejected or softened", caught, len(wrong)),
                Figure(method, "sound pings rejected or softened", followed.doubted(wrong), len(followed.innovations) - len(wrong)),
            ]
    return figures


def _moved(sound: Sequence[Measurement], spoilt: Sequence[Measurement]) -> frozenset[int]:
    """Return the times [ns, UTC] of the pings that are outliers."""
    velocity = {of.time_ns: of.velocity for of in sound if isinstance(of, Observation)}
    pairs = [(of.time_ns, of.velocity - velocity[of.time_ns]) for of in spoilt if isinstance(of, Observation)]
    return frozenset(time_ns for time_ns, off in pairs if (np.hypot(off[:, 0], off[:, 1]) > 0.5 * OUTLIER).any())
