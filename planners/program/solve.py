"""Outer iterations of a mission: solve the program, simulate its legs in the full flow, correct the program by the defects."""

from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import numpy as np

from planners.program.graph import HOUR, KM, PLANES, Program, Shape, Water, program
from planners.program.solution import (
    Solution,
    Solved,
    Start,
    flown_again,
    joined_flight,
    judged_solution,
)
from planners.program.walls import Segments, Walls
from planners.request import Line, Mooring
from planners.simulation.fly import COARSE, DRIFT_STEPS, TURN, Legs, Path, fly_leg
from planners.task import Task
from planners.vehicle import Glider
from replay_kit.core.arrays import Array, points_over
from replay_kit.core.geodesy import true_north_halfway

# Rounds at most; what legs end beside the program, added up, that is left in the last one: near walls, else, and of glides [m].
_ROUNDS, _SETTLED, _FREE, _EXACT = 12, 1.0, 8.0, 0.02
# Distance kept beside the margin, lack of clearance that may be left, and share of it that is added after so many rounds, at most [m].
_AHEAD, _LACKING, _ADDED, _PATIENT, _MOST_ADDED = 0.5, 1.0, 0.7, 3, 200.0
# Where legs end farther beside the program than this [m], a start whose program is not solved is given up.
_LOST = 1e3
_SOLVED = "Solve_Succeeded", "Solved_To_Acceptable_Level"
# Shares of a kernel length over which Simpson's rule holds along a leg of one segment, and of two; segments and steps of a glide.
_ONE, _TWO, _OF_GLIDE, _GLIDE_STEPS = 0.8, 1.6, 8, 240
# Longest step of a flown dive or climb [s].
_LONGEST = 300.0
# A little more than a battery holds counts as all of it.
_FULL = 1.001
# Tolerances beyond which a goal is missed for good.
_OFF = 2.0
# Points of a flown segment, and of the drift after it.
_POINTS, _ADRIFT = 13, 2
# Cost of a kilometre that a goal is missed by in hours; along a line, or where it alone counts.
_MISS, _MISS_FIRST = 50.0, 5e3


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """Objective of a program, and bounds of its duration.

    Attributes:
        given: Parameters by name.
        least: Least duration [h].
        most: Greatest duration [h].
    """

    given: dict[str, Array]
    least: float
    most: float


def terms_of(task: Task) -> Terms:
    """Return the objective of a mission's program, scaled to a cost of 1 per hour."""
    weights, shape, aim = task.settings.weights, task.shape, task.settings.aim
    most, goal = task.settings.max_duration / HOUR, task.goals[-1, :2] / KM
    none = {"line": np.zeros(4), "mooring": goal, "within": np.array([0.0, 0.0, 1.0])}
    if isinstance(shape, Mooring):
        # time decides among equals, and where it ends does not count
        within = np.array([0.0, float(not shape.surfacings_only), shape.radius / KM])
        given = {"weights": np.array([1e-5, 0.0, 0.0, 0.0, 1.0]), "within": within}
        return Terms(none | given, shape.duration / HOUR, 1e6)
    hour = weights.time + weights.energy * task.vehicle.power * HOUR / 1e3
    first = aim.distance_first or shape is not None or task.is_glide
    miss = _MISS_FIRST if first else _MISS
    if weights.closest is not None and hour > 0.0:
        miss = weights.closest / hour
    each = np.array([weights.time, weights.energy, 0.0]) / (hour or 1.0)
    if not isinstance(shape, Line):
        return Terms(none | {"weights": np.array([*each[:2], miss, 0.0, 0.0])}, 0.0, most)
    way = goal - task.line_begin / KM
    line = np.array([*(way / np.linalg.norm(way)), *(task.line_begin / KM)])
    within = np.array([1.0, 0.0, shape.width / KM])
    of_all = np.array([*each[:2], miss, shape.weight, 0.0])
    return Terms(none | {"weights": of_all, "line": line, "within": within}, 0.0, most)


