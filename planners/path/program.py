"""The free path of a vehicle of bounded speed as a nonlinear program: pieces of constant velocity through water.

Unknown are these velocities, the duration and where each piece ends. Places are in kilometres and times in hours.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planners.flow import graph_key, latent_over_time
from planners.path.settings import Auv, AuvSettings
from planners.route.bottom import Bottom
from planners.route.hazards import Ring, half_planes, plane_violations
from planners.route.region import Region
from planners.solver import HOUR, KM, OPTIONS, Recent, one_at_a_time
from planners.track import path_function, time_since
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate

# Hours that a kilometre of miss distance, or beyond a half-plane, costs.
_PENALTY = 50.0
# Half-planes for each step's end.
_PLANES = 3
# With free depths the best one is often that of a level, where hats bend and no gradient vanishes: that search ends after so many steps.
_FREE_STEPS = 25


@dataclass(frozen=True, slots=True, eq=False)
class AuvProblem:
    """One planning problem in the local frame.

    Attributes:
        flow: The current, or its first estimate.
        region: The forecast's.
        rings: What the path must keep clear of.
        bottom: What limits its depth.
        vehicle: The vehicle.
        settings: How the path is planned.
        begin: shape (3,) [m], local east, north, depth.
        end: shape (3,) [m].
        later: Estimates of a current that changes, for increasing times after the first; empty for one that does not.
        start_time_ns: When the path begins [ns, UTC].
    """

    flow: FlowEstimate
    region: Region
    rings: tuple[Ring, ...]
    bottom: Bottom
    vehicle: Auv
    settings: AuvSettings
    begin: Array
    end: Array
    later: tuple[FlowEstimate, ...] = ()
    start_time_ns: int = 0

    @property
    def over_time(self) -> tuple[Array | None, Array]:
        """The times of a current that changes [s], and its latent values; None for one that does not."""
        return (
            latent_over_time((self.flow, *self.later)) if self.later else (None, self.flow.latent)
        )

    @property
    def currents(self) -> FlowEstimate | tuple[FlowEstimate, ...]:
        """The current as ``fly_glide`` takes it."""
        return (self.flow, *self.later) if self.later else self.flow


@dataclass(frozen=True, slots=True, eq=False)
class PathSolution:
    """The optimum that IPOPT finds.

    Attributes:
        velocity: shape (n_pieces, 3) [m/s], through water.
        duration: [s].
        iterations: IPOPT's.
        return_status: IPOPT's.
    """

    velocity: Array
    duration: float
    iterations: int
    return_status: str


_programs = Recent[tuple[Any, Array]](4)


@one_at_a_time
def solve_path(
    problem: AuvProblem, guess: Array, free: bool, held: tuple[Array, float] | None
) -> PathSolution:
    """Return the optimum found from a guessed track.

    Args:
        problem: What is asked.
        guess: shape (n, 3) [m], points at equal times.
        free: Whether the depths may differ from the guess's.
        held: A track, shape (n, 3) [m], whose points at equal times get half-planes that keep the path clear, and their margin [m];
            None without half-planes.
    """
    settings, vehicle, n = problem.settings, problem.vehicle, problem.settings.pieces
    times, latent = problem.over_time
    solver, equal = _program(problem.flow, settings, free, held is not None, times)
    ends = _at_equal_times(guess, n)
    length = float(np.sum(np.linalg.norm(np.diff(guess, axis=0), axis=1)))
    duration = min(max(length / vehicle.speed, 60.0), settings.max_duration)
    ground = np.diff(np.vstack([problem.begin, ends]), axis=0) / (duration / n)
    through = ground - np.column_stack([problem.flow.velocity(*ends.T), np.zeros(n)])
    through *= np.minimum(
        1.0, 0.95 * vehicle.speed / np.maximum(np.linalg.norm(through, axis=1), 1e-9)
    )[:, None]
    first = np.concatenate(
        [
            np.column_stack([ends / KM, through]).ravel(),
            [np.log(duration / HOUR)],
            np.zeros(6 + int(held is not None)),
        ]
    )
    shallow, deep = (
        (np.zeros(n), np.full(n, min(problem.region.deepest, problem.bottom.deepest)))
        if free
        else (ends[:, 2], ends[:, 2])
    )
    sides = []
    for sign, depths, time in ((-1.0, shallow, 60.0), (1.0, deep, settings.max_duration)):
        bound = np.full((n, 6), sign * np.inf)
        bound[:, 2] = depths / KM
        slacks = (
            np.zeros(first.size - 6 * n - 1)
            if sign < 0.0
            else np.full(first.size - 6 * n - 1, np.inf)
        )
        sides.append(np.concatenate([bound.ravel(), [np.log(time / HOUR)], slacks]))
    weights = (
        (1.0, 0.0) if settings.objective == "time" else (vehicle.hotel / 10.0, vehicle.drag / 10.0)
    )
    planes, began = (
        np.zeros(0),
        [] if times is None else [time_since(problem.flow, problem.start_time_ns)],
    )
    if held is not None:
        points = _at_equal_times(held[0], n * settings.steps)[:, :2]
        planes = half_planes(
            problem.rings, points, np.ones(len(points), dtype=bool), _PLANES, held[1]
        )
    parameters = np.concatenate(
        [problem.begin, problem.end, weights, planes.ravel(), began, latent.ravel(order="F")]
    )
    within = np.zeros(planes.size // 3)
    least = np.concatenate([equal, np.full(n + within.size, -np.inf)])
    most = np.concatenate([equal, np.full(n, vehicle.speed**2), within])
    answer = solver(x0=first, p=parameters, lbx=sides[0], ubx=sides[1], lbg=least, ubg=most)
    statistics, found = solver.stats(), np.asarray(answer["x"]).ravel()
    pieces, seconds = found[: 6 * n].reshape(n, 6), float(np.exp(found[6 * n])) * HOUR
    return PathSolution(
        pieces[:, 3:], seconds, int(statistics["iter_count"]), str(statistics["return_status"])
    )


def _at_equal_times(track: Array, n: int) -> Array:
    """Return n points, shape (n, 3), that end as many equal parts of a track, shape (m, 3), whose points are at equal times."""
    return np.column_stack(
        [
            np.interp(np.arange(1, n + 1) / n, np.linspace(0.0, 1.0, len(track)), track[:, i])
            for i in range(3)
        ]
    )


def _program(
    flow: FlowEstimate, settings: AuvSettings, free: bool, held: bool, times: Array | None
) -> tuple[Any, Array]:
    """Return the solver of a flow's nodes, with half-planes or without, and the values of its equality constraints."""
    options = {**OPTIONS, "ipopt.max_iter": _FREE_STEPS} if free else OPTIONS
    key = (
        *graph_key(flow),
        settings.pieces,
        settings.steps,
        free,
        held,
        None if times is None else times.tobytes(),
    )
    return _programs.get(
        key,
        lambda: _build(
            flow, (settings.pieces, settings.steps), _PLANES if held else 0, options, times
        ),
    )


