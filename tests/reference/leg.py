"""A leg by the midpoint method as a graph that CasADi differentiates: the twin of the paths of all legs at once."""

from typing import Any

import casadi as ca
import numpy as np

from planners.flow import _field
from planners.mission.flight.legs import fly_midpoints
from planners.shooting.layout import frame_function
from planners.shooting.schedule import DRIFT_STEPS
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, depth_weights


def stage_latent(latent: Array, levels: Array, functions: DepthFunctions, depths: Array) -> Array:
    """Return the latent velocities at each step's beginning, middle and end, and of the surface: shape (2N, (2 n_steps + 2) T).

    Args:
        latent: shape (2N, Z T), as ``field_function`` takes it.
        levels: shape (Z,) [m].
        functions: How levels combine.
        depths: shape (n_steps + 1,) [m].
    """
    stages = np.zeros(2 * depths.size)
    stages[:-1:2], stages[1:-2:2] = depths, 0.5 * (depths[:-1] + depths[1:])
    weights = depth_weights(functions, stages, levels)
    by_time = latent.reshape(len(latent), -1, levels.size) @ weights.T
    return by_time.transpose(0, 2, 1).reshape(len(latent), -1)


def leg_function(
    flow: FlowEstimate, vehicle: Glider, n_steps: int, times: Array | None, drifts: bool
) -> ca.Function:
    """Return the function of one leg: (place, time, heading, glide angle, depths, drift, latent) -> (places after each step, end time).

    Its last place is that after the drift at the surface, which takes the time ``drift`` [s].

    Args:
        flow: Any flow on the nodes; the function takes ``stage_latent``.
        vehicle: The glider.
        n_steps: Steps under water.
        times: As for ``field_function``.
        drifts: Whether there is a drift at the surface; if not, ``drift`` is ignored.
    """
    layer, n_times = _layer_function(flow, times), 1 if times is None else times.size
    place, time = ca.MX.sym("place", 2), ca.MX.sym("time")
    heading, angle, drift, depths = (
        ca.MX.sym("heading"),
        ca.MX.sym("angle"),
        ca.MX.sym("drift"),
        ca.MX.sym("depths", n_steps + 1),
    )
    latent: Any = ca.MX.sym("latent", len(flow.latent), (2 * n_steps + 2) * n_times)
    stages = ca.horzsplit(latent, n_times)
    along, down = vehicle.speeds(ca, angle)
    durations = [ca.fabs(depths[i + 1] - depths[i]) / down for i in range(n_steps)]
    through = along * ca.vertcat(ca.sin(heading), ca.cos(heading))
    rate, turn, stretch = frame_function(flow.grid.projection)(place, through, sum(durations))

    def current(at: Any, stage: int, now: Any) -> Any:
        return layer(at if times is None else ca.vertcat(at, now), stages[stage])

    def over_ground(at: Any, stage: float, now: Any) -> Any:
        return rate + turn @ (at - place) + stretch @ current(at, round(stage), now)

    def drifting(at: Any, _: float, now: Any) -> Any:
        return stretch @ current(at, -1, now)

    # stages are numbered, two to a step, and the number takes the place of the depth
    path = fly_midpoints(
        over_ground, place, time, [2.0 * i for i in range(n_steps + 1)], durations, n_steps
    )
    if drifts:
        path.append(
            fly_midpoints(
                drifting,
                *path[-1],
                [0.0] * (DRIFT_STEPS + 1),
                [drift / DRIFT_STEPS] * DRIFT_STEPS,
                DRIFT_STEPS,
            )[-1]
        )
    inputs = [place, time, heading, angle, depths, drift, latent]
    options: dict[str, Any] = {
        "is_diff_in": [True, True, True, True, False, False, False],
        "never_inline": True,
        "cse": True,
    }
    return ca.Function("leg", inputs, [ca.horzcat(*(at for at, _ in path)), path[-1][1]], options)


def _layer_function(flow: FlowEstimate, times: Array | None) -> ca.Function:
    """Return the function (east and north[ and time], latent) -> velocity of one depth, whose latent values are (M, 1) or (M, T)."""
    return _field(flow, np.zeros(1), DepthFunctions("hat", 1.0), times, ("east", "north"))