@dataclass(eq=False)
class Solver:
    """Solver of a mission for any number of legs; caches current and programs.

    Attributes:
        task: Mission.
        terms: Objective and bounds.
        water: Current.
        segments: Segments per leg, the fewest for which Simpson's rule is accurate.
        programs: Programs by dimensions.
    """

    task: Task
    terms: Terms = field(init=False)
    water: Water = field(init=False)
    segments: int = field(init=False)
    programs: dict[Shape, Program] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fit the current and set the objective."""
        with TURN:
            self.terms, self.water = terms_of(self.task), Water(self.task)
        self.segments = segments_of(self.task)

    def program(self, legs: int, walled: bool) -> Program:
        """Return the program for a number of legs, with or without half-planes."""
        planes = PLANES if walled else 0
        shape = Shape(legs, self.segments, len(self.task.goals), self.task.is_glide, planes)
        if shape not in self.programs:
            self.programs[shape] = program(self.water, self.task.vehicle, shape)
        return self.programs[shape]

    def solve(self, start: Start) -> Solution:
        """Return the solution from an initial guess."""
        with TURN:
            return _Rounds(self, start).run()


def segments_of(task: Task) -> int:
    """Return the number of segments per leg."""
    if task.is_glide:
        return _OF_GLIDE
    along = float(task.vehicle.speeds(np, task.shallowest_angle)[0])
    reach = (along + _speed_near(task)) * task.leg_time()
    lengths = reach / task.flow.horizontal.kernel.lengths.min()
    below = bool(task.start[2] > 0.0 or np.any(task.goals[:, 2] > 0.0))
    return 1 if lengths < _ONE else 2 if lengths < _TWO or below else 4


def _speed_near(task: Task) -> float:
    """Return a high quantile of the level-mean current speed around start and goals [m/s]."""
    places = np.vstack([task.start[None], task.goals])[:, :2]
    axes = np.linspace(places.min(axis=0) - 2e4, places.max(axis=0) + 2e4, 15).T
    points = points_over(*axes)
    velocity = task.flow.horizontal.velocity(points, task.currents_through()[1])
    by_time = velocity.reshape(2, len(points), -1, task.flow.levels.size).mean(axis=-1)
    return float(np.quantile(np.hypot(*by_time), 0.95))


def parts_of(yos: int, segments: int) -> tuple[Array, Array, Array]:
    """Return the number of depth passes of each segment, and the multiplicities of the integrals to the full and half depth.

    Each has shape (M,). Segments have equal lengths; one of four may end at half the depth.
    """
    cuts = np.arange(segments + 1) * 2.0 * yos / segments

    def until(passes: float) -> tuple[float, float]:
        full, part = divmod(passes, 1.0)
        if part == 0.0:
            return full, 0.0
        return (full, 1.0) if full % 2.0 == 0.0 else (full + 1.0, -1.0)

    whole, half = np.diff([until(float(cut)) for cut in cuts], axis=0).T
    return np.diff(cuts), whole, half


class _Rounds:
    """State of the outer iterations from one initial guess (mutable)."""

    def __init__(self, solver: Solver, start: Start) -> None:
        self.solver, self.task, self.start = solver, solver.task, start
        self.legs, self.segments = len(start.angles), solver.segments
        self.n = self.legs * self.segments
        self.walls = self._walls()
        self.angles, self.depths = start.angles, start.depths
        self.headings, self.drift = start.angles, self.task.drifts(self.legs)
        lines = _cut(start.lines, self.segments)
        self.ends = lines[:, -1]
        self.flown = Segments(lines, self.ends, self._chords())
        self.defect = np.zeros((2, self.n)) if start.defect is None else start.defect
        goals = len(self.task.goals)
        self.met, self.bend = np.zeros((self.n + 1, goals)), np.zeros((2, goals))
        self.met[np.array(start.goal_legs) * self.segments, np.arange(goals)] = 1.0
        self.missed = (self._points().T @ self.met - self.task.goals[:, :2].T) / KM
        self.beyond, self.pace, self.extra = 0.0, 1.0, 0.0
        self.given = self.solver.terms.given | self._profile()

    def _walls(self) -> Walls:
        """Return the constraints of all segments, and those specific to the dive depth of each leg."""
        task, start = self.task, self.start
        of_segments = np.repeat(start.depths, self.segments)
        rings = [(ring, np.arange(self.n)) for ring in task.rings]
        for depth in np.unique(of_segments).tolist():
            rows = np.flatnonzero(of_segments == depth)
            rings += [(ring, rows) for ring in task.bottom.rings(depth)]
        return Walls(rings, task.settings.margin, _cut(start.lines, self.segments))

    def _points(self) -> Array:
        return np.vstack([self.task.start[None, :2], self.ends])

    def _chords(self) -> Array:
        points = self._points()
        return np.stack([points[:-1], points[1:]], axis=1)

    def _profile(self) -> dict[str, Array]:
        """Return the parameters of the segments' depth profiles and drifts."""
        task, water, segments = self.task, self.solver.water, self.segments
        yos, first, deep = task.settings.yos, float(task.start[2]), float(task.goals[-1, 2])
        begins, fixed = np.zeros(self.n), np.zeros((water.count, self.n))
        passes, whole, half = (np.tile(part, self.legs) for part in parts_of(yos, segments))
        pumps, last = np.full(self.legs, float(yos)), np.s_[-segments:]

        def met(begin: float, end: float) -> Array:
            """Return the integrals over each segment of a straight dive, shape (C, M)."""
            at = np.linspace(begin, end, segments + 1)
            return np.diff([water.integral(float(z)) for z in at], axis=0).T

        if task.is_glide:
            low, high = task.turns(self.depths)[:, 0]
            fixed = met(low, high) / (high - low) * segments
        else:
            begins[0], fixed[:, 0] = first / KM, water.integral(first) / KM
        if task.ends_in_dive(self.legs):
            passes[last] = whole[last] = half[last] = pumps[-1] = 0.0
            begins[last] = -deep / segments / KM
            fixed[:, last] = -met(0.0, deep) / KM
        elif deep > 0.0 and not task.is_glide:
            begins[-1] += deep / KM
            fixed[:, -1] += water.integral(deep) / KM
        drift = np.zeros(self.n)
        drift[segments - 1 :: segments] = self.drift / HOUR
        return {
            "start": task.start[:2] / KM,
            "goals": task.goals[:, :2].T / KM,
            "passes": passes,
            "begins": begins,
            "whole": whole,
            "half": half,
            "fixed": fixed,
            "drift": drift,
            "pumps": pumps,
            "battery": np.array(_FULL * 1e3 / task.settings.battery),
            "glide": np.array(abs(float(np.ptp(task.turns(self.depths)[:, 0]))) / KM),
        }

    def run(self) -> Solution:
        """Return the solution after the last iteration."""
        iterations, status, walled, settled = 0, "", False, False
        for number in range(_ROUNDS):
            walled = walled or self.walls.near(self.flown)
            status, more, found = self._solve(number, walled)
            iterations += more
            gap, moved = self._fly(*found)
            settled = self._settled(gap, moved, walled, number)
            solved, off = status in _SOLVED, KM * float(np.max(np.hypot(*self.missed)))
            lost = not solved and float(np.max(np.linalg.norm(gap, axis=1))) > _LOST
            astray = (
                number > 0 and not (solved and walled) and off > _OFF * self.task.settings.tolerance
            )
            if settled or lost or astray:
                break
        answer = self._solution(status, iterations)
        return answer if settled else flown_again(answer)

    def _solve(self, number: int, walled: bool) -> tuple[str, int, tuple[Array, Array, Array]]:
        """Solve the program; return IPOPT's status and iterations, and the segments' displacements, durations and ends."""
        task, legs, n = self.task, self.legs, self.n
        asked, terms = self.solver.program(legs, walled), self.solver.terms
        given = self.given | {"met": self.met, "bend": self.bend, "defect": self.defect}
        if walled:
            straight = number == 0 and self.start.defect is None
            given["walls"] = self.walls.planes(self.flown, _AHEAD + self.extra, straight)
        most, settings = self.start.depths, task.settings
        least = most if settings.depths is None else np.minimum(settings.depths[0], most)
        if settings.depths is not None:
            # a leg that passes a goal below the surface goes down to it
            of_goals = np.array(self.start.goal_legs[:-1], np.intp) - 1
            np.maximum.at(least, of_goals, task.goals[: of_goals.size, 2])
            least = np.minimum(least, most)
        angles = (1e-3, inf) if task.is_glide else task.vehicle.angles
        slowest, fastest = task.settings.speeds or (task.vehicle.speed, task.vehicle.speed)
        paces = slowest / task.vehicle.speed, fastest / task.vehicle.speed
        open_, goals = np.full(2 * n, inf), np.full(self.missed.size, inf)
        depths, pace = np.clip(self.depths, least, most) / KM, np.clip(self.pace, *paces)
        x0 = np.concatenate(
            [
                (self.ends / KM).ravel(),
                self.angles,
                depths,
                self.missed.ravel(order="F"),
                [self.beyond, pace],
            ]
        )
        low: list[Any] = [-open_, np.full(legs, angles[0]), least / KM, -goals, [0.0, paces[0]]]
        high: list[Any] = [open_, np.full(legs, angles[1]), most / KM, goals, [inf, paces[1]]]
        equal = np.zeros(legs + 2 * (n - legs) + goals.size)
        free = np.full(n * (PLANES * walled + 1) + 1, inf)
        parameters = asked.parameters(**given)
        answer = asked.solver(
            x0=x0,
            p=parameters,
            lbx=np.concatenate(low),
            ubx=np.concatenate(high),
            lbg=np.concatenate([equal, -free, [terms.least]]),
            ubg=np.concatenate([equal, 0.0 * np.ones(free.size), [terms.most]]),
        )
        told, x = asked.solver.stats(), np.asarray(answer["x"]).ravel()
        ends, self.angles, depths, missed, rest = np.split(
            x, np.cumsum([2 * n, legs, legs, goals.size])
        )
        # on a limit but for the barrier
        self.ends, self.depths = ends.reshape(n, 2) * KM, np.clip(depths * KM, least, most)
        self.missed, self.beyond = missed.reshape(2, -1, order="F"), float(rest[0])
        self.pace = round(float(rest[1]), 5)
        through, lasts, end = (np.asarray(value) for value in asked.result(x, parameters))
        status, iterations = str(told["return_status"]), int(told["iter_count"])
        return status, iterations, (through, lasts.ravel(), end.ravel())

    @property
    def vehicle(self) -> Glider:
        """Glider at the optimised speed."""
        vehicle = self.task.vehicle
        return vehicle if self.pace == 1.0 else replace(vehicle, speed=self.pace * vehicle.speed)

    def _fly(self, through: Array, lasts: Array, end: Array) -> tuple[Array, float]:
        """Simulate all legs at once, each from its beginning in the program.

        Returns:
            Defects of the segments, shape (N, 2) [m]; and the shift of the goals' passing points within legs [m].
        """
        task, segments = self.task, self.segments
        points = self._points()
        begins, surfacings = points[:-1:segments], points[segments::segments]
        depart = np.append(0.0, end[segments - 1 : -1 : segments]) * HOUR
        local = np.arctan2(through[0, ::segments], through[1, ::segments])
        turn = true_north_halfway(task.region.grid.projection, begins, surfacings)
        self.headings = local - turn
        path = fly_leg(
            task.currents,
            self.vehicle,
            (begins, task.start_time + depart),
            self.commands,
            self.steps,
            task.goals[:, 2],
        )
        self.path = path
        since, wet = path.times - path.times[0], len(path.times) - 1 - DRIFT_STEPS
        cuts = np.cumsum(lasts.reshape(-1, segments), axis=1) * HOUR
        cuts[:, -1] = since[wet]
        lines, up = np.empty((self.n, _POINTS + _ADRIFT, 2)), np.empty((self.n, 2))
        for k in range(self.legs):
            for m in range(segments):
                begin, last = cuts[k, m - 1] if m else 0.0, m == segments - 1
                at = np.linspace(begin, cuts[k, m], _POINTS)
                after = since[-1, k] if last else cuts[k, m]
                at = np.append(at, np.linspace(cuts[k, m], after, _ADRIFT + 1)[1:])
                row = k * segments + m
                lines[row] = _along(path, since, k, at)
                up[row] = lines[row, _POINTS - 1 if path.depths[wet, k] == 0.0 and last else -1]
        self.flown = Segments(lines, up, self._chords())
        moved = self._blend(path, since, cuts)
        return lines[:, -1] - lines[:, 0] - np.diff(points, axis=0), moved

    @property
    def commands(self) -> Legs:
        """Commands of the legs."""
        turns = self.task.turns(self.depths)
        return Legs(self.headings, self.glide_angles, turns, self.drift)

    @property
    def glide_angles(self) -> Array:
        """Glide angles, shape (L,) [rad]; for a glide computed from its duration."""
        if not self.task.is_glide:
            return self.angles
        low, high = self.task.turns(self.depths)[:, 0]
        way = self.vehicle.speed * self.angles * HOUR
        return np.asarray(np.arcsin(np.clip(abs(high - low) / way, 0.0, 1.0)))

    @property
    def steps(self) -> int:
        """Number of integration steps per dive or climb, limited to some minutes each."""
        if self.task.is_glide:
            return _GLIDE_STEPS
        lasts = float(np.max(self.depths)) / float(self.vehicle.speeds(np, np.min(self.angles))[1])
        return max(int(np.ceil(lasts / _LONGEST)), COARSE)

    def _blend(self, path: Path, since: Array, cuts: Array) -> float:
        """Update the passing point of each goal below the surface within a leg; return the largest shift [m]."""
        moved, points = 0.0, self._points()
        for j, leg in enumerate(self.start.goal_legs[:-1]):
            goal = self.task.goals[j]
            if goal[2] == 0.0:
                continue
            k, depths = leg - 1, path.depths[:, leg - 1] - goal[2]
            passes = np.flatnonzero((depths[:-1] * depths[1:] <= 0.0) & (depths[:-1] != depths[1:]))
            share = depths[passes] / (depths[passes] - depths[passes + 1])
            at = since[passes, k] + share * (since[passes + 1, k] - since[passes, k])
            places = _along(path, since, k, at)
            best = int(np.argmin(np.linalg.norm(places - goal[:2], axis=1)))
            m = int(min(np.searchsorted(cuts[k], at[best]), self.segments - 1))
            begin, row = cuts[k, m - 1] if m else 0.0, k * self.segments + m
            part = (at[best] - begin) / max(cuts[k, m] - begin, 1.0)
            before = points[:].T @ self.met[:, j] + KM * self.bend[:, j]
            self.met[:, j] = 0.0
            self.met[row : row + 2, j] = 1.0 - part, part
            self.bend[:, j] = (places[best] - points.T @ self.met[:, j]) / KM
            moved = max(moved, float(np.linalg.norm(places[best] - before)))
        return moved

    def _settled(self, gap: Array, moved: float, walled: bool, number: int) -> bool:
        """Update the defects from the simulated legs; return whether the iteration has converged."""
        self.defect = self.defect + gap.T / KM
        margin = self.task.settings.margin
        lacks = margin - (self.walls.clearance(self.flown) if walled else inf)
        if number >= _PATIENT and _LACKING < lacks < margin:
            self.extra = min(self.extra + _ADDED * lacks, _MOST_ADDED)
        summed = float(np.max(np.linalg.norm(np.cumsum(gap, axis=0), axis=1)))
        left = _SETTLED if lacks > -2.0 * margin else _EXACT if self.task.is_glide else _FREE
        return summed < left and moved < _FREE and lacks < _LACKING

    def _solution(self, status: str, iterations: int) -> Solution:
        """Return the solution with its legs simulated in sequence."""
        request = replace(self.task.request, vehicle=self.vehicle)
        task = replace(self.task, request=request)
        start = replace(
            self.start,
            lines=self.flown.lines.reshape(self.legs, -1, 2),
            angles=self.angles,
            depths=self.depths,
            defect=self.defect,
        )
        flight = joined_flight(self.path, self.task.start_time)
        how = Solved(self.walls.clearance(self.flown), iterations, status, self.steps)
        return judged_solution(task, start, self.commands, flight, self.start.goal_legs, how)


def _along(path: Path, since: Array, k: int, at: Array) -> Array:
    """Return the positions of a leg, shape (n, 2) [m], at times since its beginning [s]."""
    return np.column_stack([np.interp(at, since[:, k], path.places[:, k, i]) for i in (0, 1)])


def _cut(lines: Array, segments: int) -> Array:
    """Return legs, shape (L, n, 2), divided into segments, shape (L M, n, 2), with equal numbers of points."""
    legs, count = lines.shape[:2]
    at = np.linspace(0.0, count - 1.0, segments * (count - 1) + 1)
    before = np.minimum(at.astype(int), count - 2)
    share = (at - before)[None, :, None]
    fine = lines[:, before] + share * (lines[:, before + 1] - lines[:, before])
    samples = (np.arange(segments) * (count - 1))[:, None] + np.arange(count)
    return np.asarray(fine[:, samples].reshape(legs * segments, count, 2))
