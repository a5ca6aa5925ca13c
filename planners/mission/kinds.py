"""Missions that are not only to arrive: a virtual mooring, which stays near a place, and a line, which is to be followed."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np

from planners.mission.plan import plan_task
from planners.mission.program import MissionGuess
from planners.mission.reference_path import along_line, near_place
from planners.mission.result import failed_plan, to_plan
from planners.mission.solve import GoalSteps, solve_legs
from planners.mission.task import MissionTask, mission_task
from planners.mission.values import MissionPlan, MissionSettings, Weights
from planners.route.graph import Route
from planners.route.hazards import Bathymetry, NoGo
from planners.route.region import locate
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place

_VEHICLE, _SETTINGS = Glider(), MissionSettings()
# An hour longer costs a mooring next to nothing, what is farther away in the mean square [km^2] all; where it ends does not count.
_MOORED = Weights(time=1e-5, closest=0.0)
# Depths over which the mean current of a dive is taken.
_DEPTHS = 51


def plan_mooring(
    flow: FlowEstimate | Sequence[FlowEstimate],
    start: Place,
    place: Place,
    radius: float,
    duration: float,
    *,
    surfacings_only: bool = False,
    vehicle: Glider = _VEHICLE,
    settings: MissionSettings = _SETTINGS,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
    start_time_ns: int = 0,
) -> MissionPlan:
    """Return the mission found that stays within a radius of a place for a duration with the least mean square distance from it.

    Its status is ``reached`` when it does stay within; ``statistics`` has ``farthest_m`` and ``rms_m``. The number of legs is that
    of the glide angle at which the glider makes no way against the mean current at the place, or comes nearest to it.

    Args:
        flow: The current, or its estimates for increasing times.
        start: Where it begins, within the radius.
        place: To stay near; its depth does not count.
        radius: [m].
        duration: [s]; the mission lasts as long or, as legs are whole, somewhat longer.
        surfacings_only: Whether only surfacings are to be near and within, and not the track between them.
        vehicle: What glides.
        settings: How; the objective does not count.
        no_go: Areas that are not to be entered.
        bathymetry: Depth of the bottom, beside the forecast's land.
        start_time_ns: When it begins [ns, UTC].

    Raises:
        PlanError: As for ``plan_mission``; or the start is not within the radius, or more legs are needed than are allowed.
    """
    if not (0.0 < radius < inf and 0.0 < duration < inf):
        raise PlanError(f"a mooring within {radius!r} m for {duration!r} s: expected two numbers above 0")
    centre = replace(place, depth=0.0)
    task = mission_task(flow, (start, (centre,)), vehicle, replace(settings, objective=_MOORED), (no_go, bathymetry), start_time_ns)
    task = replace(task, guide=near_place(task.goals[0, :2], radius, duration, surfacings_only))
    away = float(np.linalg.norm(task.start[:2] - task.goals[0, :2]))
    if away > radius:
        raise PlanError(f"the start is {away:.0f} m from the mooring, outside of its radius of {radius:g} m; plan a mission there first")
    if not np.all(np.isfinite(task.currents.latent)):
        what = "the current is not a number; check the estimate's latent velocities"
        return failed_plan(task, start, (centre,), start_time_ns, what)
    current = _mean_current(task, task.goals[0, :2], duration)
    angle = _holding_angle(task, float(np.linalg.norm(current)))
    n_legs = settings.legs or int(np.ceil((duration + settings.surface_time) / task.leg_time(angle) - 1e-6))
    if n_legs > settings.max_legs:
        raise PlanError(
            f"a mooring of {duration / 3600.0:g} h takes {n_legs} legs, but max_legs = {settings.max_legs}; allow more, or more dives a leg"
        )
    attempts = []
    for hops in (False, True):
        guess = _guess(task, current, angle, n_legs, hops)
        route = Route(np.vstack([task.start[:2], guess.places]), task.leg_time(angle) * np.arange(n_legs + 1.0), True)
        attempts.append(solve_legs(task, guess, GoalSteps((n_legs,), (0,)), route))
    return to_plan(task, start, (centre,), start_time_ns, attempts)


def _mean_current(task: MissionTask, place: Array, duration: float) -> Array:
    """Return the current [m/s], shape (2,), at a place in the mean over a dive's depths, halfway through a duration [s]."""
    depths = np.linspace(0.0, task.settings.depth, _DEPTHS)
    of_levels = task.currents.weights(depths).mean(axis=0)
    return np.asarray(task.currents.velocity(place[None], of_levels, task.start_time + 0.5 * duration)[0])


