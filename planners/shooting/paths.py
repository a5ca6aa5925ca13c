"""The paths of a mission's legs by the midpoint method, all legs at once, with exact first and second derivatives.

A leg from place x in a frame (``layout.py``) passes known depths: with g = rho + tau (P - x) + kappa u(P, t) per metre of depth, a step of
h metres leads from P to P + h g(M), M = P + h / 2 g(P). All that a leg depends on is q: where it begins, heading, glide angle and, in a
current that changes, when it begins. With A = dg/dP and b = dg/dq at each stage the derivatives obey

    P'_(i+1) = F_i P'_i + h (h / 2 A_M b_P + b_M),    F_i = 1 + h A_M (1 + h / 2 A_P),

and the second derivatives of a weighted sum of the path's points follow from the adjoint of the same recurrence, which weights the second
derivatives of g at each stage: no second derivatives of the points themselves are formed. Between levels the flow is linear in depth,
and a step leads over a hundredth of an eddy: ten dives end within a metre or so of where the classical Runge-Kutta method ends.
"""

from dataclasses import dataclass

import numpy as np

from planners.shooting.layout import COUNT, GIVEN, KAPPA, RHO, SIGMA, STRETCH, TAU
from planners.shooting.schedule import Schedule
from planners.shooting.stream import Stream
from replay_kit.core.arrays import Array

