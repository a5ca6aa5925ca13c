"""A glider's legs flown in a truth, what its ADCP measures on the way, and the mission planner that plans them."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import rotate_to_local, to_geographic, to_local
from replay_kit.core.observation import Measurement
from replay_kit.core.plan import Place
from replay_kit.measurements import observations
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.messages import measured_on
from replay_kit.studies.twins.vehicle import (
    NS_PER_MS,
    Mission,
    Pings,
    Track,
    advected,
    dead_reckoned,
)
from replay_kit.workflows.planning import MissionPlanner
from replay_kit.workflows.replay.planner import PlanResult

# Longest step of a flight, and from one ping to the next [s]; the first ping comes half as long after the surface was left.
_STEP_S = 120.0
_PING_S = 600.0


@dataclass(frozen=True, slots=True)
class Leg:
    """What a glider is commanded at one surfacing.

    Attributes:
        heading_deg: Through water, clockwise from true north, held by a compass.
        along: Horizontal speed through water [m/s].
        down: Vertical speed in dives and climbs [m/s].
        depths: At which it begins, turns and ends [m].
        drift: Time adrift at the surface after it [s].
    """

    heading_deg: float
    along: float
    down: float
    depths: tuple[float, ...]
    drift: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PlannedLegs:
    """A mission as the study of replanning needs it.

    Attributes:
        legs: What the glider is commanded, surfacing after surfacing.
        ends: Where each leg is predicted to end.
        miss: Predicted between the goal and the last of them [m].
        planned: What the planner starts its next search from.
    """

    legs: tuple[Leg, ...]
    ends: tuple[Place, ...]
    miss: float
    planned: PlanResult


def plan_legs(
    planner: MissionPlanner,
    flow: FlowEstimate,
    way: tuple[Place, Place],
    start_time_ns: int,
    most_legs: int,
    warm: PlannedLegs | None = None,
) -> PlannedLegs:
    """Return the best mission found of at most so many legs.

    Args:
        planner: The mission planner.
        flow: The estimate planned on.
        way: Start and goal.
        start_time_ns: [ns, UTC].
        most_legs: Limit on the legs.
        warm: An earlier plan that the search starts from.

    Raises:
        PlanError: The start or the goal is outside of the region or on land.
    """
    limited = replace(planner, settings=replace(planner.settings, max_legs=most_legs))
    planned = limited.plan(flow, *way, start_time_ns, None if warm is None else warm.planned)
    mission = planned.memory
    drifts = np.append(
        np.full(max(len(mission.yo_depths) - 1, 0), mission.settings.surface_time), 0.0
    )
    speeds = (mission.vehicle.speeds(np, angle) for angle in np.deg2rad(mission.glide_angles_deg))
    legs = tuple(
        Leg(float(heading), float(along), float(down), depths, float(drift))
        for heading, (along, down), depths, drift in zip(
            mission.headings_deg, speeds, mission.yo_depths, drifts, strict=False
        )
    )
    ends = tuple(
        Place(float(longitude), float(latitude), 0.0) for longitude, latitude in mission.surfacings
    )
    return PlannedLegs(legs, ends, float(mission.closest_approach[-1]), planned)


def fly_leg(field: Field, place: Array, start_ns: int, leg: Leg) -> Track:
    """Return a leg flown in a truth, by the midpoint rule with steps of two minutes at most.

    Args:
        field: The truth.
        place: shape (2,) [m], local east and north.
        start_ns: When it begins [ns, UTC].
        leg: What the glider is commanded.

    Raises:
        ForecastError: The current carried the glider out of the truth's water.
    """
    through_water = leg.along * np.array(
        [np.sin(np.deg2rad(leg.heading_deg)), np.cos(np.deg2rad(leg.heading_deg))]
    )
    # a compass holds a heading of true north, which turns along the leg
    halfway = place + 0.5 * through_water * float(np.sum(np.abs(np.diff(leg.depths)))) / leg.down
    through_water = np.array(
        rotate_to_local(
            field.grid.projection, *to_geographic(field.grid.projection, *halfway), *through_water
        )
    )
    depth, seconds = [leg.depths[0]], [0.0]
    for begin, end in pairwise(leg.depths):
        duration = abs(end - begin) / leg.down
        shares = np.arange(1, int(np.ceil(duration / _STEP_S)) + 1) / np.ceil(duration / _STEP_S)
        depth += (begin + (end - begin) * shares).tolist()
        seconds += (seconds[-1] + duration * shares).tolist()
    drifts = int(np.ceil(leg.drift / _STEP_S))
    depth += [depth[-1]] * drifts
    seconds += [seconds[-1] + leg.drift * (k + 1) / drifts for k in range(drifts)]
    return advected(field, place, start_ns, np.array(seconds), np.array(depth), through_water)


def measured(
    field: Field, flight: Track, noise: float, rng: np.random.Generator
) -> tuple[Measurement, ...]:
    """Return what an estimator is given of a leg at its end: a profile every ten minutes, and the leg's mean current.

    They go through the messages that a glider logs; between its fixes the positions are dead-reckoned as a shore station does.

    Args:
        field: The truth.
        flight: The leg, from one surfacing to the next.
        noise: Error of each component of each bin [m/s].
        rng: Of the noise.
    """
    seconds = np.arange(_PING_S / 2.0, float(flight.seconds[flight.surfaced]), _PING_S)
    east, north, depth = (
        np.interp(seconds, flight.seconds, values) for values in (*flight.place.T, flight.depth)
    )
    sinks = np.interp(seconds, flight.seconds[1:], np.diff(flight.depth)) > 0.0
    heading = np.mod(np.rad2deg(np.arctan2(*flight.through_water)), 360.0)
    times = flight.start_ns + np.round(seconds * 1e3).astype(np.int64) * NS_PER_MS
    pings = Pings(
        times, east, north, depth, np.full(seconds.size, heading), np.where(sinks, -20.0, 20.0)
    )
    dive, reckoned = dead_reckoned(field, 1, flight, times, depth)
    flown = measured_on(
        Mission(pings, (dive.start, *reckoned, dive.end), (dive,)), field, noise, rng
    )
    return tuple(observations(flown.messages(), MeasurementConfig()))


def distance_to(field: Field, point: Array, goal: Place) -> float:
    """Return the distance [m] of a local point, shape (2,) [m], from a place."""
    east, north = to_local(field.grid.projection, goal.longitude, goal.latitude)
    return float(np.hypot(point[0] - east, point[1] - north))
