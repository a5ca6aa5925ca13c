"""A vehicle's slow twin: commands, or the waypoints of a file, flown in short steps in a current that changes."""

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planners import MissionPlan
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import rate_in_frame, rotate_to_geographic, to_geographic, to_local
from tests.reference.lattice import matrix as functions_at

# Longest step [s]: some ten metres of way.
STEP = 40.0


@dataclass(frozen=True, slots=True, eq=False)
class Sea:
    """A current between its estimates at increasing times, linear in time and between levels; the first and the last hold beyond."""

    flows: Sequence[FlowEstimate]
    start_time_ns: int
    longest_step: float = STEP

    def velocity(self, at: Array, depth: float, now: float) -> Array:
        """Return the current [m/s] at a place [m], a depth [m] and a time since the start [s]."""
        times = [((flow.time_ns or 0) - self.start_time_ns) / 1e9 for flow in self.flows]
        (earlier, later), share = _between(times, now)
        (above, below), depth_share = _between(self.flows[0].levels.tolist(), depth)
        early, late = (
            (1.0 - depth_share) * self.flows[k].latent[:, above]
            + depth_share * self.flows[k].latent[:, below]
            for k in (earlier, later)
        )
        kernel = functions_at(self.flows[0].horizontal, at[None])
        return np.asarray(kernel @ ((1.0 - share) * early + share * late))

    def drift(
        self, begin: tuple[Array, float, float], through: Array, down: float, lasts: float
    ) -> list[tuple[Array, float, float]]:
        """Return (place [m], depth [m], time [s]) after each short step of a constant velocity through water towards true east and north.

        Args:
            begin: Place, depth and time at which it begins.
            through: shape (2,) [m/s].
            down: Vertical speed [m/s].
            lasts: How long [s].
        """
        (at, depth, now) = begin
        steps = max(int(np.ceil(lasts / self.longest_step)), 1)
        frame = self.flows[0].grid.projection
        step, path = lasts / steps, []

        def rate(place: Array, deep: float, when: float) -> Array:
            return np.array(
                rate_in_frame(
                    frame,
                    place[0],
                    place[1],
                    tuple(through),
                    tuple(self.velocity(place, deep, when)),
                )
            )

        for _ in range(steps):
            halfway = at + 0.5 * step * rate(at, depth, now)
            at = at + step * rate(halfway, depth + 0.5 * step * down, now + 0.5 * step)
            depth, now = depth + step * down, now + step
            path.append((at, depth, now))
        return path

    def dive(
        self,
        begin: tuple[Array, float, float],
        plan: MissionPlan,
        heading: float,
        angle: float,
        turns: Sequence[float],
    ) -> list[tuple[Array, float, float]]:
        """Return the path of dives that turn at some depths [m], with a heading and a glide angle [rad] that are held."""
        along, vertical = (float(speed) for speed in plan.vehicle.speeds(np, angle))
        path, through = [begin], along * np.array([np.sin(heading), np.cos(heading)])
        for first, last in pairwise(turns):
            way = self.drift(
                path[-1],
                through,
                float(np.sign(last - first)) * vertical,
                abs(last - first) / vertical,
            )
            path += [*way[:-1], (way[-1][0], last, way[-1][2])]
        return path[1:]


def _between(values: list[float], wanted: float) -> tuple[tuple[int, int], float]:
    """Return the positions of the two increasing values around one, and its share of the way from the first to the second."""
    if wanted <= values[0] or wanted >= values[-1]:
        end = 0 if wanted <= values[0] else len(values) - 1
        return (end, end), 0.0
    later = next(k for k, value in enumerate(values) if value > wanted)
    return (later - 1, later), (wanted - values[later - 1]) / (values[later] - values[later - 1])