# Where derivatives of the stream function (numbers 4 p + q) are those of the velocity, and their signs: u = dpsi/dy, v = -dpsi/dx.
_VALUE = np.array([1, 4])
_SLOPE = np.array([[5, 2], [8, 5]])
_BEND = np.array([[[9, 6], [6, 3]], [[12, 9], [9, 6]]])
_SIGN = np.array([1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Starts:
    """How legs begin.

    Attributes:
        legs: shape (L, 4): where each begins [m], heading and glide angle [rad].
        times: shape (L,), when [s].
        coefficients: shape (L, 15), of their frames.
    """

    legs: Array
    times: Array
    coefficients: Array

    def clock(self, schedule: Schedule) -> Array:
        """Return the times of the beginning, middle and end of each step of the legs, shape (L, N, 3) [s]."""
        passed = schedule.depth_passed * self.coefficients[:, None, SIGMA:]
        return self.times[:, None, None] + passed + schedule.adrift

    def motion(self, wet: bool) -> tuple[Array, Array]:
        """Return rho, shape (L, 2), and tau beside kappa, shape (L, 2, 4), under water or adrift."""
        number = len(self.legs)
        if wet:
            both = self.coefficients[:, TAU : TAU + 8].reshape(number, 2, 2, 2)
            return self.coefficients[:, RHO:TAU], np.concatenate([both[:, 0], both[:, 1]], axis=2)
        stretch = self.coefficients[:, STRETCH:SIGMA].reshape(number, 2, 2)
        return np.zeros((number, 2)), np.concatenate([np.zeros((number, 2, 2)), stretch], axis=2)


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """The paths of legs.

    Attributes:
        starts: Of the legs.
        schedule: Of the legs.
        places: shape (L, N + 1, 2) [m], where each step begins and the last ends.
        at: shape (L, S, 2) [m], of the stages.
        stream: shape (L, S, m, 16), the stream function's derivatives at the stages, and those of its rate of change.
    """

    starts: Starts
    schedule: Schedule
    places: Array
    at: Array
    stream: Array

    @property
    def phases(self) -> tuple[slice, slice]:
        """The stages under water, and those adrift."""
        n = 2 * self.schedule.n_wet
        return slice(0, n), slice(n, None)

    def velocity(self) -> Array:
        """Return the current at the stages, shape (L, S, 2) [m/s]."""
        return np.asarray(self.stream[:, :, 0, _VALUE] * _SIGN)

    def slope(self) -> Array:
        """Return its derivatives by place and, where the current changes, time: shape (L, S, 2, 2 or 3)."""
        slope = np.asarray(self.stream[:, :, 0, _SLOPE] * _SIGN[:, None])
        if self.schedule.times is None:
            return slope
        return np.concatenate([slope, (self.stream[:, :, 1, _VALUE] * _SIGN)[..., None]], axis=3)

    def bend(self, stages: slice, weights: Array) -> Array:
        """Return the second derivatives of weights . velocity at some stages by place and time, shape (L, s, d, d).

        Args:
            stages: At which.
            weights: shape (L, s, 2).
        """
        weights, stream = weights * _SIGN, self.stream[:, stages]
        bend = np.asarray(np.sum(weights[..., None, None] * stream[:, :, 0, _BEND], axis=2))
        if self.schedule.times is None:
            return bend
        wide = np.zeros((*bend.shape[:2], 3, 3))
        wide[..., :2, :2] = bend
        wide[..., 2, :2] = wide[..., :2, 2] = np.sum(
            weights[..., None] * stream[:, :, 1, _SLOPE], axis=2
        )
        return wide


def fly_paths(stream: Stream, schedule: Schedule, starts: Starts) -> Paths:
    """Return the paths of legs.

    Args:
        stream: Of the flow.
        schedule: Of the legs.
        starts: Of the legs.
    """
    (n_legs, n_steps), begins = schedule.steps.shape, starts.legs[:, :2]
    columns, weights = schedule.columns_at(starts.clock(schedule))
    places, at = np.empty((n_legs, n_steps + 1, 2)), np.empty((n_legs, 2 * n_steps, 2))
    found = np.empty((n_legs, 2 * n_steps, weights.shape[3], 16))
    places[:, 0] = begins
    motions = [starts.motion(wet) for wet in (True, False)]
    for i in range(n_steps):
        here = places[:, i]
        step = schedule.steps[:, i, None]
        rho, matrix = motions[int(i >= schedule.n_wet)]
        for s in (2 * i, 2 * i + 1):
            at[:, s] = here
            found[:, s] = stream.derivatives(
                here, columns[:, i, s % 2], weights[:, i, s % 2]
            ).reshape(n_legs, -1, 16)
            moved = np.concatenate([here - begins, found[:, s, 0, _VALUE] * _SIGN], axis=1)
            rate = rho + (matrix @ moved[..., None])[..., 0]
            here = places[:, i] + (0.5 * step if s == 2 * i else step) * rate
        places[:, i + 1] = here
    return Paths(starts, schedule, places, at, found)


@dataclass(frozen=True, slots=True, eq=False)
class Derivatives:
    """First derivatives of paths.

    Attributes:
        places: shape (L, N + 1, 2, Q), of the steps' ends by what a leg depends on.
        stages: shape (L, S, 2, Q), of the stages' places.
        slope: shape (L, S, 2, 2 or 3), of the current by place and time.
        by_place: shape (L, S, 2, 2), of the rate by the place: A.
        through: shape (L, N, 2, 2), of each step's end by its beginning: F.
        coefficients: shape (L, 15, Q), of the frames.
    """

    places: Array
    stages: Array
    slope: Array
    by_place: Array
    through: Array
    coefficients: Array

    def times(self, schedule: Schedule) -> Array:
        """Return the derivatives of the stages' times, shape (L, S, Q)."""
        times = (
            schedule.stages(schedule.depth_passed)[..., None] * self.coefficients[:, None, SIGMA]
        )
        times[..., GIVEN:] = 1.0
        return np.asarray(times)


def derive(paths: Paths, coefficients: Array) -> Derivatives:
    """Return the first derivatives of paths.

    Args:
        paths: Of the legs.
        coefficients: shape (L, 15, 4), derivatives of those of their frames.
    """
    schedule, (n_legs, n_stages) = paths.schedule, paths.at.shape[:2]
    count, slope = schedule.n_derived, paths.slope()
    wide = np.concatenate([coefficients, np.zeros((n_legs, COUNT, count - GIVEN))], axis=2)
    by_place, by_leg = np.empty((n_legs, n_stages, 2, 2)), np.empty((n_legs, n_stages, 2, count))
    for wet, stages in zip((True, False), paths.phases, strict=True):
        matrix = paths.starts.motion(wet)[1][:, None]
        by_place[:, stages] = matrix[..., :2] + matrix[..., 2:] @ slope[:, stages, :, :2]
        by_leg[:, stages] = _moved(paths, wide, wet) - matrix[..., :2] @ np.eye(2, count)
        if schedule.times is not None:
            times = schedule.stages(schedule.depth_passed)[:, stages, None] * wide[
                :, None, SIGMA
            ] + np.eye(1, count, GIVEN)
            by_leg[:, stages] += (matrix[..., 2:] @ slope[:, stages, :, 2:]) * times[:, :, None]
    step = schedule.steps[..., None, None]
    first, half = by_place[:, ::2], by_place[:, 1::2]
    through = np.eye(2) + step * half @ (np.eye(2) + 0.5 * step * first)
    added = step * (half @ (0.5 * step * by_leg[:, ::2]) + by_leg[:, 1::2])
    places = np.empty((n_legs, schedule.steps.shape[1] + 1, 2, count))
    places[:, 0] = np.eye(2, count)
    for i in range(schedule.steps.shape[1]):
        places[:, i + 1] = through[:, i] @ places[:, i] + added[:, i]
    stages_ = np.empty((n_legs, n_stages, 2, count))
    stages_[:, ::2] = places[:, :-1]
    stages_[:, 1::2] = places[:, :-1] + 0.5 * step * (first @ places[:, :-1] + by_leg[:, ::2])
    return Derivatives(places, stages_, slope, by_place, through, wide)


def _moved(paths: Paths, coefficients: Array, wet: bool) -> Array:
    """Return how the rates at the stages under water or adrift move with the coefficients, shape (L, s, 2, Q)."""
    n_legs, _, count = coefficients.shape
    stages, current = paths.phases[int(not wet)], paths.velocity()
    first = KAPPA if wet else STRETCH
    moved = current[:, stages] @ _by_column(coefficients[:, first : first + 4])
    if wet:
        moved += (paths.at[:, stages] - paths.places[:, :1]) @ _by_column(
            coefficients[:, TAU:KAPPA]
        )
    moved = moved.reshape(n_legs, -1, 2, count)
    return moved + coefficients[:, None, RHO:TAU] if wet else moved


def _by_column(rows: Array) -> Array:
    """Return matrices given row after row, shape (L, 4, Q), as (L, 2, 2 Q): for each column the entries of both rows."""
    n_legs, _, count = rows.shape
    return rows.reshape(n_legs, 2, 2, count).transpose(0, 2, 1, 3).reshape(n_legs, 2, 2 * count)


def adjoint(first: Derivatives, schedule: Schedule, weights: Array) -> Array:
    """Return how much a sum of weights . place over the ends of the steps changes with the rate of each stage, shape (L, S, 2).

    Args:
        first: Of the legs' paths.
        schedule: Of the legs.
        weights: shape (L, N, 2).
    """
    ends = np.empty_like(weights)
    carried = np.zeros((len(weights), 2))
    step = schedule.steps[..., None]
    for i in reversed(range(weights.shape[1])):
        ends[:, i] = carried = carried + weights[:, i]
        carried = (carried[:, None] @ first.through[:, i])[:, 0]
    of_stage = np.empty((len(weights), 2 * weights.shape[1], 2))
    of_stage[:, 1::2] = step * ends
    of_stage[:, ::2] = 0.5 * step * (of_stage[:, 1::2, None] @ first.by_place[:, 1::2])[:, :, 0]
    return of_stage


def derive_twice(paths: Paths, first: Derivatives, weights: Array) -> tuple[Array, Array]:
    """Return the second derivatives of the sum of weights . place over the ends of each leg's steps, in two parts.

    They are the first part, shape (L, Q, Q), and the second derivatives of the sum of the frames' coefficients with the other, (L, 15).

    Args:
        paths: Of the legs.
        first: Their first derivatives.
        weights: shape (L, N, 2).
    """
    schedule, n_legs, count = paths.schedule, len(weights), paths.schedule.n_derived
    of_stage = adjoint(first, schedule, weights)
    moves = (
        first.stages
        if schedule.times is None
        else np.concatenate([first.stages, first.times(schedule)[:, :, None]], axis=2)
    )
    moved = np.concatenate([first.stages - np.eye(2, count), first.slope @ moves], axis=3)
    values = np.concatenate([paths.at - paths.places[:, :1], paths.velocity()], axis=2)
    second = np.zeros((n_legs, count, count))
    sums = np.zeros((n_legs, COUNT))
    flat = (n_legs, -1, count)
    for wet, stages in zip((True, False), paths.phases, strict=True):
        weight, kappa = of_stage[:, stages], paths.starts.motion(wet)[1][:, None, :, 2:]
        of_velocity = (weight[:, :, None] @ kappa)[:, :, 0]
        bent = paths.bend(stages, of_velocity) @ moves[:, stages]
        second += moves[:, stages].reshape(flat).transpose(0, 2, 1) @ bent.reshape(flat)
        if schedule.times is not None:
            rate = np.sum(of_velocity * first.slope[:, stages, :, 2], axis=2)
            sums[:, SIGMA] += np.sum(
                rate * schedule.stages(schedule.depth_passed)[:, stages], axis=1
            )
        # of each row of tau and kappa: what its numbers are multiplied by, and how that moves
        at = np.arange(TAU, TAU + 8) if wet else np.arange(STRETCH, SIGMA)
        transposed, chosen = weight.transpose(0, 2, 1), slice(0, None) if wet else slice(2, None)
        factors = (
            (transposed @ values[:, stages, chosen]).reshape(n_legs, 2, -1, 2).transpose(0, 2, 1, 3)
        )
        sums[:, at] += factors.reshape(n_legs, -1)
        if wet:
            sums[:, RHO:TAU] += weight.sum(axis=1)
        changes = (transposed @ moved[:, stages].reshape(n_legs, -1, 4 * count)).reshape(
            n_legs, 2, 2, 2, count
        )
        changes = (
            changes.transpose(0, 3, 1, 2, 4) if wet else changes.transpose(0, 3, 1, 2, 4)[:, 1:]
        )
        mixed = first.coefficients[:, at].transpose(0, 2, 1) @ changes.reshape(n_legs, -1, count)
        second += mixed + mixed.transpose(0, 2, 1)
    return second, sums
