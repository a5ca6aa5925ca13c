"""A glider's mission planned: a route from the graph, the nonlinear program from it, the path flown densely and checked."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.flight import Flight, Legs, fly_legs, refined
from planners.hazards import Ring, half_planes
from planners.mission_check import Finding, check, explain
from planners.mission_program import MissionAnswer, MissionData, MissionGuess, MissionShape, solve_mission
from planners.mission_task import REFINED, MissionTask, front_of, guess_of, mission_task, route_of
from planners.mission_values import Bathymetry, MissionPlan, MissionSettings, MissionStatus, NoGo
from planners.vehicle import Glider
from replay_kit.flow import FlowEstimate
from replay_kit.geodesy import grid_bearing_of_true_north, to_geographic, to_local
from replay_kit.types import Array, Place

_VEHICLE, _SETTINGS = Glider(), MissionSettings()
# Hours that a kilometre missed costs: more than any current takes to carry a glider over it.
_PENALTY = 50.0
# Weights (of an hour, of a squared kilometre missed) of a mission that only comes close: time decides among equals.
_CLOSEST = 1e-5, 1.0
# Rounds of half-planes laid anew for the path found, and half-planes for each of its points.
_ROUNDS, _PLANES = 6, 3
# Half-planes laid anew have to lower the cost by this share.
_PROGRESS = 1e-3
# A goal met this well is met [m].
_MET = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """One number of legs solved and flown.

    Attributes:
        legs: What the glider is told.
        flight: Where that leads.
        goal_legs: After which leg each goal is met, counted from 1.
        miss: shape (G,) [m], flown.
        finding: The first place where it may not be; None when there is none.
        guess: The solver's point.
        iterations: IPOPT's, over all rounds.
        return_status: IPOPT's last.
    """

    legs: Legs
    flight: Flight
    goal_legs: tuple[int, ...]
    miss: Array
    finding: Finding | None
    guess: MissionGuess
    iterations: int
    return_status: str


def plan_mission(
    flow: FlowEstimate | Sequence[FlowEstimate],
    start: Place,
    goals: Place | tuple[Place, ...],
    *,
    vehicle: Glider = _VEHICLE,
    settings: MissionSettings = _SETTINGS,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
    start_time_ns: int = 0,
    warm: MissionPlan | None = None,
) -> MissionPlan:
    """Return the best mission found from a start past one goal or several.

    The result is a value whatever the outcome: ``status`` and ``message`` say whether the goals are reached and what prevents it.

    Args:
        flow: The current, or its estimates for increasing times, between which it is linear.
        start: Where it begins.
        goals: Where it should go, in order; all but the last at the surface.
        vehicle: What glides.
        settings: How.
        no_go: Areas that are not to be entered.
        bathymetry: Depth of the bottom, beside the forecast's land.
        start_time_ns: When it begins [ns, UTC].
        warm: An earlier plan for the same goals; what is left of it is tried first, and when that leads there nothing else is.

    Raises:
        PlanError: The start or a goal is outside of the region, on land or where the mission may not go, or a depth does not fit.
    """
    asked = goals if isinstance(goals, tuple) else (goals,)
    task = mission_task(flow, (start, asked), vehicle, settings, (no_go, bathymetry), start_time_ns)
    attempts = [] if warm is None else _from_earlier(task, warm, start_time_ns)
    if not any(_safe_and_met(task, attempt) for attempt in attempts):
        if not np.all(np.isfinite(task.currents.latent)):
            return _failed(task, start, asked, start_time_ns, "the current is not a number; check the estimate's latent velocities")
        attempts += _search(task, task.rings)
        if not any(_safe_and_met(task, attempt) for attempt in attempts) and any(ring.surface_only for ring in task.rings):
            # an area too wide to be passed under water between two surfacings has to be gone round
            attempts += _search(task, tuple(replace(ring, surface_only=False) for ring in task.rings))
    return _to_plan(task, start, asked, start_time_ns, attempts)


def _search(task: MissionTask, rings: tuple[Ring, ...]) -> list[Attempt]:
    """Return what came of each number of legs tried: as the route clear of rings suggests, then fewer while that helps, else more."""
    settings, front = task.settings, front_of(task, rings)
    route, passed = route_of(task, front)
    shallow = task.leg_time(task.vehicle.angles[0])
    likely = int(np.clip(np.ceil(passed[-1] / shallow - 1e-6), len(task.goals), settings.max_legs))

    def attempt(n_legs: int) -> Attempt:
        goal_legs = np.clip(np.round(n_legs * passed / passed[-1]).astype(int), np.arange(len(passed)) + 1, n_legs)
        return solve_legs(task, guess_of(task, route, front, n_legs), tuple(int(number) for number in goal_legs))

    attempts = [attempt(settings.legs or likely)]
    if settings.legs is not None or not route.arrives:
        return attempts
    n_legs = likely - 1
    while n_legs >= len(task.goals) and _safe_and_met(task, attempts[-1]):
        attempts.append(attempt(n_legs))
        n_legs -= 1
    n_legs = likely + 1
    while n_legs <= min(likely + 2, settings.max_legs) and not any(_safe_and_met(task, done) for done in attempts):
        attempts.append(attempt(n_legs))
        n_legs += 1
    return attempts


def solve_legs(task: MissionTask, guess: MissionGuess, goal_legs: tuple[int, ...]) -> Attempt:
    """Return the optimum of a number of legs that IPOPT finds from a guess, held to half-planes if its path trespasses without."""
    turns = task.turns(len(guess.headings))
    closest = task.settings.objective == "closest"
    found = _solve(task, guess, turns, goal_legs, None, closest)
    best = _flown(task, found, turns, goal_legs, found.iterations)
    if not closest and np.any(best.miss > _MET):
        # the goal is out of reach: from here as close to it as can be, not as the penalties would weigh it
        found = _solve(task, found.guess, turns, goal_legs, None, True)
        best = _flown(task, found, turns, goal_legs, best.iterations + found.iterations)
        closest = True
    if best.finding is None:
        return best
    return _kept_clear(task, best, guess, turns, closest)


def _kept_clear(task: MissionTask, free: Attempt, guess: MissionGuess, turns: tuple[tuple[float, ...], ...], closest: bool) -> Attempt:
    """Return the best path found within half-planes, laid anew for each path found until that gains nothing more."""
    best, at, before, iterations = free, guess, np.inf, free.iterations
    for _ in range(_ROUNDS):
        found = _solve(task, at, turns, free.goal_legs, fly_places(task, at, turns), closest)
        iterations += found.iterations
        flown = _flown(task, found, turns, free.goal_legs, iterations)
        better = flown.finding is None and (best.finding is not None or _worth(task, flown) < _worth(task, best))
        best = flown if better or best is free else best
        cost = found.objective
        if np.isfinite(before) and cost > before - _PROGRESS * abs(before):
            break
        at, before = found.guess, cost
    return replace(best, iterations=iterations)


def _solve(
    task: MissionTask,
    guess: MissionGuess,
    turns: tuple[tuple[float, ...], ...],
    goal_legs: tuple[int, ...],
    path: Array | None,
    closest: bool,
) -> MissionAnswer:
    """Return the solver's answer; ``path``, shape (L, n_places, 2) [m], is what half-planes are laid for."""
    different = tuple(dict.fromkeys(turns))
    drifts, n_steps = task.drifts(turns), task.n_steps(turns)
    depths = dict(zip(turns, task.depths(turns), strict=True))
    profiles = tuple(different.index(leg) for leg in turns)
    shape = MissionShape(len(turns), n_steps, goal_legs, profiles, 0 if path is None else _PLANES, bool(np.any(drifts)))
    planes = np.zeros((len(turns), shape.n_places, 0, 3))
    if path is not None:
        surfacing = np.tile(np.arange(shape.n_places) >= n_steps - 1, len(turns))
        flat = half_planes(task.rings, path.reshape(-1, 2), surfacing, _PLANES, task.settings.margin)
        planes = flat.reshape(len(turns), shape.n_places, _PLANES, 3)
    time_weight, miss_weight = _CLOSEST if closest else (1.0, 0.0)
    data = MissionData(
        task.start[:2],
        task.start_time,
        task.goals[:, :2],
        tuple(depths[leg] for leg in different),
        drifts,
        planes,
        time_weight,
        miss_weight,
        1e-6 if closest and path is None else _PENALTY,
        task.currents.latent[0],
    )
    return solve_mission(task.flow, task.vehicle, shape, data, guess, task.currents.times)


