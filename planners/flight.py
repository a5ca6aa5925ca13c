"""A mission's legs flown densely with NumPy, in one current or in many at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planners.flow import graph_key, latent_over_time
from planners.leg import DRIFT_STEPS, fly_steps
from planners.vehicle import Glider
from replay_kit.errors import PlanError
from replay_kit.flow import FlowEstimate
from replay_kit.kernels.depth import depth_weights
from replay_kit.kernels.horizontal import velocity_kernel
from replay_kit.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class Currents:
    """K flows on the same nodes.

    Attributes:
        flow: One of them: nodes, levels and functions.
        nodes: shape (N, 2) [m].
        latent: shape (K, 2N, Z T).
        times: shape (T,) [s]; None for flows that do not change.
    """

    flow: FlowEstimate
    nodes: Array
    latent: Array
    times: Array | None

    def weights(self, depths: Array) -> Array:
        """Return the weights of the levels, shape (n, Z), at depths [m]."""
        return depth_weights(self.flow.depth_functions, depths, self.flow.levels)

    def velocity(self, place: Array, of_levels: Array, time: float) -> Array:
        """Return the current of each flow [m/s], shape (K, 2), at its own place, shape (K, 2) [m].

        Args:
            place: shape (K, 2) [m].
            of_levels: shape (Z,), the weights of the levels at the depth.
            time: On the clock of ``times`` [s].
        """
        weights = of_levels
        if self.times is not None:
            weights = np.asarray(
                np.kron([np.interp(time, self.times, one) for one in np.eye(self.times.size)], of_levels), dtype=np.float64
            )
        rows = velocity_kernel(self.flow.kernel, place, self.nodes).reshape(2, len(place), -1)
        return np.asarray(np.einsum("ckn,kn->kc", rows, self.latent @ weights))


def currents_of(flow: FlowEstimate | Sequence[FlowEstimate]) -> Currents:
    """Return one current, of an estimate or of several that hold for increasing times."""
    if isinstance(flow, FlowEstimate):
        return Currents(flow, flow.nodes, flow.latent[None], None)
    times, latent = latent_over_time(flow)
    return Currents(flow[0], flow[0].nodes, latent[None], times)


def currents_of_samples(flows: Sequence[FlowEstimate]) -> Currents:
    """Return the currents of several flows that do not change, all on the nodes of the first.

    Raises:
        PlanError: One is on other nodes, levels or functions.
    """
    for k, flow in enumerate(flows):
        if graph_key(flow) != graph_key(flows[0]):
            raise PlanError(f"sample {k} is not on the nodes, levels, kernel and depth functions of the first")
    return Currents(flows[0], flows[0].nodes, np.stack([flow.latent for flow in flows]), None)


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """What a glider is told to do, leg after leg.

    Attributes:
        headings: shape (L,), clockwise from local north [rad].
        angles: shape (L,), glide angles [rad].
        depths: Of the steps of each leg [m].
        drifts: shape (L,) [s], at the surface after each leg.
    """

    headings: Array
    angles: Array
    depths: tuple[Array, ...]
    drifts: Array


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Where the legs lead.

    Attributes:
        time: shape (n,) [s], since the start.
        depth: shape (n,) [m].
        place: shape (K, n, 2) [m], local east and north in each current.
        leg: shape (n,), number of the leg that ends there or later; 0 for the first.
        ends: shape (L,), number of the point at which each leg ends, after its drift.
    """

    time: Array
    depth: Array
    place: Array
    leg: Array
    ends: Array


def fly_legs(currents: Currents, vehicle: Glider, start: Array, legs: Legs, start_time: float = 0.0) -> Flight:
    """Return the flight of some legs.

    Args:
        currents: K flows.
        vehicle: What glides.
        start: shape (2,) [m].
        legs: What it does.
        start_time: On the clock of the currents' times [s].
    """
    time, place = 0.0, np.tile(start, (len(currents.latent), 1))
    path, depths, number, ends = [(place, time)], [float(legs.depths[0][0])], [0], []
    for k, steps in enumerate(legs.depths):
        along, down = (float(speed) for speed in vehicle.speeds(np, legs.angles[k]))
        through = along * np.array([np.sin(legs.headings[k]), np.cos(legs.headings[k])])

        rate = _rate(currents, through, start_time, np.concatenate([steps, 0.5 * (steps[:-1] + steps[1:])]))
        path += fly_steps(rate, *path[-1], steps, np.abs(np.diff(steps)) / down, steps.size - 1)
        depths += list(steps[1:])
        if legs.drifts[k] > 0.0:
            durations, surface = np.full(DRIFT_STEPS, legs.drifts[k] / DRIFT_STEPS), np.zeros(DRIFT_STEPS + 1)
            path += fly_steps(_rate(currents, np.zeros(2), start_time, surface), *path[-1], surface, durations, DRIFT_STEPS)
            depths += [0.0] * DRIFT_STEPS
        number += [k] * (len(path) - len(number))
        ends.append(len(path) - 1)
    places = np.stack([at for at, _ in path], axis=1)
    return Flight(np.array([now for _, now in path]), np.array(depths), places, np.array(number), np.array(ends))


def _rate(currents: Currents, through: Array, start_time: float, depths: Array) -> Callable[[Array, float, float], Array]:
    """Return the velocity over ground as a function of places, depth and time; the depths that it will be asked for are known."""
    weights = dict(zip(depths.tolist(), currents.weights(depths), strict=True))

    def over_ground(at: Array, depth: float, now: float) -> Array:
        return np.asarray(through + currents.velocity(at, weights[float(depth)], start_time + now))

    return over_ground


def refined(depths: Array, factor: int) -> Array:
    """Return the depths of a leg's steps with each step cut in so many."""
    return np.interp(np.arange((depths.size - 1) * factor + 1) / factor, np.arange(depths.size), depths)