def _build(
    flow: FlowEstimate,
    shape: tuple[int, int],
    n_planes: int,
    options: dict[str, Any],
    times: Array | None,
) -> tuple[Any, Array]:
    n, steps = shape
    begin, end, weights, latent = (
        ca.MX.sym("begin", 3),
        ca.MX.sym("end", 3),
        ca.MX.sym("weights", 2),
        ca.MX.sym(
            "latent", flow.horizontal.size, flow.levels.size * (1 if times is None else times.size)
        ),
    )
    pieces, log_duration, slacks = (
        [ca.MX.sym("piece", 6) for _ in range(n)],
        ca.MX.sym("log_duration"),
        ca.MX.sym("slacks", 6),
    )
    planes, plane_slack = (
        [ca.MX.sym("planes", 3, n_planes * steps) for _ in range(n)],
        ca.MX.sym("plane_slack", int(n_planes > 0)),
    )
    duration, path, began = (
        ca.exp(log_duration),
        path_function(flow, steps, times=times),
        ca.MX.sym("began", int(times is not None)),
    )
    at, meet, within = ca.vertcat(begin, began), [], []
    for k, piece in enumerate(pieces):
        places = path(at, piece[3:], ca.repmat(duration * HOUR / (n * steps), steps, 1), latent)
        meet.append(places[:3, -1] / KM - piece[:3])
        if n_planes:
            within.append(
                plane_violations(places[:2, -steps:] / KM, planes[k], n_planes) - plane_slack
            )
        at = ca.vertcat(piece[:3] * KM, began + duration * HOUR * (k + 1) / n)
    meet.append(pieces[-1][:3] - end / KM - (slacks[:3] - slacks[3:]))
    power = (
        weights[0] + weights[1] * sum((ca.sumsqr(piece[3:]) + 1e-8) ** 1.5 for piece in pieces) / n
    )
    program: dict[str, Any] = {
        "x": ca.veccat(*pieces, log_duration, slacks, plane_slack),
        "p": ca.veccat(begin, end, weights, *planes, began, latent),
        "f": power * duration + _PENALTY * (ca.sum1(slacks) + ca.sum1(plane_slack)),
        "g": ca.vertcat(*meet, *(ca.sumsqr(piece[3:]) for piece in pieces), *within),
    }
    return ca.nlpsol("auv", "ipopt", program, options), np.zeros(3 * n + 3)
