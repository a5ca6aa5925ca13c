"""Currents of simulated flights: one or more on the same basis functions, steady or time-dependent, with local corrections."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import (
    DepthFunctions,
    NodeKernel,
    StreamFunctionLattice,
    depth_weights,
)
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.core.geodesy import heading_deg
from replay_kit.core.grid import Projection

#: A current that does not change, or its flows at increasing times.
Flow = FlowEstimate | Sequence[FlowEstimate]


@dataclass(frozen=True, slots=True, eq=False)
class LocalSample:
    """Flow with a sample of the local correction (``LocalCurrent.sample``).

    Attributes:
        flow: Flow.
        times_ns: Times, shape (T,), increasing [ns, UTC].
        velocity: Local correction, shape (T, 2) [m/s], local east and north; linear between the times, constant beyond.
    """

    flow: Flow
    times_ns: NDArray[np.int64]
    velocity: Array


#: A current, with a course of that beside it or without.
Sample = Flow | LocalSample


@dataclass(frozen=True, slots=True, eq=False)
class Courses:
    """Horizontally uniform local corrections, one for each of K flows.

    Attributes:
        times: Times, shape (T,) [s], on the clock of the flows.
        velocity: Velocity, shape (K, T, 2) [m/s], local east and north.
    """

    times: Array
    velocity: Array

    def at(self, times: Array) -> Array:
        """Return the velocities, shape (K, 2) [m/s], at times of shape (K,) or one for all [s]."""
        first, share = knot_before(self.times, times)
        rows, share = np.arange(len(self.velocity)), share[..., None]
        return np.asarray(
            (1.0 - share) * self.velocity[rows, first] + share * self.velocity[rows, first + 1]
        )


def knot_before(knots: Array, at: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the index of the knot before each time, and the fraction towards the next, clipped to [0, 1]."""
    first = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, max(knots.size - 2, 0))
    return first, np.clip((at - knots[first]) / (knots[first + 1] - knots[first]), 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Currents:
    """Set of K currents on the same basis functions.

    Attributes:
        flow: One of the flows, for levels and functions.
        latent: Latent values, shape (K, M, Z T).
        times: Times, shape (T,) [s]; None for steady flows.
        beside: Local correction of each flow; None without.
        pace: Relative speed through water in each flow, shape (K,); None for 1.
        numbers: Flow number of each position; None for all in order.
    """

    flow: FlowEstimate
    latent: Array
    times: Array | None
    beside: Courses | None = None
    pace: Array | None = None
    numbers: NDArray[np.intp] | None = None

    def clock(self, time_ns: int) -> float:
        """Return a time [ns, UTC] on the clock of ``times`` [s]; 0 for steady currents or without a time."""
        first, changes = self.flow.time_ns, self.times is not None or self.beside is not None
        return 0.0 if not changes or first is None or time_ns == 0 else (time_ns - first) / 1e9

    def since(self, time_ns: int) -> "Currents":
        """Return the currents on a clock that begins at a time [ns, UTC]."""
        begin, beside = self.clock(time_ns), self.beside
        return replace(
            self,
            times=None if self.times is None else self.times - begin,
            beside=None if beside is None else replace(beside, times=beside.times - begin),
        )

    def through(self, begin: float, lasts: float) -> tuple[Array, Array]:
        """Return the times of one flow within an interval, shape (T,) [s since its begin], and its latent values, shape (M, Z T).

        Args:
            begin: Begin on the clock of ``times`` [s].
            lasts: Largest duration [s].
        """
        if self.times is None:
            return np.zeros(1), self.latent[0]
        times, levels = self.times - begin, np.arange(self.flow.levels.size)
        # what lies before or after counts through the nearest time alone
        keep = np.flatnonzero(
            (np.append(times[1:], np.inf) > 0.0) & (np.append(-np.inf, times[:-1]) < lasts)
        )
        taken = (keep[:, None] * levels.size + levels).ravel()
        return times[keep], self.latent[0][:, taken]

    def some(self, numbers: NDArray[np.intp], pace: Array | None = None) -> "Currents":
        """Return a subset of the currents by number, without copying the flows, with their paces."""
        beside = self.beside
        found = replace(
            self,
            beside=None if beside is None else replace(beside, velocity=beside.velocity[numbers]),
            pace=pace,
            numbers=numbers if self.numbers is None else self.numbers[numbers],
        )
        # the cache of the same flows
        found.__dict__["columns"] = self.columns
        return found

    @cached_property
    def columns(self) -> Array:
        """Latent values by level and time, shape (Z T, K, M); few have a weight at any depth."""
        return np.ascontiguousarray(self.latent.transpose(2, 0, 1))

    def weights(self, depths: Array) -> Array:
        """Return the weights of levels at depths [m], shape (n, Z)."""
        return depth_weights(self.flow.depth_functions, depths, self.flow.levels)

    def velocity(self, place: Array, of_levels: Array, time: Array | float) -> Array:
        """Return the current of each flow at its own position, shape (K, 2) [m/s]; a single flow is evaluated at all positions.

        Args:
            place: Positions, shape (K, 2) [m].
            of_levels: Weights of levels at the depth, shape (Z,), or (K, Z) for individual depths.
            time: Time on the clock of ``times``, one or shape (K,) [s].
        """
        now, count = np.broadcast_to(time, len(place)), len(place)
        weights = np.broadcast_to(of_levels, (count, of_levels.shape[-1]))
        if self.times is not None and self.times.size > 1:
            (first, share), rows = knot_before(self.times, now), np.arange(count)
            of_times = np.zeros((count, self.times.size, weights.shape[1]))
            of_times[rows, first] = (1.0 - share)[:, None] * weights
            of_times[rows, first + 1] = share[:, None] * weights
            weights = of_times.reshape(count, -1)
        used = np.flatnonzero(weights.any(axis=0))
        parts = [(weights[:, i, None], self.columns[i]) for i in used]
        parts = parts or [(np.zeros(1), self.columns[0])]
        numbers = np.arange(len(self.latent)) if self.numbers is None else self.numbers
        numbers, functions = np.broadcast_to(numbers, count), self.flow.horizontal
        if isinstance(functions, StreamFunctionLattice):
            flowing = functions.velocity_of_each(place, numbers, parts)
        else:
            assert isinstance(functions, NodeKernel)
            latent = sum(weight * values[numbers] for weight, values in parts)
            flowing = _from_nodes(functions, place, np.asarray(latent))
        return flowing if self.beside is None else flowing + self.beside.at(now)


def _from_nodes(functions: NodeKernel, place: Array, latent: Array) -> Array:
    """Return the velocity at positions, shape (P, 2) [m/s], from latent velocities, shape (P, 2N) or (1, 2N).

    The kernel matrix (``velocity_kernel``) is never formed: with w = k (sy beta_u - sx beta_v), its product with the latent
    velocities is (k beta_u / ly^2 - sy w, k beta_v / lx^2 + sx w), summed over the nodes.
    """
    kernel, nodes, n = functions.kernel, functions.nodes, len(functions.nodes)
    dx, dy = place[:, :1] - nodes[:, 0], place[:, 1:] - nodes[:, 1]
    sx, sy = dx / kernel.length_east**2, dy / kernel.length_north**2
    k = (kernel.speed * kernel.length_east) ** 2 * np.exp(-0.5 * (sx * dx + sy * dy))
    east, north = latent[:, :n], latent[:, n:]
    turning = k * (sy * east - sx * north)
    u = np.sum(k * east, axis=1) / kernel.length_north**2 - np.sum(sy * turning, axis=1)
    v = np.sum(k * north, axis=1) / kernel.length_east**2 + np.sum(sx * turning, axis=1)
    return np.column_stack([u, v])


def graph_key(flow: FlowEstimate) -> tuple[Hashable, bytes, DepthFunctions, Projection]:
    """Return the cache key of an estimate's graph: horizontal and depth functions, levels and frame."""
    return (
        flow.horizontal.key,
        np.ascontiguousarray(flow.levels).tobytes(),
        flow.depth_functions,
        flow.grid.projection,
    )


def first_of(flow: Flow) -> FlowEstimate:
    """Return an estimate, or the first of estimates at increasing times."""
    return flow if isinstance(flow, FlowEstimate) else flow[0]


def currents_of(flow: Flow) -> Currents:
    """Return the current of an estimate, or of estimates at increasing times, K = 1; see ``currents_of_samples``."""
    return currents_of_samples([flow])


def currents_of_samples(samples: Sequence[Sample]) -> Currents:
    """Return the currents of samples on the same functions.

    Args:
        samples: Steady flows, or for each its flows at increasing times, common to all.

    Raises:
        PlanError: Levels, functions or times differ, times are missing or do not increase, or steady and time-dependent samples are mixed.
    """
    each = [(flow,) if isinstance(flow, FlowEstimate) else flow for flow in flows_of(samples)]
    first, times = each[0][0], [flow.time_ns or 0 for flow in each[0]]
    key = graph_key(first)
    for k, flows in enumerate(each):
        if any(graph_key(flow) != key for flow in flows):
            raise PlanError(
                f"sample {k} is not on the nodes, levels, kernel and depth functions of the first"
            )
        if len(flows) != len(times) or (
            len(flows) > 1 and [flow.time_ns for flow in flows] != times
        ):
            raise PlanError(
                f"sample {k} holds for other times than the first sample, or for none; draw all of them at the same times"
            )
    if len(times) > 1 and min(np.diff(times)) <= 0:
        raise PlanError(f"flows of a sequence have the times {times} ns; expected increasing times")
    latent = np.stack([np.hstack([flow.latent for flow in flows]) for flows in each])
    since = (np.array(times) - times[0]) / 1e9 if len(times) > 1 else None
    return with_courses(Currents(first, latent, since), samples)


def flows_of(samples: Sequence[Sample]) -> list[Flow]:
    """Return the flows of samples, without local corrections."""
    return [sample.flow if isinstance(sample, LocalSample) else sample for sample in samples]


def with_courses(currents: Currents, samples: Sequence[Sample]) -> Currents:
    """Return currents with the local corrections of samples; unchanged without any.

    Raises:
        PlanError: Some samples lack a local correction, their times differ, or the flows have no time.
    """
    each = [sample for sample in samples if isinstance(sample, LocalSample)]
    if not each:
        return currents
    if len(each) < len(samples) or any(
        not np.array_equal(one.times_ns, each[0].times_ns) for one in each
    ):
        raise PlanError(
            "the samples differ in the times of their local corrections, or some have none; draw all of them together"
        )
    if currents.flow.time_ns is None:
        raise PlanError("a local correction needs the time of the flow, which has none")
    times = (each[0].times_ns - currents.flow.time_ns) / 1e9
    return replace(currents, beside=Courses(times, np.stack([one.velocity for one in each])))


# m/s; less takes a dive of three hours less than 100 m aside, and is left to the samples
_NOTICED = 0.01
# Times of a course in the shortest decorrelation time: halfway between two, linear, its spread is 4 % too small at most.
_A_SCALE = 6


def is_noticed(local: LocalCurrent | None) -> bool:
    """Return whether plans use the local correction."""
    return local is not None and float(np.hypot(*local.velocity(local.time_ns))) > _NOTICED


def with_local(
    samples: Sequence[Flow], local: LocalCurrent, begin_ns: int, seconds: float, seed: int
) -> list[LocalSample]:
    """Return samples, each with a sample of the local correction's deviation from the planned one.

    Args:
        samples: Samples of the estimate, including the planned local correction.
        local: Local correction.
        begin_ns: Begin [ns, UTC].
        seconds: Duration [s].
        seed: Seed of the random draws.
    """
    step = float(local.scale.min()) / _A_SCALE
    times = begin_ns + np.round(1e9 * step * np.arange(1 + max(ceil(seconds / step), 1))).astype(
        np.int64
    )
    reckoned = [
        local.velocity(time) if is_noticed(local) else np.zeros(2) for time in times.tolist()
    ]
    courses = local.sample(times.tolist(), len(samples), seed) - np.array(reckoned)
    return [
        LocalSample(sample, times, course) for sample, course in zip(samples, courses, strict=True)
    ]


def local_notes(local: LocalCurrent | None, begin_ns: int) -> tuple[str, ...]:
    """Return notes on the local correction; empty if insignificant.

    Args:
        local: Local correction.
        begin_ns: Begin of the plan [ns, UTC].
    """
    if local is None:
        return ()
    error, (east, north) = local.standard_error(begin_ns), local.velocity(begin_ns)
    if max(error, float(np.hypot(east, north))) < _NOTICED:
        return ()
    use = "the samples include it, decaying with time"
    if is_noticed(local):
        use = f"the plan and {use}"
    return (
        f"local correction of the estimate from recent dives: {100.0 * np.hypot(east, north):.0f} cm/s towards "
        f"{float(heading_deg(east, north)):.0f} degrees, with a standard error of {100.0 * error:.0f} cm/s at the start; {use}",
    )
