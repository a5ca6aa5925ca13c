"""Coverage of the stated intervals: near measurements and away from them, now and days ahead."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import ndtri

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.studies.missions.flights import measurements
from replay_kit.studies.missions.follow import follow
from replay_kit.studies.missions.rows import Figure
from replay_kit.studies.missions.scene import Scene
from replay_kit.studies.twins.vehicle import DAY_NS

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
