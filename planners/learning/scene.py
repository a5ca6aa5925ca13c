"""What all plans that learn begin with: places checked, hazards, the errors of the estimate, the vehicle's dives."""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.front.current import Complex, shares_of_levels
from planners.learning.closed_loop import mean_currents, slices
from planners.learning.current import Currents
from planners.learning.loops import Aim, Survey, clear_lines
from planners.learning.rows import Combined, rows_at, together
from planners.learning.values import LearnLeg, LearnRequest, LearnSettings, ValueMap
from planners.mission.task import MissionTask, mission_task
from planners.mission.values import MissionRequest, MissionSettings
from planners.route.hazards import Ring
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.depth_means import DepthMeans, depth_means
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.geodesy import (
    grid_bearing_of_true_north,
    heading_deg,
    inside_grid,
    to_geographic,
    to_local,
)
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Place

#: Times the still water's time after which a mission is given up.
LONGEST = 2.5
# Places of a map of the value of the next profile along its longer side.
_PLACES = 36


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A plan that learns in the local frame.

    Attributes:
        task: Places and hazards, checked as for a mission.
        known: Errors of the means over the dives' depth.
        mean: The current that is known.
        begin: When the plan begins [s], since the estimate's time.
        given: Profiles of others: places, shape (m, 2) [m], and times, shape (m,) [s].
        speed: Greatest horizontal speed through water [m/s].
        leg_time: From one surfacing to the next [s].
        settings: How profiles are brought.
    """

    task: MissionTask
    known: DepthMeans
    mean: Currents
    begin: float
    given: tuple[tuple[Array, Array], ...]
    speed: float
    leg_time: float
    settings: LearnSettings

    @property
    def start(self) -> complex:
        """Where it begins [m]."""
        return complex(*self.task.start[:2])

    @property
    def goals(self) -> Complex:
        """Where it leads, shape (G,) [m]."""
        return self.task.goals[:, 0] + 1j * self.task.goals[:, 1]

    @property
    def projection(self) -> Projection:
        """The local frame."""
        return self.known.flow.grid.projection

    @property
    def hazards(self) -> tuple[Ring, ...]:
        """What dives to the whole depth keep clear of, land and shallows among it."""
        return self.task.rings_at(self.settings.depth)

    def inside(self, survey: Survey) -> NDArray[np.bool_]:
        """Return which surveys lie within the region, shape (C,)."""
        return np.asarray(
            inside_grid(self.known.flow.grid, survey.corners.real, survey.corners.imag).all(axis=1)
        )

    def aim(self, sought: Combined, given: tuple[tuple[Array, Array], ...] | None = None) -> Aim:
        """Return what counts, with the profiles of others."""
        chosen = self.given if given is None else given
        rows = [rows_at(self.known, points, times) for points, times in chosen]
        return Aim(self.known, sought, self.settings.error**2, together(rows) if rows else None)

    def allowed(self, begins: Complex, ends: Complex) -> NDArray[np.bool_]:
        """Return whether straight legs between places, shape (n,) [m], keep clear of what is forbidden and within the region."""
        free = np.asarray(inside_grid(self.known.flow.grid, ends.real, ends.imag))
        lines = shapely.linestrings(
            np.stack([np.stack([one.real, one.imag], axis=-1) for one in (begins, ends)], axis=1)
        )
        return free & clear_lines(lines, self.hazards, self.settings.margin)

    def place(self, point: complex, depth: float = 0.0) -> Place:
        """Return a local point as a place."""
        longitude, latitude = to_geographic(self.projection, point.real, point.imag)
        return Place(float(longitude), float(latitude), depth)


def scene_of(
    flow: FlowEstimate, request: LearnRequest, seconds: float | None, depths: tuple[float, ...] = ()
) -> Scene:
    """Return the scene of a request.

    Args:
        flow: The estimate, with its uncertainty.
        request: What is asked for.
        seconds: How long the whole takes at most [s]; None for as many surfacings as there are profiles, or for a mission's longest.
        depths: At which currents count beside the dives' mean [m].

    Raises:
        PlanError: A place is outside, on land or forbidden, the dives are too deep, or the estimate states no uncertainty.
    """
    settings = request.settings
    if flow.n_modes == 0:
        raise PlanError(
            "the estimate states no uncertainty, so there is nothing to learn (a truth, a member, a mean); give the result of a replay "
            "or a file of --save-estimate"
        )
    goals = request.goals or (request.start,)
    how = MissionSettings(
        depth=settings.depth, margin=settings.margin, clearance=settings.clearance, spline=0
    )
    asked = MissionRequest(
        request.start,
        goals,
        request.vehicle,
        how,
        request.no_go,
        request.bathymetry,
        start_time_ns=request.start_time_ns,
    )
    task = mission_task(flow.mean_flow(), asked)
    if task.settings.depth < settings.depth:
        settings = replace(settings, depth=task.settings.depth)
    along, down = (float(value) for value in request.vehicle.speeds(np, request.vehicle.angles[0]))
    leg_time = settings.dives * 2.0 * settings.depth / down + settings.surface_time
    under_way = 1.0 - settings.surface_time / leg_time
    weights = [shares_of_levels(flow, settings.depth, settings.surface_time / leg_time)[None]]
    if depths:
        weights.append(depth_weights(flow.depth_functions, np.array(depths), flow.levels))
    known = depth_means(flow, np.concatenate(weights))
    if seconds is None:
        way = float(np.linalg.norm(task.goals[-1, :2] - task.start[:2]))
        seconds = leg_time * (
            request.profiles or max(np.ceil(LONGEST * way / (under_way * along) / leg_time), 3.0)
        )
    begin = max((request.start_time_ns - known.time_ns) / 1e9, 0.0) if known.changes else 0.0
    # a static estimate has no clock: its times count from the plan's start
    zero_ns = known.time_ns if known.changes else request.start_time_ns
    known = known if known.changes else replace(known, time_ns=zero_ns)
    mean = mean_currents(known, slices(known, begin, begin + seconds))
    if not np.isfinite(mean.coefficients).all():
        raise PlanError(
            "the estimate's current is not a number everywhere; make the estimate again"
        )
    return Scene(
        task,
        known,
        mean,
        begin,
        _others(request, flow.grid.projection, zero_ns),
        under_way * along,
        leg_time,
        settings,
    )


def _others(
    request: LearnRequest, projection: Projection, zero_ns: int
) -> tuple[tuple[Array, Array], ...]:
    """Return the profiles of others in the local frame and on the scene's clock."""
    others = request.others
    if others is None or not len(others.time_ns):
        return ()
    points = np.column_stack(to_local(projection, others.longitude, others.latitude))
    return ((points, (np.asarray(others.time_ns) - zero_ns) / 1e9),)


