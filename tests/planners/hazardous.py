"""Random missions among islands, thin areas, steps and walls of the bottom, and their flights at steps of a metre."""

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from scipy.interpolate import RegularGridInterpolator

from planners import Bathymetry, MissionPlan, MissionRequest, MissionSettings, NoGo, Waypoints
from planners.output import waypoint_text
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from tests.planners.flow_samples import eddying_flow, place
from tests.reference.vehicle import (
    Sea,
    follow_waypoints,
    planned_current,
    read_csv_waypoints,
    read_mission_arguments,
    read_targets,
)
from tests.synthetic_flow import with_weights

LONGITUDE, LATITUDE = np.linspace(151.9, 153.1, 121), np.linspace(-40.45, -39.55, 91)
CLEARANCE = 20.0
# Standard error of the estimates, of the eddies' speed.
ERROR = 0.3
#: What is said of a flight that ends farther from the plan's end than the plan's tolerance.
MISSED = "the plan's end is missed"
# When missions begin, and the times of the estimates: how many, and how far apart [ns].
BEGIN_NS, TIMES, EVERY_NS = 10**18, 9, 6 * 3600 * 10**9


@dataclass(frozen=True, slots=True, eq=False)
class HazardousMission:
    """Estimates of a current at increasing times, and a mission to plan in it."""

    flow: list[FlowEstimate]
    request: MissionRequest

    @property
    def sea(self) -> Sea:
        """The current, to fly in."""
        return Sea(self.flow, self.request.start_time_ns)


def random_mission(seed: int, speeds: tuple[float, float] = (0.03, 0.15)) -> HazardousMission:
    """Return a mission of 10 to 16 km between two places, with two to five things in its way, in a current that changes.

    Within two days one field of eddies turns into another and then into the opposite of the first.

    Args:
        seed: Of all that is random.
        speeds: Least and greatest RMS speed of the eddies at the first level [m/s].
    """
    rng = np.random.default_rng(seed)
    speed = rng.uniform(*speeds)
    first, second = (eddying_flow(number, speed=speed) for number in (seed, seed + 1000))
    # its errors are fields of eddies as well, the same at all depths
    modes = np.column_stack(
        [
            eddying_flow(seed + number, speed=ERROR * speed).latent[:, 0]
            for number in (2000, 3000, 4000)
        ]
    ) / np.sqrt(3.0)
    of_weights = np.kron(np.ones((first.levels.size, first.levels.size)), np.eye(3))
    turned = np.linspace(0.0, np.pi, TIMES)
    flow = [
        with_weights(
            replace(
                first,
                time_ns=BEGIN_NS + k * EVERY_NS,
                latent=np.cos(at) * first.latent + np.sin(at) * second.latent,
            ),
            modes,
            of_weights,
        )
        for k, at in enumerate(turned)
    ]
    here = first
    longitude, latitude = np.meshgrid(LONGITUDE, LATITUDE)
    east, north = to_local(here.grid.projection, longitude, latitude)
    depth = np.full(longitude.shape, rng.uniform(350.0, 900.0))
    # a step or a wall, and an island
    if rng.random() < 0.6:
        across = rng.uniform(0.0, np.pi)
        depth[east * np.cos(across) + north * np.sin(across) > rng.uniform(-3e3, 6e3)] = (
            rng.uniform(90.0, 400.0)
        )
    if rng.random() < 0.6:
        depth[
            np.hypot(east - rng.uniform(-3e3, 3e3), north - rng.uniform(-3e3, 3e3))
            < rng.uniform(500.0, 2000.0)
        ] = -30.0
    areas = tuple(_thin_area(here, rng, k) for k in range(int(rng.integers(1, 4))))
    far = rng.uniform(5e3, 8e3)
    ends = (place(here, -far, rng.uniform(-2e3, 2e3)), place(here, far, rng.uniform(-2e3, 2e3)))
    settings = MissionSettings(
        depth=rng.uniform(200.0, 390.0), surface_time=300.0, max_legs=80, clearance=CLEARANCE
    )
    bottom = Bathymetry(longitude, latitude, depth)
    request = MissionRequest(
        ends[0],
        (ends[1],),
        settings=settings,
        no_go=areas,
        bathymetry=bottom,
        start_time_ns=BEGIN_NS,
    )
    return HazardousMission(flow, request)


