"""A mission's program as one graph that CasADi differentiates: the twin of its functions computed with NumPy."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planners.shooting.functions import BOWL, MissionCase
from planners.shooting.layout import Layout
from planners.solver import HOUR, KM
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from tests.reference.leg import leg_function, stage_latent


@dataclass(frozen=True)
class Mission:
    """What the graph is made of: the depths of each leg's steps, and latent values at some times."""

    flow: FlowEstimate
    vehicle: Glider
    layout: Layout
    depths: Sequence[Array]
    latent: Array
    times: Array | None


def parameters_of(mission: Mission, case: MissionCase) -> Array:
    """Return the numbers of a mission as the graph takes them."""
    flow, reference = mission.flow, case.reference
    parts = [case.start, [case.start_time], case.goals.ravel(), *mission.depths, case.drifts]
    parts += [] if case.walls is None else [case.walls.planes.ravel()]
    slack_cost = 0.0 if reference is None else reference.slack_cost
    parts += [[case.time_weight, *case.miss_weights, case.plane_cost, slack_cost]]
    if reference is not None:
        parts += [reference.origin, reference.across.ravel(order="F")]
        parts += [reference.weights.ravel(), reference.limits.ravel()]
    parts += [
        stage_latent(mission.latent, flow.levels, flow.depth_functions, depths).ravel(order="F")
        for depths in mission.depths
    ]
    return np.concatenate([np.asarray(part) for part in parts])


def program_graph(mission: Mission) -> dict[str, Any]:
    """Return the program's unknowns, parameters, cost and constraints as expressions."""
    flow, layout = mission.flow, mission.layout
    n_times, n_legs, n_goals, n_planes = (
        1 if mission.times is None else mission.times.size,
        layout.n_legs,
        len(layout.goals),
        layout.n_planes,
    )
    n_steps = mission.depths[0].size - 1
    start, start_time, goals = (
        ca.MX.sym("start", 2),
        ca.MX.sym("start_time"),
        ca.MX.sym("goals", 2, n_goals),
    )
    drifts, weights = ca.MX.sym("drifts", n_legs), ca.MX.sym("weights", 6)
    depths = [ca.MX.sym("depths", n_steps + 1) for _ in range(n_legs)]
    latent = [
        ca.MX.sym("latent", len(flow.latent), (2 * n_steps + 2) * n_times) for _ in range(n_legs)
    ]
    planes = [ca.MX.sym("planes", 3, n_planes * layout.n_places) for _ in range(n_legs)]
    legs = [ca.MX.sym("leg", 5) for _ in range(n_legs)]
    slacks: Any = ca.MX.sym("slacks", 4, n_goals)
    plane_slack = ca.MX.sym("plane_slack", int(n_planes > 0))
    reference = _ReferencePathTerms(n_legs, layout.n_places if layout.has_reference else 0)
    leg = leg_function(flow, mission.vehicle, n_steps, mission.times, layout.n_places > n_steps)
    place, time = start, ca.MX.zeros(1)
    equal, limited, tracks = [], [], []
    for k in range(n_legs):
        heading, angle = legs[k][3], legs[k][4]
        places, end_time = leg(
            place,
            start_time + time * HOUR,
            heading,
            angle,
            depths[k],
            drifts[k],
            latent[k],
        )
        equal.append(
            ca.vertcat(
                places[:, -1] / KM - legs[k][:2], (end_time - start_time) / HOUR - legs[k][2]
            )
        )
        if n_planes:
            limited.append(plane_violations(places / KM, planes[k], n_planes) - plane_slack)
        reference.add(k, places / KM)
        tracks.append(places)
        place, time = legs[k][:2] * KM, legs[k][2]
    misses = [slacks[:2, g] - slacks[2:, g] for g in range(n_goals)]
    for g, (number, step) in enumerate(layout.goals):
        at = legs[number][:2] if step == 0 else tracks[number][:, step - 1] / KM
        equal.append(at - goals[:, g] / KM - misses[g])
    miss_cost = weights[1] * sum(ca.sumsqr(miss) for miss in misses)
    miss_cost += weights[2] * sum(ca.sqrt(ca.sumsqr(miss) + BOWL**2) for miss in misses)
    slack_cost = weights[4] * ca.sum1(plane_slack) + weights[5] * ca.sum1(reference.slack)
    return {
        "x": ca.veccat(*legs, slacks, reference.slack, plane_slack),
        "p": ca.veccat(
            start,
            start_time,
            goals,
            *depths,
            drifts,
            *planes,
            weights,
            *reference.parameters,
            *latent,
        ),
        "f": weights[0] * time
        + miss_cost
        + weights[3] * ca.sum1(ca.vec(slacks))
        + slack_cost
        + reference.cost,
        "g": ca.vertcat(*equal, *limited, *reference.excess),
    }


class _ReferencePathTerms:
    """The terms of a reference path in a mission's program: cost and limit of the distance of each place.

    Attributes:
        parameters: Origin [km], projection, weight and limit [km] of each place.
        slack: The unknown [km] by which the limits are exceeded.
        cost: Of all places.
        excess: Must be 0 or less, one column per leg.
    """

    def __init__(self, n_legs: int, n_places: int) -> None:
        """Make the symbols of ``n_legs`` legs with ``n_places`` places each; without places there are no terms."""
        size = int(n_places > 0)
        self.parameters = (
            ca.MX.sym("origin", 2 * size),
            ca.MX.sym("across", 2 * size, 2 * size),
            ca.MX.sym("reference_weights", n_legs * n_places),
            ca.MX.sym("reference_limits", n_legs * n_places),
        )
        self.slack, self.n_places = ca.MX.sym("reference_slack", size), n_places
        self.cost: Any = ca.MX(1, 1)
        self.excess: list[Any] = []

    def add(self, leg: int, places: Any) -> None:
        """Add the places of a leg, shape (2, n_places) [km]."""
        if self.n_places == 0:
            return
        origin, across, weights, limits = self.parameters
        of_leg = slice(leg * self.n_places, (leg + 1) * self.n_places)
        squared = ca.sum1((across @ (places - ca.repmat(origin, 1, self.n_places))) ** 2).T
        self.cost += ca.dot(weights[of_leg], squared)
        # divided by the limit, so that a far one is as well scaled as a near one
        self.excess.append((squared - (limits[of_leg] + self.slack) ** 2) / limits[of_leg])


def plane_violations(places: Any, planes: Any, n_planes: int) -> Any:
    """Return how far each place [km], a CasADi expression, is beyond each of its half-planes [km]; negative inside."""
    repeated = ca.kron(places, ca.MX.ones(1, n_planes))
    return (ca.sum1(planes[:2, :] * repeated) - planes[2, :] / KM).T
