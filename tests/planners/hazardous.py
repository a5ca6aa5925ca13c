"""Random missions among islands, thin areas, steps and walls of the bottom, and their flights at steps of a metre."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
from scipy.interpolate import RegularGridInterpolator

from planners import Bathymetry, MissionPlan, MissionRequest, MissionSettings, NoGo
from planners.mission.flights import fly_mission
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from tests.planners.flow_samples import eddying_flow, place

LONGITUDE, LATITUDE = np.linspace(151.9, 153.1, 121), np.linspace(-40.45, -39.55, 91)
CLEARANCE = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class HazardousMission:
    """A current, or estimates of it at increasing times, and a mission to plan in it."""

    flow: FlowEstimate | list[FlowEstimate]
    request: MissionRequest

    @property
    def grid_flow(self) -> FlowEstimate:
        """A flow on the nodes."""
        return self.flow if isinstance(self.flow, FlowEstimate) else self.flow[0]


def random_mission(seed: int) -> HazardousMission:
    """Return a mission of 10 to 16 km between two places, with two to four things in its way; every third in a current that changes."""
    rng = np.random.default_rng(seed)
    flow: FlowEstimate | list[FlowEstimate] = eddying_flow(seed, speed=rng.uniform(0.03, 0.15))
    if seed % 3 == 0:
        flow = [replace(flow, time_ns=10**18 + k * 43200 * 10**9, latent=flow.latent * (1.0 - 0.3 * k)) for k in range(5)]
    here = flow if isinstance(flow, FlowEstimate) else flow[0]
    longitude, latitude = np.meshgrid(LONGITUDE, LATITUDE)
    east, north = to_local(here.grid.projection, longitude, latitude)
    depth = np.full(longitude.shape, rng.uniform(350.0, 900.0))
    # a step or a wall, and an island
    if rng.random() < 0.6:
        across = rng.uniform(0.0, np.pi)
        depth[east * np.cos(across) + north * np.sin(across) > rng.uniform(-3e3, 6e3)] = rng.uniform(90.0, 400.0)
    if rng.random() < 0.6:
        depth[np.hypot(east - rng.uniform(-3e3, 3e3), north - rng.uniform(-3e3, 3e3)) < rng.uniform(500.0, 2000.0)] = -30.0
    areas = tuple(_thin_area(here, rng, k) for k in range(int(rng.integers(1, 4))))
    far = rng.uniform(5e3, 8e3)
    ends = place(here, -far, rng.uniform(-2e3, 2e3), 0.0), place(here, far, rng.uniform(-2e3, 2e3), 0.0)
    settings = MissionSettings(depth=rng.uniform(200.0, 390.0), surface_time=300.0, max_legs=80, clearance=CLEARANCE)
    when = 0 if isinstance(flow, FlowEstimate) else 10**18
    bottom = Bathymetry(longitude, latitude, depth)
    request = MissionRequest(ends[0], (ends[1],), settings=settings, no_go=areas, bathymetry=bottom, start_time_ns=when)
    return HazardousMission(flow, request)


def _thin_area(flow: FlowEstimate, rng: np.random.Generator, number: int) -> NoGo:
    """Return an area 2 to 50 m wide and some kilometres long, somewhere across the way."""
    centre, along, length, width = rng.uniform(-4e3, 4e3, 2), rng.uniform(0.0, np.pi), rng.uniform(1e3, 5e3), rng.uniform(2.0, 50.0)
    axis = 0.5 * length * np.array([np.cos(along), np.sin(along)])
    side = 0.5 * width * np.array([-np.sin(along), np.cos(along)])
    corners = [place(flow, *(centre + a * axis + b * side), 0.0) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    surface_only = bool(rng.random() < 0.3)
    return NoGo(tuple((corner.longitude, corner.latitude) for corner in corners), f"area {number}", surface_only)


def harm_done(mission: HazardousMission, track: Array) -> str | None:
    """Return what a track, shape (n, 3) [m], crosses at steps of a metre; None when it crosses nothing."""
    frame, fine = (
        mission.grid_flow.grid.projection,
        np.concatenate([np.linspace(a, b, int(np.linalg.norm(b - a)) + 2) for a, b in pairwise(track)]),
    )
    for area in mission.request.no_go:
        ring = shapely.Polygon(np.column_stack(to_local(frame, *np.array(area.polygon).T)))
        counted = fine[fine[:, 2] <= 1e-3] if area.surface_only else fine
        if shapely.contains_xy(ring, counted[:, 0], counted[:, 1]).any():
            return area.name
    bathymetry = mission.request.bathymetry
    assert bathymetry is not None
    longitude, latitude = to_geographic(frame, fine[:, 0], fine[:, 1])
    bottom = RegularGridInterpolator((LATITUDE, LONGITUDE), bathymetry.depth)(np.column_stack([latitude, longitude]))
    return "the bottom" if np.min(bottom - fine[:, 2]) < CLEARANCE - 0.1 else None


def flown_track(mission: HazardousMission, plan: MissionPlan) -> Array:
    """Return the track of a plan's commands, flown anew in steps five times as fine where the current does not change."""
    if not isinstance(mission.flow, FlowEstimate):
        return plan.track
    finer = replace(plan, settings=replace(plan.settings, steps=5 * plan.settings.steps))
    flight = fly_mission(mission.flow, finer)
    return np.column_stack([flight.place[0], flight.depth])
