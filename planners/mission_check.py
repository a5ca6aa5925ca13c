"""The dense check of a mission's path, every ten metres, and its outcome in words."""

from dataclasses import dataclass

import numpy as np

from planners.flight import Flight
from planners.hazards import trespassed
from planners.mission_task import MissionTask
from replay_kit.geodesy import to_geographic
from replay_kit.types import Array

# Distance between the points checked [m].
SPACING = 10.0
# Angles [rad] and depths [m] are compared to this.
_ANGLE, _DEPTH = 1e-6, 1e-3


@dataclass(frozen=True, slots=True)
class Finding:
    """Where a path first goes where it may not.

    Attributes:
        what: Is trespassed on.
        time: Since the start [s].
        leg: Number of the leg, counted from 1.
        longitude: [degrees east].
        latitude: [degrees north].
    """

    what: str
    time: float
    leg: int
    longitude: float
    latitude: float


def check(task: MissionTask, flight: Flight) -> Finding | None:
    """Return the first place, of points no farther apart than ten metres, where a path is not allowed; None when it is everywhere.

    Under water and at the surface it has to keep clear of every ring and within the water, and its surfacings also of the areas that
    forbid surfacing only.
    """
    if not np.all(np.isfinite(flight.place)):
        return Finding("the path is not a number", 0.0, 1, float("nan"), float("nan"))
    track = np.column_stack([flight.place[0], flight.depth])
    way = np.linalg.norm(np.diff(track, axis=0), axis=1)
    pieces = np.maximum(np.ceil(way / SPACING).astype(int), 1)
    number = np.concatenate([[0.0], *(i + np.arange(1, n + 1) / n for i, n in enumerate(pieces))])
    dense = np.column_stack([np.interp(number, np.arange(len(track)), track[:, i]) for i in range(3)])
    too_deep = (dense[:, 2] > task.region.deepest + _DEPTH) | (dense[:, 2] < -_DEPTH)
    # where it begins it is, whatever may be forbidden there
    surfaced = np.flatnonzero((dense[:, 2] <= _DEPTH) & (number > 1.0))
    lane = trespassed(task.rings, dense[surfaced, :2], surfacing=True)
    found = [
        trespassed(task.rings, dense[:, :2], surfacing=False),
        None if lane is None else (lane[0], int(surfaced[lane[1]])),
        ("land", int(np.argmin(task.region.wet(dense)))) if not task.region.wet(dense).all() else None,
        ("the surface or the deepest level", int(np.argmax(too_deep))) if too_deep.any() else None,
    ]
    first = min((one for one in found if one is not None), key=lambda one: one[1], default=None)
    if first is None:
        return None
    what, i = first
    time = float(np.interp(number[i], np.arange(len(track)), flight.time))
    longitude, latitude = to_geographic(task.region.grid.projection, *dense[i, :2])
    leg = int(flight.leg[int(np.ceil(number[i]))]) + 1
    return Finding(what, time, leg, float(longitude), float(latitude))


def explain(task: MissionTask, flight: Flight, miss: Array, away: tuple[float, float], finding: Finding | None, goal_times: Array) -> str:
    """Return what a mission does and, when it does not reach its goals or is not safe, why."""
    n_legs, settings, guide = len(flight.ends), task.settings, task.guide
    met = ", ".join(f"meets {_goal(k, len(miss))} at {off:.1f} m after {goal_times[k] / 3600.0:.1f} h" for k, off in enumerate(miss))
    what, short = f"{n_legs} legs; ", ""
    if settings.weights.closest != 0.0:
        what += met
        short = "" if np.all(miss <= settings.tolerance) else f", outside the tolerance of {settings.tolerance:g} m"
    if guide is not None:
        near = f"{away[0]:.0f} m from {guide.name} at most, {away[1]:.0f} m in the root mean square, for {flight.time[-1] / 3600.0:.1f} h"
        what += near if settings.weights.closest == 0.0 else f", {near}"
        short += "" if away[0] <= guide.limit else f", farther than {guide.limit:g} m"
    if finding is not None:
        where = f"{finding.longitude:.4f}, {finding.latitude:.4f} in leg {finding.leg} after {finding.time / 3600.0:.1f} h"
        what += f"; not safe: crosses {finding.what} at {where}"
    return what if not short else f"{what}{short}; {_binding(task, flight, n_legs)}"


def _goal(k: int, count: int) -> str:
    return "the goal" if count == 1 else f"goal {k + 1}"


def _binding(task: MissionTask, flight: Flight, n_legs: int) -> str:
    settings = task.settings
    if settings.weights.closest:
        return "limit: the weights, by which to come closer is not worth it, or what may be reached at all"
    if settings.legs is not None and task.guide is None:
        return f"limit: {settings.legs} legs at glide angles from {task.vehicle.min_angle:g} to {task.vehicle.max_angle:g} degrees"
    if n_legs >= settings.max_legs:
        return f"limit: max_legs = {settings.max_legs}"
    if flight.time[-1] >= 0.95 * settings.max_duration:
        return f"limit: max_duration = {settings.max_duration:g} s"
    ground = float(np.linalg.norm(flight.place[0, -1] - flight.place[0, 0])) / max(float(flight.time[-1]), 1.0)
    through = float(task.vehicle.speeds(np, task.vehicle.angles[0])[0])
    return f"the current or what may not be crossed keeps a glider of {through:.2f} m/s from it: it makes good {ground:.2f} m/s"
