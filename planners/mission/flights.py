"""A mission flown in other currents than it was planned on: in a truth, or in samples of the estimate."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from planners.mission.flight import Legs, Sample, currents_of_samples, fly_legs, refine_steps
from planners.mission.leg import leg_depths, step_stops, steps_needed
from planners.mission.task import REFINED
from planners.mission.values import MissionPlan
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_geographic, to_local
from replay_kit.core.grid import Projection

# Share of the surfacings that an ellipse holds.
_SHARE = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class MissionFlights:
    """A mission in K currents.

    Attributes:
        time: shape (n,) [s] since the start; the same in all, as the currents change the places and not the durations.
        depth: shape (n,) [m].
        place: shape (K, n, 2) [m], east and north in the flows' local frame.
        surfacings: shape (K, L, 2), longitude and latitude [degrees] at each leg's end.
        miss: shape (K, G), miss distance of each goal at the time when it should be met [m].
        projection: The flows' local frame.
    """

    time: Array
    depth: Array
    place: Array
    surfacings: Array
    miss: Array
    projection: Projection


def fly_mission(flows: FlowEstimate | Sequence[Sample], plan: MissionPlan) -> MissionFlights:
    """Return the tracks of a mission's headings, glide angles and depths in other currents, without corrections on the way.

    Args:
        flows: Flows on the same nodes, of each that changes its flows at the same increasing times; their projection may differ from
            that of the plan's flow.
        plan: The mission.

    Raises:
        PlanError: The mission has no legs, or the flows are not on the same nodes.
    """
    currents = currents_of_samples([flows] if isinstance(flows, FlowEstimate) else flows)
    legs, projection = legs_of_plan(plan, currents.flow), currents.flow.grid.projection
    start = np.array(
        to_local(projection, plan.start.longitude, plan.start.latitude), dtype=np.float64
    )
    flight = fly_legs(currents, plan.vehicle, start, legs, currents.clock(plan.start_time_ns))
    ends, met = (
        flight.place[:, flight.ends],
        flight.place[:, np.searchsorted(flight.time, plan.goal_times - 1e-6)],
    )
    goals = np.column_stack(
        to_local(projection, *np.array([[goal.longitude, goal.latitude] for goal in plan.goals]).T)
    )
    miss = np.linalg.norm(met - goals, axis=2)
    surfacings = np.stack(to_geographic(projection, ends[..., 0], ends[..., 1]), axis=-1)
    return MissionFlights(flight.time, flight.depth, flight.place, surfacings, miss, projection)


def legs_of_plan(plan: MissionPlan, flow: FlowEstimate, refinement: int = REFINED) -> Legs:
    """Return the commands of a mission.

    Args:
        plan: The mission.
        flow: Any flow on the levels that it is flown in.
        refinement: Steps for each of the optimiser's.

    Raises:
        PlanError: The mission has no legs.
    """
    if len(plan.headings_deg) == 0:
        raise PlanError(f"a mission without legs cannot be flown: {plan.message}")
    levels = step_stops(flow.levels, np.array([goal.depth for goal in plan.goals]))
    depths = tuple(
        refine_steps(
            leg_depths(leg, levels, steps_needed(leg, levels, plan.settings.steps)), refinement
        )
        for leg in plan.yo_depths
    )
    drifts = np.append(np.full(len(plan.yo_depths) - 1, plan.settings.surface_time), 0.0)
    return Legs(np.deg2rad(plan.headings_deg), np.deg2rad(plan.glide_angles_deg), depths, drifts)


def surfacing_ellipses(flights: MissionFlights, plan: MissionPlan) -> Array:
    """Return the ellipse that holds another surfacing of each leg with a probability of 90 %, assuming a normal distribution.

    Mean and covariance are themselves estimated from few flights, which Hotelling's factor allows for.

    Returns:
        Array of shape (L, 5): longitude and latitude of its centre [degrees], semi-axes [m], and the bearing of the major one, clockwise
        from true north, in [0, 180) [degrees].

    Raises:
        PlanError: There are fewer than three flights.
    """
    if len(flights.place) < 3:
        raise PlanError(
            f"an ellipse needs three flights or more, but there are {len(flights.place)}"
        )
    numbers = np.searchsorted(flights.time, plan.surfacing_times - 1e-6)
    # in the local frame: longitudes have no mean across the antimeridian
    centre = np.column_stack(
        to_geographic(flights.projection, *np.mean(flights.place[:, numbers], axis=0).T)
    )
    turn = grid_bearing_of_true_north(flights.projection, *centre.T)
    ellipses = []
    for k, number in enumerate(numbers):
        values, vectors = np.linalg.eigh(np.cov(flights.place[:, number].T))
        minor, major = ellipse_factor(len(flights.place)) * np.sqrt(np.maximum(values, 0.0))
        bearing = np.rad2deg(np.arctan2(*vectors[:, 1]) - turn[k]) % 180.0
        ellipses.append([*centre[k], major, minor, bearing])
    return np.array(ellipses)


def ellipse_factor(count: int) -> float:
    """Return the semi-axes, in sample standard deviations, of the ellipse that holds the next of some points with a probability of 90 %.

    Args:
        count: Number of points, three or more, from whose mean and covariance the ellipse is made.

    References:
        Hotelling (1931); Chew (1966), Confidence, prediction, and tolerance regions for the multivariate normal distribution.
    """
    return float(
        np.sqrt(
            2.0 * (count - 1) * (count + 1) * fdtri(2, count - 2, _SHARE) / (count * (count - 2))
        )
    )
