"""The currents that a mission is flown in: one, or many at once on the same functions, each of which may change; with local ones."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, NodeKernel, depth_weights
from replay_kit.core.flow.lattice import StreamFunctionLattice
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.core.geodesy import heading_deg
from replay_kit.core.grid import Projection

#: A current that does not change, or its flows at increasing times.
Flow = FlowEstimate | Sequence[FlowEstimate]


@dataclass(frozen=True, slots=True, eq=False)
class LocalSample:
    """A flow, and one course of the current about the vehicle beside it (``LocalCurrent.sample``).

    Attributes:
        flow: It.
        times_ns: shape (T,), increasing [ns, UTC].
        velocity: shape (T, 2) [m/s], local east and north; linear between the times, constant before the first and after the last.
    """

    flow: Flow
    times_ns: NDArray[np.int64]
    velocity: Array


#: A current, with a course of that beside it or without.
Sample = Flow | LocalSample


@dataclass(frozen=True, slots=True, eq=False)
class Courses:
    """Currents that are the same everywhere, one beside each of K flows.

    Attributes:
        times: shape (T,) [s], on the clock of the flows.
        velocity: shape (K, T, 2) [m/s], local east and north.
    """

    times: Array
    velocity: Array

    def at(self, times: Array) -> Array:
        """Return the velocity of each at its own time, shape (K, 2) [m/s]; times: shape (K,) or one for all [s]."""
        first, share = between(self.times, times)
        rows, share = np.arange(len(self.velocity)), share[..., None]
        return np.asarray(
            (1.0 - share) * self.velocity[rows, first] + share * self.velocity[rows, first + 1]
        )


def between(knots: Array, at: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the number of the knot before each of some times, and the share of the way to the next: 0 or 1 beyond the ends."""
    first = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, max(knots.size - 2, 0))
    return first, np.clip((at - knots[first]) / (knots[first + 1] - knots[first]), 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Currents:
    """K flows of the same functions.

    Attributes:
        flow: One of them: levels and functions.
        latent: shape (K, M, Z T).
        times: shape (T,) [s]; None for flows that do not change.
        beside: The current beside each flow; None without.
        pace: shape (K,), speed through water in each over the vehicle's; None for that itself.
        numbers: Of the flows at the places asked for; None for all in turn.
    """

    flow: FlowEstimate
    latent: Array
    times: Array | None
    beside: Courses | None = None
    pace: Array | None = None
    numbers: NDArray[np.intp] | None = None

    def clock(self, time_ns: int) -> float:
        """Return a time [ns, UTC] on the clock of ``times`` [s]; 0 for currents that do not change, and for no time."""
        first, changes = self.flow.time_ns, self.times is not None or self.beside is not None
        return 0.0 if not changes or first is None or time_ns == 0 else (time_ns - first) / 1e9

    def since(self, time_ns: int) -> "Currents":
        """Return the same currents on a clock that begins at a time [ns, UTC]."""
        begin, beside = self.clock(time_ns), self.beside
        return replace(
            self,
            times=None if self.times is None else self.times - begin,
            beside=None if beside is None else replace(beside, times=beside.times - begin),
        )

    def through(self, begin: float, lasts: float) -> tuple[Array, Array]:
        """Return the times that one flow may be met, shape (T,) [s] since it begins to be, and its latent values then, shape (M, Z T).

        Args:
            begin: On the clock of ``times`` [s].
            lasts: For how long at most [s].
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
        """Return the currents at places in some of these, by their numbers, without a copy of the flows; with the pace in each."""
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
        """The latent values of each level and time, shape (Z T, K, M): only few of them have a weight at a depth."""
        return np.ascontiguousarray(self.latent.transpose(2, 0, 1))

    def weights(self, depths: Array) -> Array:
        """Return the weights of the levels, shape (n, Z), at depths [m]."""
        return depth_weights(self.flow.depth_functions, depths, self.flow.levels)

    def velocity(self, place: Array, of_levels: Array, time: Array | float) -> Array:
        """Return the current of each flow [m/s], shape (K, 2), at its own place, shape (K, 2) [m]; one flow serves any number of places.

        Args:
            place: shape (K, 2) [m].
            of_levels: shape (Z,), the weights of the levels at the depth; shape (K, Z) where each is at a depth of its own.
            time: On the clock of ``times`` [s], one or shape (K,).
        """
        now, count = np.broadcast_to(time, len(place)), len(place)
        weights = np.broadcast_to(of_levels, (count, of_levels.shape[-1]))
        if self.times is not None and self.times.size > 1:
            (first, share), rows = between(self.times, now), np.arange(count)
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
    """Return the velocity [m/s], shape (P, 2), of latent velocities, shape (P, 2N) or (1, 2N), each at its own place, shape (P, 2) [m].

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


def latent_over_time(flows: Sequence[FlowEstimate]) -> tuple[Array, Array]:
    """Return (times [s] since the first, latent values (M, Z T)) of one flow at several times.

    Args:
        flows: The flow at increasing times, each with its ``time_ns``, all of the same levels and functions.

    Raises:
        PlanError: There are fewer than two, a time is missing or does not increase, or their functions differ.
    """
    if len(flows) < 2:
        raise PlanError(
            f"a flow that changes needs two times or more, but {len(flows)} came; give one flow alone for one that does not"
        )
    for k, flow in enumerate(flows):
        before = flows[max(k - 1, 0)].time_ns
        if flow.time_ns is None or before is None or (k > 0 and flow.time_ns <= before):
            raise PlanError(
                f"flow {k} of a sequence has the time {flow.time_ns} ns after {before} ns; expected increasing times"
            )
        if graph_key(flow) != graph_key(flows[0]):
            raise PlanError(
                f"flow {k} of a sequence is not on the nodes, levels, kernel and depth functions of the first"
            )
    first = flows[0].time_ns or 0
    return np.array([((flow.time_ns or 0) - first) / 1e9 for flow in flows]), np.hstack(
        [flow.latent for flow in flows]
    )


def graph_key(flow: FlowEstimate) -> tuple[Hashable, bytes, DepthFunctions, Projection]:
    """Return what makes two estimates share one graph: functions in the horizontal and in depth, levels and frame; no latent values."""
    return (
        flow.horizontal.key,
        np.ascontiguousarray(flow.levels).tobytes(),
        flow.depth_functions,
        flow.grid.projection,
    )


def currents_of(flow: Flow) -> Currents:
    """Return one current, of an estimate or of several that hold for increasing times."""
    if isinstance(flow, FlowEstimate):
        return Currents(flow, flow.latent[None], None)
    times, latent = latent_over_time(flow)
    return Currents(flow[0], latent[None], times)


def currents_of_samples(samples: Sequence[Sample]) -> Currents:
    """Return the currents of several flows, all of the functions of the first.

    Args:
        samples: Flows that do not change; or of each its flows at increasing times, the same times for all.

    Raises:
        PlanError: One is of other levels or functions, or of other times, or some change and some do not.
    """
    return with_courses(_currents_of_flows(flows_of(samples)), samples)


def flows_of(samples: Sequence[Sample]) -> list[Flow]:
    """Return the flows of samples, without the currents beside them."""
    return [sample.flow if isinstance(sample, LocalSample) else sample for sample in samples]


def _currents_of_flows(samples: Sequence[Flow]) -> Currents:
    each = [(sample,) if isinstance(sample, FlowEstimate) else tuple(sample) for sample in samples]
    for k, flows in enumerate(each):
        if graph_key(flows[0]) != graph_key(each[0][0]):
            raise PlanError(
                f"sample {k} is not on the nodes, levels, kernel and depth functions of the first"
            )
        if (
            len(flows) > 1
            and [flow.time_ns for flow in flows] != [flow.time_ns for flow in each[0]]
        ) or len(flows) != len(each[0]):
            raise PlanError(
                f"sample {k} holds for other times than the first sample; draw all of them at the same times"
            )
    if len(each[0]) == 1:
        return Currents(each[0][0], np.stack([flow.latent for (flow,) in each]), None)
    through = [latent_over_time(flows) for flows in each]
    return Currents(each[0][0], np.stack([latent for _, latent in through]), through[0][0])


def with_courses(currents: Currents, samples: Sequence[Sample]) -> Currents:
    """Return the currents of samples with the courses of these, on the clock of the currents; as they are where samples have none.

    Raises:
        PlanError: One has a course and another has none, or one at other times, or the flows have no time.
    """
    each = [sample for sample in samples if isinstance(sample, LocalSample)]
    if not each:
        return currents
    if len(each) < len(samples) or any(
        not np.array_equal(one.times_ns, each[0].times_ns) for one in each
    ):
        raise PlanError(
            "some samples have a current beside the flow and some have none, or at other times; draw all of them together"
        )
    if currents.flow.time_ns is None:
        raise PlanError("a current beside a flow needs the time of the flow, which has none")
    times = (each[0].times_ns - currents.flow.time_ns) / 1e9
    return replace(currents, beside=Courses(times, np.stack([one.velocity for one in each])))


# m/s; less takes a dive of three hours less than 100 m aside, and is left to the samples
_NOTICED = 0.01
# Times of a course in the shortest decorrelation time: halfway between two, linear, its spread is 4 % too small at most.
_A_SCALE = 6


def is_noticed(local: LocalCurrent | None) -> bool:
    """Return whether plans reckon with the expected current beside the estimate."""
    return local is not None and float(np.hypot(*local.velocity(local.time_ns))) > _NOTICED


def with_local(
    samples: Sequence[Flow], local: LocalCurrent, begin_ns: int, seconds: float, seed: int
) -> list[LocalSample]:
    """Return samples with a course each of the current beside the estimate: what it differs by from the one that plans reckon with.

    Args:
        samples: Of the estimate, and of what plans reckon with.
        local: The current beside the estimate.
        begin_ns: From when on it is needed [ns, UTC].
        seconds: For how long.
        seed: Of the draws.
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
    """Return what the dives so far found beside the estimate; nothing where it is little.

    Args:
        local: The current beside the estimate.
        begin_ns: When the plan begins [ns, UTC].
    """
    if local is None:
        return ()
    error, (east, north) = local.standard_error(begin_ns), local.velocity(begin_ns)
    if max(error, float(np.hypot(east, north))) < _NOTICED:
        return ()
    use = "the samples reckon with it, less and less with time"
    if is_noticed(local):
        use = f"the plan and {use}"
    return (
        f"the dives so far met a current beside the estimate's: {100.0 * np.hypot(east, north):.0f} cm/s towards "
        f"{float(heading_deg(east, north)):.0f} degrees, with a standard error of {100.0 * error:.0f} cm/s at the start; {use}",
    )