def fly_commands(sea: Sea, plan: MissionPlan) -> Array:
    """Return the track of a mission's commands, shape (n, 3) [m]."""
    path = [_begin(sea, plan)]
    for k, turns in enumerate(plan.yo_depths):
        heading, angle = (
            float(np.deg2rad(of[k])) for of in (plan.headings_deg, plan.glide_angles_deg)
        )
        path += sea.dive(path[-1], plan, heading, angle, turns)
        if k < len(plan.yo_depths) - 1 and plan.settings.surface_time > 0.0:
            path += sea.drift(path[-1], np.zeros(2), 0.0, plan.settings.surface_time)
    return _track(path)


def follow_waypoints(
    sea: Sea, plan: MissionPlan, rows: Sequence[dict[str, float]], places: Array, expected: Array
) -> Array:
    """Return the track of a glider that heads for the waypoints of a file, shape (n, 3) [m], until it is at the last.

    It is told a current for its first leg; then it knows that of the leg before, by dead reckoning. It gives up after three times the
    planned legs.

    Args:
        sea: The current.
        plan: Their mission: its vehicle and its start.
        rows: Of the file with the dives, one a waypoint.
        places: shape (n, 2), longitude and latitude of the waypoints [degrees].
        expected: shape (2,), the current that it is told [m/s], local east and north.
    """
    path, current, target = [_begin(sea, plan)], expected, 0
    wanted = np.column_stack(to_local(sea.flows[0].grid.projection, *places.T))
    for leg in range(3 * len(plan.headings_deg) + 3):
        row, (at, depth, now) = rows[target], path[-1]
        angle = np.deg2rad(row["glide_angle_deg"])
        local, share = steer(
            wanted[target] - at,
            (plan.vehicle.speed, angle, 2.0 * row["dives"] * row["depth_m"]),
            plan.settings.surface_time,
            current,
        )
        heading, begin = local - _true_north(sea, at), plan.yo_depths[0][0] if leg == 0 else 0.0
        turns = (begin, *(max(share * row["depth_m"], begin), 0.0) * int(row["dives"]))
        path += sea.dive((at, depth, now), plan, heading, float(angle), turns)
        arrived = float(np.linalg.norm(path[-1][0] - wanted[target])) <= row["radius_m"]
        if arrived and target == len(rows) - 1:
            break
        target += arrived
        if plan.settings.surface_time > 0.0:
            path += sea.drift(path[-1], np.zeros(2), 0.0, plan.settings.surface_time)
        current = _current(
            sea,
            plan,
            at,
            path[-1][0] - at,
            path[-1][2] - now,
            np.rad2deg(heading),
            row["glide_angle_deg"],
        )
    return _track(path)


def steer(
    way: Array, dives: tuple[float, float, float], drift: float, current: Array
) -> tuple[float, float]:
    """Return the heading from local north [rad] that leads straight to a place, and the share of the full depth that is enough, by trial.

    Of the headings that lead ahead the one is taken whose way over ground is nearest to the direction; on the way the drift after the dive
    counts, in the last dive it does not.

    Args:
        way: shape (2,), to the place [m].
        dives: Speed through water [m/s], glide angle [rad], height of the dives and climbs [m].
        drift: At the surface after them [s].
        current: shape (2,) [m/s], expected.
    """
    speed, angle, height = dives
    under = height / (speed * np.sin(angle))
    distance = float(np.hypot(*way))
    ahead = way / distance
    heading, share = 0.0, 1.0
    for lasts in (under + drift, under):
        tried = np.arctan2(*way) + np.linspace(-0.5 * np.pi, 0.5 * np.pi, 361)
        step = np.pi / 360.0
        for _ in range(4):
            through = speed * np.cos(angle) * under / lasts
            over = through * np.column_stack([np.sin(tried), np.cos(tried)]) + current
            across = np.abs(over @ [-ahead[1], ahead[0]])
            best = int(np.argmin(across))
            heading, made_good = float(tried[best]), float(over[best] @ ahead)
            tried, step = heading + np.linspace(-step, step, 41), step / 20.0
        share = distance / (made_good * lasts) if made_good > 0.0 else 1.0
        if share >= 1.0:
            break
    return heading, float(min(max(share, 0.1), 1.0))


