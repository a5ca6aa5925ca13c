"""A mission's nonlinear program as functions of its unknowns: cost, constraints, and their exact derivatives."""

from dataclasses import dataclass

import numpy as np

from planners.shooting.layout import (
    EACH,
    GIVEN,
    SIGMA,
    FrameMap,
    Layout,
    hessian_scatter,
    jacobian_scatter,
)
from planners.shooting.paths import Derivatives, Paths, Starts, derive, derive_twice, fly_paths
from planners.shooting.schedule import Schedule
from planners.shooting.stream import Stream
from planners.shooting.walls import Limits, Walls
from planners.solver import HOUR, KM
from replay_kit.core.arrays import Array

# Distance [km] below which a weighted distance is a smooth bowl.
BOWL = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The reference path in the program: what it costs to be off it.

    Attributes:
        origin: shape (2,) [km].
        across: shape (2, 2), projection on what counts.
        weights: shape (L, n_places), of a squared kilometre.
        limits: shape (L, n_places) [km].
        slack_cost: Of its slack.
        least_duration: Of the mission [s].
    """

    origin: Array
    across: Array
    weights: Array
    limits: Array
    slack_cost: float
    least_duration: float

    def off(self, places: Array) -> Array:
        """Return the vectors from it to places [km], shape (..., 2), by what counts of them."""
        return np.asarray((places - self.origin) @ self.across.T @ self.across)


@dataclass(frozen=True, slots=True, eq=False)
class MissionCase:
    """The numbers of one mission.

    Attributes:
        stream: Of the current.
        schedule: Of the legs.
        drifts: shape (L,) [s].
        start: shape (2,) [m].
        start_time: [s].
        goals: shape (G, 2) [m].
        walls: What its places keep clear of; None for nothing.
        time_weight: Of an hour.
        miss_weights: Of a squared kilometre missed, of a kilometre missed, of a kilometre missed along one axis.
        plane_cost: Of a kilometre beyond a half-plane.
        reference: The reference path; None without.
    """

    stream: Stream
    schedule: Schedule
    drifts: Array
    start: Array
    start_time: float
    goals: Array
    walls: Walls | None
    time_weight: float
    miss_weights: tuple[float, float, float]
    plane_cost: float
    reference: Reference | None

    @property
    def lengths(self) -> Array:
        """Metres of depth that each leg passes, shape (L,)."""
        return self.schedule.lengths


class MissionFunctions:
    """Cost and constraints of a mission and their derivatives; what is found at some unknowns is kept until others come."""

    def __init__(self, layout: Layout, frames: FrameMap) -> None:
        """Prepare the sparsity of the derivatives; ``case`` is to be set before anything else is asked for."""
        self.layout, self._frames = layout, frames
        self.case: MissionCase | None = None
        self._at, self._first_at, self._value_at = b"", b"", b""
        self._value = 0.0, np.zeros(0)
        self._paths: Paths | None = None
        self._first: Derivatives | None = None
        self._limits: Limits | None = None
        self.jacobian, self.hessian = jacobian_scatter(layout), hessian_scatter(layout)
        self._scale = np.array([KM, KM, 1.0, 1.0, HOUR])[: layout.columns.shape[1]]

    def give(self, case: MissionCase) -> None:
        """Take the numbers of a mission."""
        self.case, self._limits = case, None
        self._at, self._first_at, self._value_at = b"", b"", b""

    def _known(self) -> MissionCase:
        assert self.case is not None, "a case is given before the functions are called"
        return self.case

    def paths(self, unknowns: Array) -> Paths:
        """Return the paths of the legs."""
        key = unknowns.tobytes()
        if self._paths is None or key != self._at:
            case, legs = self._known(), unknowns[: self.layout.slack_at].reshape(-1, EACH)
            begins = np.concatenate([[[*case.start / KM, 0.0]], legs[:-1, :3]])
            given = np.concatenate([begins[:, :2] * KM, legs[:, 3:]], axis=1)
            starts = Starts(
                given,
                case.start_time + begins[:, 2] * HOUR,
                self._frames.value(given, case.lengths),
            )
            self._at, self._paths = key, fly_paths(case.stream, case.schedule, starts)
        return self._paths

    def first(self, unknowns: Array) -> tuple[Paths, Derivatives]:
        """Return the paths and their first derivatives."""
        paths, case = self.paths(unknowns), self._known()
        if self._first is None or self._first_at != self._at:
            self._first_at, self._first = (
                self._at,
                derive(paths, self._frames.first(paths.starts.legs, case.lengths)),
            )
        return paths, self._first

    def _limited(self, paths: Paths) -> Limits:
        """Return the half-planes of the places that count, and those places."""
        walls = self._known().walls
        assert walls is not None, "there are half-planes only of something"
        ends = self._chosen(paths.places) / KM
        if self._limits is None or self._limits.key != self._at:
            self._limits = walls.limits(
                np.concatenate([paths.places[:, :1] / KM, ends[:, :-1]], axis=1), ends, self._at
            )
        return self._limits

    def _chosen(self, by_step: Array) -> Array:
        """Return what belongs to the places that count, shape (L, n_places, ...): ends of steps under water, and the leg's end."""
        n_wet = self._known().schedule.n_wet
        return (
            by_step[:, 1:]
            if by_step.shape[1] == n_wet + 1
            else np.concatenate([by_step[:, 1 : n_wet + 1], by_step[:, -1:]], axis=1)
        )

    def places(self, unknowns: Array) -> Array:
        """Return the places at which half-planes and the reference path count, shape (L, n_places, 2) [m]."""
        return self._chosen(self.paths(unknowns).places)

    def value(self, unknowns: Array) -> tuple[float, Array]:
        """Return the cost and the constraints."""
        # IPOPT asks for either, and again beside their derivatives
        if (key := unknowns.tobytes()) != self._value_at:
            self._value_at, self._value = key, self._valued(unknowns)
        return self._value

    def _valued(self, unknowns: Array) -> tuple[float, Array]:
        case, layout, paths = self._known(), self.layout, self.paths(unknowns)
        legs, (slacks, miss) = unknowns[: layout.slack_at].reshape(-1, EACH), self._misses(unknowns)
        ends = (
            paths.starts.times
            + case.lengths * paths.starts.coefficients[:, SIGMA]
            + case.drifts
            - case.start_time
        )
        equal = np.column_stack([paths.places[:, -1] / KM, ends / HOUR]) - legs[:, :3]
        places = self._chosen(paths.places) / KM
        met = np.array(
            [
                legs[leg, :2] if step == 0 else paths.places[leg, step] / KM
                for leg, step in layout.goals
            ]
        )
        squared, linear, each = case.miss_weights
        cost = case.time_weight * legs[-1, 2] + squared * np.sum(miss**2) + each * np.sum(slacks)
        cost += linear * np.sum(np.sqrt(np.sum(miss**2, axis=1) + BOWL**2))
        parts = [equal.ravel(), (met - case.goals / KM - miss).ravel()]
        if layout.n_planes:
            cost += case.plane_cost * unknowns[-1]
            parts.append((self._limited(paths).beyond - unknowns[-1]).ravel())
        if case.reference is not None:
            reference, slack = case.reference, unknowns[self._reference_at]
            off = np.sum(((places - reference.origin) @ reference.across.T) ** 2, axis=2)
            cost += reference.slack_cost * slack + np.sum(reference.weights * off)
            parts.append(((off - (reference.limits + slack) ** 2) / reference.limits).ravel())
        return float(cost), np.concatenate(parts)

    def _misses(self, unknowns: Array) -> tuple[Array, Array]:
        """Return the slacks of the goals, shape (G, 4), and by how much each is missed, shape (G, 2) [km]."""
        slacks = unknowns[self.layout.slack_at : self._reference_at].reshape(-1, 4)
        return slacks, slacks[:, :2] - slacks[:, 2:]

    @property
    def _reference_at(self) -> int:
        return self.layout.slack_at + 4 * len(self.layout.goals)

    def _places(self, paths: Paths, first: Derivatives) -> tuple[Array, Array, Array]:
        """Return the places that count [km], shape (L, n_places, 2), the derivatives of where their steps begin, and their own.

        Derivatives are by the unknowns, shape (L, n_places, 2, Q).
        """
        moved, scale = self._chosen(first.places) * (self._scale / KM), self._scale / KM
        return (
            self._chosen(paths.places) / KM,
            np.concatenate([first.places[:, :1] * scale, moved[:, :-1]], axis=1),
            moved,
        )

    def gradient(self, unknowns: Array) -> Array:
        """Return the gradient of the cost."""
        case, layout, out = self._known(), self.layout, np.zeros(unknowns.size)
        miss, (squared, linear, each) = self._misses(unknowns)[1], case.miss_weights
        slope = (
            2.0 * squared * miss
            + linear * miss / np.sqrt(np.sum(miss**2, axis=1) + BOWL**2)[:, None]
        )
        out[layout.slack_at : self._reference_at] = (
            each + np.concatenate([slope, -slope], axis=1)
        ).ravel()
        out[layout.slack_at - EACH + 2] = case.time_weight
        if case.reference is not None:
            reference = case.reference
            places, _, moved = self._places(*self.first(unknowns))
            pulls = 2.0 * reference.weights[..., None] * reference.off(places)
            by_leg, columns = np.einsum("lpi,lpiq->lq", pulls, moved), layout.columns
            np.add.at(out, columns[columns >= 0], by_leg[columns >= 0])
            out[self._reference_at] = reference.slack_cost
        if layout.n_planes:
            out[-1] = case.plane_cost
        return out

    def jacobian_entries(self, unknowns: Array) -> Array:
        """Return the entries of the constraints' Jacobian, in the order of its sparsity."""
        case, layout, (paths, first) = self._known(), self.layout, self.first(unknowns)
        places, begins, moved = self._places(paths, first)
        n_legs, n_goals = layout.n_legs, len(layout.goals)
        by_angle = case.lengths * first.coefficients[:, SIGMA, 3] / HOUR
        parts: list[Array] = [moved[:, -1], np.full((n_legs, 3), -1.0), np.ones(n_legs), by_angle]
        parts += [
            first.places[leg, step] * (self._scale / KM) if step else np.ones(2)
            for leg, step in layout.goals
        ]
        parts.append(np.tile([-1.0, -1.0, 1.0, 1.0], n_goals))
        if layout.n_planes:
            limits = self._limited(paths)
            parts += [limits.jacobian(begins, moved), np.full(limits.beyond.shape, -1.0)]
        if case.reference is not None:
            reference, slack = case.reference, unknowns[self._reference_at]
            pulls = 2.0 * reference.off(places) / reference.limits[..., None]
            parts += [
                np.einsum("lpi,lpiq->lpq", pulls, moved),
                -2.0 * (reference.limits + slack) / reference.limits,
            ]
        return self.jacobian(*parts)

    def hessian_entries(self, unknowns: Array, of_cost: float, multipliers: Array) -> Array:
        """Return the entries of the upper triangle of the Lagrangian's Hessian, in the order of its sparsity.

        Args:
            unknowns: Where.
            of_cost: Multiplier of the cost.
            multipliers: Of the constraints.
        """
        case, layout, (paths, first) = self._known(), self.layout, self.first(unknowns)
        places, begins, moved = self._places(paths, first)
        n_legs, n_goals = layout.n_legs, len(layout.goals)
        equal = multipliers[: 3 * n_legs].reshape(n_legs, 3)
        weights, at = np.zeros((n_legs, paths.places.shape[1] - 1, 2)), layout.n_equal
        weights[:, -1] = equal[:, :2]
        for (leg, step), of_goal in zip(
            layout.goals, multipliers[3 * n_legs : at].reshape(n_goals, 2), strict=True
        ):
            if step:
                weights[leg, step - 1] += of_goal
        pulls = np.zeros(places.shape)
        curved, of_slack = np.zeros((n_legs, moved.shape[3], moved.shape[3])), 0.0
        if layout.n_planes:
            limits = self._limited(paths)
            of_planes = multipliers[at : at + limits.beyond.size].reshape(limits.beyond.shape)
            at += of_planes.size
            pulls += limits.pulls(of_planes)
            curved += limits.bend(of_planes, begins, moved)
        if case.reference is not None:
            reference, of_limits = case.reference, multipliers[at:].reshape(places.shape[:2])
            each = 2.0 * (of_cost * reference.weights + of_limits / reference.limits)
            pulls += each[..., None] * reference.off(places)
            across = reference.across @ moved
            curved += np.einsum("lp,lpiq,lpir->lqr", each, across, across, optimize=True)
            of_slack = -2.0 * np.sum(of_limits / reference.limits)
        n_wet = case.schedule.n_wet
        weights[:, :n_wet] += pulls[:, :n_wet]
        if places.shape[1] > n_wet:
            weights[:, -1] += pulls[:, -1]
        second, sums = derive_twice(paths, first, weights / KM)
        sums[:, SIGMA] += equal[:, 2] * case.lengths / HOUR
        second[:, :GIVEN, :GIVEN] += self._frames.second(paths.starts.legs, case.lengths, sums)
        blocks = curved + second * self._scale[:, None] * self._scale
        parts = [blocks, of_cost * self._goal_blocks(unknowns)]
        return (
            self.hessian(*parts, np.array([of_slack]))
            if layout.has_reference
            else self.hessian(*parts)
        )

    def _goal_blocks(self, unknowns: Array) -> Array:
        """Return the second derivatives of the cost by the slacks of each goal, shape (G, 4, 4)."""
        squared, linear, _ = self._known().miss_weights
        miss = self._misses(unknowns)[1]
        radius = np.sqrt(np.sum(miss**2, axis=1) + BOWL**2)[:, None, None]
        bowl = 2.0 * squared * np.eye(2) + linear * (
            np.eye(2) / radius - miss[:, :, None] * miss[:, None] / radius**3
        )
        signs = np.concatenate([np.eye(2), -np.eye(2)])
        return np.asarray(signs @ bowl @ signs.T)