def _thin_area(flow: FlowEstimate, rng: np.random.Generator, number: int) -> NoGo:
    """Return an area 2 to 50 m wide and some kilometres long, somewhere across the way."""
    centre = rng.uniform(-4e3, 4e3, 2)
    along = rng.uniform(0.0, np.pi)
    length = rng.uniform(1e3, 5e3)
    width = rng.uniform(2.0, 50.0)
    axis = 0.5 * length * np.array([np.cos(along), np.sin(along)])
    side = 0.5 * width * np.array([-np.sin(along), np.cos(along)])
    corners = [
        place(flow, *(centre + a * axis + b * side))
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    surface_only = bool(rng.random() < 0.3)
    return NoGo(
        tuple((corner.longitude, corner.latitude) for corner in corners),
        f"area {number}",
        surface_only,
    )


def harm_done(mission: HazardousMission, track: np.ndarray) -> str | None:
    """Return what a track, shape (n, 3) [m], crosses at steps of a metre; None when it crosses nothing."""
    frame = mission.flow[0].grid.projection
    fine = np.concatenate(
        [np.linspace(a, b, int(np.linalg.norm(b - a)) + 2) for a, b in pairwise(track)]
    )
    for area in mission.request.no_go:
        ring = shapely.Polygon(np.column_stack(to_local(frame, *np.array(area.polygon).T)))
        counted = fine[fine[:, 2] <= 1e-3] if area.surface_only else fine
        if shapely.contains_xy(ring, counted[:, 0], counted[:, 1]).any():
            return area.name
    bathymetry = mission.request.bathymetry
    assert bathymetry is not None
    longitude, latitude = to_geographic(frame, fine[:, 0], fine[:, 1])
    bottom = RegularGridInterpolator((LATITUDE, LONGITUDE), bathymetry.depth)(
        np.column_stack([latitude, longitude])
    )
    return "the bottom" if np.min(bottom - fine[:, 2]) < CLEARANCE - 0.1 else None


def remembered_currents(
    mission: HazardousMission, plan: MissionPlan, drawn: int
) -> list[np.ndarray]:
    """Return currents that a glider may expect in its first dive [m/s]: none, the plan's, and the first dive's in samples of the estimate.

    Args:
        mission: With the estimate.
        plan: Its plan.
        drawn: Number of samples.
    """
    begin, depths = plan.track[0, :2], np.linspace(0.0, max(plan.yo_depths[0]), 30)
    met = [
        np.mean(sample.velocity(*begin, depths), axis=0)
        for sample in mission.flow[0].sample(drawn, 1)
    ]
    return [np.zeros(2), planned_current(mission.sea, plan), *met]


def harm_of_files(
    mission: HazardousMission, plan: MissionPlan, few: Waypoints, drawn: int = 1
) -> set[str | None]:
    """Return what a glider crosses, or ``MISSED``, that heads for the waypoints of files, read back; None for a flight without harm.

    The dives are those of the CSV. It is flown with each of ``remembered_currents``.

    Args:
        mission: What the waypoints are for.
        plan: Its plan.
        few: The waypoints.
        drawn: Number of samples.
    """
    rows = read_csv_waypoints(waypoint_text(few, Path("few.csv")))
    targets = read_targets(waypoint_text(few, Path("targets"))).values()
    places = (
        np.array([[row["longitude"], row["latitude"]] for row in rows]),
        np.array([[target["lon"], target["lat"]] for target in targets]),
        read_mission_arguments(waypoint_text(few, Path("goto_l10.ma")))[2],
    )
    return {
        _harm_of_flight(mission, plan, follow_waypoints(mission.sea, plan, rows, at, current))
        # two files with the same places, to the last digit, lead the same way
        for at in {at.tobytes(): at for at in places}.values()
        for current in remembered_currents(mission, plan, drawn)
    }


def _harm_of_flight(mission: HazardousMission, plan: MissionPlan, track: np.ndarray) -> str | None:
    off = float(np.linalg.norm(track[-1, :2] - plan.track[-1, :2]))
    return harm_done(mission, track) or (MISSED if off > plan.settings.tolerance else None)