def leg_of(
    scene: Scene,
    begin: complex,
    end: complex,
    when: tuple[float, float],
    through_water: complex | None = None,
) -> LearnLeg:
    """Return a leg from one surfacing to the next.

    Args:
        scene: Of the plan.
        begin: Where it begins [m].
        end: Where it ends [m].
        when: When it begins and ends [s], on the scene's clock.
        through_water: The velocity held [m/s]; None for the one that leads there in the current that is known: then it has fixes.
    """
    held = through_water
    if held is None:
        middle = np.array([0.5 * (begin + end)])
        held = (end - begin) / (when[1] - when[0]) - complex(
            scene.mean.at(middle, 0.5 * sum(when))[0]
        )
    at = scene.place(begin)
    turn = np.rad2deg(
        float(grid_bearing_of_true_north(scene.projection, at.longitude, at.latitude))
    )
    where = scene.place(end)
    heading = float(np.mod(heading_deg(held.real, held.imag) - turn, 360.0))
    return LearnLeg(
        heading,
        abs(held),
        (where.longitude, where.latitude),
        when[1] - scene.begin,
        through_water is not None,
    )


def dives_of(
    scene: Scene, begin: complex, ends: Complex, times: Array
) -> tuple[tuple[LearnLeg, ...], Array, Array]:
    """Return the legs of dives, and their track: times [s] since the start, shape (n,), and places, shape (n, 3) [m].

    Args:
        scene: Of the plan.
        begin: Where they begin [m].
        ends: shape (k,) [m], of each leg.
        times: shape (k + 1,) [s], on the scene's clock.
    """
    nodes = np.concatenate([[begin], ends])
    legs = tuple(
        leg_of(scene, nodes[k], nodes[k + 1], (times[k], times[k + 1])) for k in range(len(ends))
    )
    at = np.linspace(0.0, len(ends), 2 * scene.settings.dives * len(ends) + 1)
    along = np.interp(at, np.arange(len(nodes)), nodes)
    depth = np.where(np.arange(at.size) % 2 == 1, scene.settings.depth, 0.0)
    seconds = np.interp(at, np.arange(len(nodes)), times) - scene.begin
    return legs, seconds, np.column_stack([along.real, along.imag, depth])


def value_map(scene: Scene, aim: Aim, time: float, around: Complex, unit: str) -> ValueMap:
    """Return what one more profile is worth at places around a plan.

    Args:
        scene: Of the plan.
        aim: What counts.
        time: Of the profile [s].
        around: Places that the map holds with a margin [m].
        unit: Of the error.
    """
    low, high = (
        complex(around.real.min(), around.imag.min()),
        complex(around.real.max(), around.imag.max()),
    )
    margin = 0.4 * max((high - low).real, (high - low).imag, 10e3)
    sides = np.array([(high - low).real, (high - low).imag]) + 2.0 * margin
    step = float(sides.max()) / _PLACES
    east = np.arange(low.real - margin, high.real + margin + 0.5 * step, step)
    north = np.arange(low.imag - margin, high.imag + margin + 0.5 * step, step)
    places = (east + 1j * north[:, None]).ravel()
    places = places[inside_grid(scene.known.flow.grid, places.real, places.imag)]
    if not places.size:
        return ValueMap(np.zeros(0), np.zeros(0), np.zeros(0), unit)
    empty = np.ones(places.size, dtype=bool)
    left = aim.judge(
        Survey(places[:, None], places[:, None], places[:, None], np.array([time]), empty)
    )
    longitude, latitude = to_geographic(scene.projection, places.real, places.imag)
    return ValueMap(longitude, latitude, aim.before() - left, unit)