def _holding_angle(task: MissionTask, current: float) -> float:
    """Return the glide angle [rad] at which the glider's way through water is nearest to that of a current [m/s]."""
    angles = np.linspace(*task.vehicle.angles, 64)
    # a drift at the surface has to be made up for under water
    shares = np.array([1.0 - task.settings.surface_time / task.leg_time(float(angle)) for angle in angles])
    return float(angles[np.argmin(np.abs(shares * np.asarray(task.vehicle.speeds(np, angles)[0]) - current))])


def _guess(task: MissionTask, current: Array, angle: float, n_legs: int, hops: bool) -> MissionGuess:
    """Return legs that each lead as near to the mooring as its length allows; with ``hops`` to either side of it in turn."""
    lasts = task.leg_time(angle)
    drift, way = current * lasts, float(task.vehicle.speeds(np, angle)[0]) * (lasts - task.settings.surface_time)
    side = np.array([0.5 * max(way - float(np.linalg.norm(drift)), 0.0), 0.0]) * float(hops)
    at, places, headings = task.start[:2], [], []
    for k in range(n_legs):
        east, north = task.goals[0, :2] + (-1.0) ** k * side - at - drift
        headings.append(float(np.arctan2(east, north)))
        at = at + drift + way * np.array([np.sin(headings[-1]), np.cos(headings[-1])])
        places.append(at)
    return MissionGuess(np.array(places), np.array(headings), np.full(n_legs, angle))


def plan_line(
    flow: FlowEstimate | Sequence[FlowEstimate],
    begin: Place,
    end: Place,
    *,
    start: Place | None = None,
    weight: float = 10.0,
    width: float = inf,
    vehicle: Glider = _VEHICLE,
    settings: MissionSettings = _SETTINGS,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
    start_time_ns: int = 0,
    warm: MissionPlan | None = None,
) -> MissionPlan:
    """Return the best mission found along a line: it ends at the line's end, and being off the line on the way costs.

    ``statistics`` has ``farthest_m`` and ``rms_m``, how far the track is off the line, which is straight in the flow's local frame.

    Args:
        flow: The current, or its estimates for increasing times.
        begin: Of the line; its depth counts when the mission starts there.
        end: Of the line, where the mission ends.
        start: Where the mission begins; None for the line's beginning.
        weight: An hour a kilometre off the line costs as much as this many hours more, one at two kilometres four times that.
        width: Farthest that the track may be off the line for the mission to count as ``reached`` [m].
        vehicle: What glides.
        settings: How; the objective is added to what being off the line costs.
        no_go: Areas that are not to be entered.
        bathymetry: Depth of the bottom, beside the forecast's land.
        start_time_ns: When it begins [ns, UTC].
        warm: An earlier plan of the same line, as for ``plan_mission``.

    Raises:
        PlanError: As for ``plan_mission``; or the line has no length, its weight is negative or its width not above 0.
    """
    if not (0.0 <= weight < inf and width > 0.0):
        raise PlanError(f"a line of weight {weight!r} and width {width!r} m: expected a number of 0 or more and one above 0")
    here = begin if start is None else start
    task = mission_task(flow, (here, (end,)), vehicle, settings, (no_go, bathymetry), start_time_ns)
    first, last = locate(task.region, begin, "the line's beginning")[:2], task.goals[0, :2]
    if float(np.linalg.norm(last - first)) < 1.0:
        raise PlanError("a line needs two places that are apart")
    return plan_task(replace(task, guide=along_line(first, last, weight, width)), here, (end,), start_time_ns, warm)