def planned_current(sea: Sea, plan: MissionPlan) -> Array:
    """Return the mean current of a plan's first leg [m/s], local east and north, by dead reckoning."""
    begin = _begin(sea, plan)[0]
    way = np.array(to_local(sea.flows[0].grid.projection, *plan.surfacings[0])) - begin
    return _current(
        sea,
        plan,
        begin,
        way,
        plan.surfacing_times[0],
        plan.headings_deg[0],
        plan.glide_angles_deg[0],
    )


def _current(
    sea: Sea, plan: MissionPlan, at: Array, way: Array, lasts: float, heading: float, angle: float
) -> Array:
    """Return the mean current [m/s] of a leg by dead reckoning: way [m], duration [s], heading and glide angle [degrees]."""
    along = float(plan.vehicle.speeds(np, np.deg2rad(angle))[0]) * max(
        lasts - plan.settings.surface_time, 0.0
    )
    local = np.deg2rad(heading) + _true_north(sea, at + 0.5 * way)
    return np.asarray((way - along * np.array([np.sin(local), np.cos(local)])) / lasts)


def _true_north(sea: Sea, at: Array) -> float:
    """Return the bearing of true north in the local frame [rad], clockwise."""
    frame = sea.flows[0].grid.projection
    longitude, latitude = (float(value) for value in to_geographic(frame, *at))
    east, north = rotate_to_geographic(frame, longitude, latitude, 0.0, 1.0)
    return -float(np.arctan2(east, north))


def _begin(sea: Sea, plan: MissionPlan) -> tuple[Array, float, float]:
    place = np.array(
        to_local(sea.flows[0].grid.projection, plan.start.longitude, plan.start.latitude),
        dtype=np.float64,
    )
    return place, plan.start.depth, 0.0


def _track(path: list[tuple[Array, float, float]]) -> Array:
    return np.array([[*at, depth] for at, depth, _ in path])


def read_csv_waypoints(text: str) -> list[dict[str, float]]:
    """Return the rows of a CSV of waypoints; the time of one that is not reached is NaN."""
    return [
        {name: float(value or "nan") for name, value in row.items()}
        for row in csv.DictReader(io.StringIO(text))
    ]


def _degrees(text: str) -> float:
    """Return the degrees of DDDMM.MMMM."""
    sign, number = (-1.0 if text.startswith("-") else 1.0), abs(float(text))
    return sign * (number // 100.0 + number % 100.0 / 60.0)


def read_targets(text: str) -> dict[str, dict[str, str | float]]:
    """Return the targets of a Seaglider's file by their names: ``lat`` and ``lon`` in degrees, ``radius`` [m], ``goto``."""
    targets: dict[str, dict[str, str | float]] = {}
    for line in text.splitlines():
        if line.startswith("/") or not line.strip():
            continue
        name, *pairs = line.split()
        values = dict(pair.split("=") for pair in pairs)
        targets[name] = {
            "lat": _degrees(values["lat"]),
            "lon": _degrees(values["lon"]),
            "radius": float(values["radius"]),
            "goto": values["goto"],
        }
    return targets


def read_mission_arguments(text: str) -> tuple[str, dict[str, float], Array]:
    """Return a Slocum's mission-argument file: name of the behaviour, its arguments, its waypoints (longitude, latitude) [degrees]."""
    lines = [line.split("#")[0].strip() for line in text.splitlines()]
    (name,) = (line.partition("=")[2] for line in lines if line.startswith("behavior_name="))
    inside, arguments, waypoints = "", {}, list[list[float]]()
    for line in lines:
        if found := re.fullmatch(r"<(start|end):(\w+)>", line):
            inside = found[2] if found[1] == "start" else ""
        elif inside == "b_arg" and line:
            key, value = re.fullmatch(r"b_arg: (\w+\(\w+\))\s+(\S+)", line).groups()  # type: ignore[union-attr]
            arguments[key] = float(value)
        elif inside == "waypoints" and line:
            waypoints.append([_degrees(value) for value in line.split()])
    return name, arguments, np.array(waypoints).reshape(-1, 2)
