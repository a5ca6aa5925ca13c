"""The dense check of a mission's path, every ten metres, and its outcome in words."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.mission.flight import Flight
from planners.mission.task import MissionTask
from planners.route.hazards import SPACING, Ring, densified, first_violation
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic

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
    number, dense = densified(track)
    too_deep = (dense[:, 2] > task.region.deepest + _DEPTH) | (dense[:, 2] < -_DEPTH)
    # where it begins it is, whatever may be forbidden there
    surfaced = np.flatnonzero((dense[:, 2] <= _DEPTH) & (number > 1.0))
    lane = first_violation(task.rings, dense[surfaced, :2], surfacing=True)
    found = [
        first_violation(task.rings, dense[:, :2], surfacing=False),
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


def clearances(task: MissionTask, flight: Flight) -> dict[str, Array]:
    """Return how far each of K flights keeps clear of what is forbidden, by its name, shape (K,) [m]: not above 0 where it trespasses.

    A flight that is never as near as one of its steps is long is infinitely far: nothing in between needs a look.
    """
    count, found = len(flight.place), dict[str, Array]()
    surfaced = (flight.depth <= _DEPTH) & (np.arange(flight.depth.size) > 0)
    for ring in task.rings:
        looked = np.flatnonzero(surfaced) if ring.surface_only else np.arange(flight.depth.size)
        found[ring.name] = np.minimum(found.get(ring.name, np.full(count, np.inf)), _clearance(ring, flight.place[:, looked], looked))
    if not task.region.grid.wet.all():
        track = np.dstack([flight.place, np.broadcast_to(flight.depth, flight.place.shape[:2])])
        wet = task.region.wet(track.reshape(-1, 3)).reshape(count, -1).all(axis=1)
        land = found.get("land", np.full(count, np.inf))
        found["land"] = np.where(wet, land, np.minimum(land, 0.0))
    return found


def _clearance(ring: Ring, place: Array, numbers: NDArray[np.intp]) -> Array:
    """Return how far each of K paths, shape (K, n, 2) [m], keeps clear of one ring; only successive numbers are joined by a step."""
    clear = np.full(place.shape[:2], np.inf)
    longest = float(np.max(np.linalg.norm(np.diff(place, axis=1), axis=2)[:, np.diff(numbers) == 1], initial=0.0))
    near = ring.is_near(place.reshape(-1, 2), longest).reshape(clear.shape)
    clear[near] = ring.clearance(place[near])
    # a step that begins no farther away than it is long may come nearer on its way
    flight, step = np.nonzero((np.abs(clear[:, :-1]) <= longest) & (np.diff(numbers) == 1))
    if flight.size:
        share = np.linspace(0.0, 1.0, int(np.ceil(longest / SPACING)) + 1)[:, None]
        between = place[flight, step][:, None] + share * (place[flight, step + 1] - place[flight, step])[:, None]
        nearest = ring.clearance(between.reshape(-1, 2)).reshape(flight.size, -1).min(axis=1)
        np.minimum.at(clear, (flight, step), nearest)
    return np.asarray(clear.min(axis=1))


def explain(task: MissionTask, flight: Flight, miss: Array, away: tuple[float, float], finding: Finding | None, goal_times: Array) -> str:
    """Return what a mission does and, when it does not reach its goals or is not safe, why."""
    n_legs, settings, guide = len(flight.ends), task.settings, task.guide
    verbs = ["meets {} at" if off <= settings.tolerance else "misses {} by" for off in miss]
    met = ", ".join(
        f"{verb.format(_goal(k, len(miss)))} {miss[k]:.1f} m after {goal_times[k] / 3600.0:.1f} h" for k, verb in enumerate(verbs)
    )
    what, short = f"{n_legs} leg{'s' * (n_legs != 1)}; ", ""
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