def fly_places(task: MissionTask, guess: MissionGuess, turns: tuple[tuple[float, ...], ...]) -> Array:
    """Return where each step of a guess ends, shape (L, n_places, 2) [m]: straight from leg to leg."""
    n_places = task.n_steps(turns) + int(np.any(task.drifts(turns)))
    begins = np.vstack([task.start[None, :2], guess.places[:-1]])
    share = np.arange(1, n_places + 1)[:, None] / n_places
    return np.asarray(begins[:, None] + share * (guess.places - begins)[:, None])


def _flown(
    task: MissionTask, answer: MissionAnswer, turns: tuple[tuple[float, ...], ...], goal_legs: tuple[int, ...], iterations: int
) -> Attempt:
    depths = tuple(refined(steps, REFINED) for steps in task.depths(turns))
    legs = Legs(answer.guess.headings, answer.guess.angles, depths, task.drifts(turns))
    flight = fly_legs(task.currents, task.vehicle, task.start[:2], legs, task.start_time)
    ends = flight.place[0, flight.ends]
    miss = np.linalg.norm(ends[np.array(goal_legs) - 1] - task.goals[:, :2], axis=1)
    return Attempt(legs, flight, goal_legs, miss, check(task, flight), replace(answer.guess), iterations, answer.return_status)


def _from_earlier(task: MissionTask, warm: MissionPlan, start_time_ns: int) -> list[Attempt]:
    """Return what comes of the legs of an earlier plan that are still to be flown; nothing when none are."""
    elapsed = (start_time_ns - warm.start_time_ns) / 1e9
    # a surfacing earlier than planned begins the next leg as well
    begun = int(np.sum(warm.surfacing_times < elapsed + 0.5 * task.leg_time(task.vehicle.angles[0]) * (elapsed > 0.0)))
    left = len(warm.headings_deg) - begun
    goals = tuple(number - begun for number in warm.goal_legs if number > begun)
    if left <= 0 or len(goals) != len(task.goals):
        return []
    longitude, latitude = warm.surfacings[begun:].T
    places = np.column_stack(to_local(task.region.grid.projection, longitude, latitude))
    turn = grid_bearing_of_true_north(task.region.grid.projection, longitude, latitude)
    headings = np.deg2rad(warm.headings_deg[begun:]) + turn
    return [solve_legs(task, MissionGuess(places, headings, np.deg2rad(warm.glide_angles_deg[begun:])), goals)]


def _safe_and_met(task: MissionTask, attempt: Attempt) -> bool:
    return attempt.finding is None and bool(np.all(attempt.miss <= task.settings.tolerance))


def _energy(task: MissionTask, attempt: Attempt) -> float:
    turns = task.turns(len(attempt.legs.headings))
    apogees = sum(leg[i] for leg in turns for i in range(1, len(leg) - 1) if leg[i] > leg[i - 1])
    return float(task.vehicle.energy(attempt.flight.time[-1], apogees))


def _worth(task: MissionTask, attempt: Attempt) -> tuple[bool, float, float]:
    """Return what attempts are sorted by: safe and at the goal first, then the objective; others by how far they miss."""
    met = _safe_and_met(task, attempt)
    missed = 0.0 if met and task.settings.objective != "closest" else float(np.max(attempt.miss)) + (1e9 if attempt.finding else 0.0)
    cost = _energy(task, attempt) if task.settings.objective == "energy" else float(attempt.flight.time[-1])
    return not met, missed, cost


def _to_plan(task: MissionTask, start: Place, goals: tuple[Place, ...], start_time_ns: int, attempts: list[Attempt]) -> MissionPlan:
    finite = [attempt for attempt in attempts if np.all(np.isfinite(attempt.flight.place))]
    if not finite:
        return _failed(task, start, goals, start_time_ns, "no path is finite; check the estimate's latent velocities")
    best = min(finite, key=lambda attempt: _worth(task, attempt))
    flight, projection = best.flight, task.region.grid.projection
    track = np.column_stack([flight.place[0], flight.depth])
    longitude, latitude = to_geographic(projection, *track[flight.ends, :2].T)
    begins = np.concatenate([[0], flight.ends[:-1]])
    turn = grid_bearing_of_true_north(projection, *to_geographic(projection, *track[begins, :2].T))
    status: MissionStatus = "unsafe" if best.finding else "reached" if np.all(best.miss <= task.settings.tolerance) else "unreachable"
    met = [attempt for attempt in finite if _safe_and_met(task, attempt)]
    return MissionPlan(
        status=status,
        start=start,
        goals=goals,
        start_time_ns=start_time_ns,
        vehicle=task.vehicle,
        settings=task.settings,
        headings_deg=np.mod(np.rad2deg(best.legs.headings - turn), 360.0),
        glide_angles_deg=np.rad2deg(best.legs.angles),
        pitches_deg=np.rad2deg(task.vehicle.pitch(best.legs.angles)),
        turns=task.turns(len(best.legs.headings)),
        surfacings=np.column_stack([longitude, latitude]),
        surfacing_times=flight.time[flight.ends],
        goal_legs=best.goal_legs,
        closest_approach=best.miss,
        duration=float(flight.time[-1]),
        energy=_energy(task, best),
        track_time=flight.time,
        track=track,
        message=explain(task, best.flight, best.miss, best.finding, best.goal_legs),
        statistics={
            "attempts": len(attempts),
            "iterations": sum(attempt.iterations for attempt in attempts),
            "tried": "; ".join(_tried(attempt) for attempt in attempts),
            "longest_met_h": max((float(attempt.flight.time[-1]) / 3600.0 for attempt in met), default=float("nan")),
        },
    )


def _tried(attempt: Attempt) -> str:
    safe = "" if attempt.finding is None else f", crosses {attempt.finding.what}"
    hours = attempt.flight.time[-1] / 3600.0
    return f"{len(attempt.legs.headings)} legs: {hours:.2f} h, {attempt.miss.max():.0f} m off{safe}, {attempt.return_status}"


def _failed(task: MissionTask, start: Place, goals: tuple[Place, ...], start_time_ns: int, message: str) -> MissionPlan:
    """Return the plan that says that no mission could be flown; it stays where it is."""
    none = np.zeros(0)
    miss = np.linalg.norm(task.goals[:, :2] - task.start[:2], axis=1)
    nowhere = (np.zeros((0, 2)), none, (0,) * len(goals), miss, 0.0, 0.0, np.zeros(1), task.start[None].copy())
    return MissionPlan(
        "failed", start, goals, start_time_ns, task.vehicle, task.settings, none, none, none, (), *nowhere, message, {"attempts": 0}
    )
