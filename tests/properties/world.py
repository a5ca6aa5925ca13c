"""A small sea in metres of its own, which can be turned, mirrored, put anywhere on the ellipsoid and replayed as any user would.

A relation changes the sea or the place and knows how the answer changes; ``Answer`` is the estimate back in the sea's own metres.
"""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import xarray as xr
from pyproj import Proj

import planners
import replay_kit as rk

LEVELS = np.array([5.0, 60.0, 150.0, 300.0])
HERE = (152.5, -38.0)
# what a replay fits, stated: relations then hold of the estimate alone
STATED = {
    "estimator": {
        "sample_share": 0.5,
        "shift_distance": 1e4,
        "dropped_std": 0.0,
        "spread": 1.0,
        "mean_variance": 0.0,
    }
}
ASKED = np.array(
    [(x, y, z) for x in (-2e4, 3e3, 2.2e4) for y in (-1.7e4, 8e3) for z in (20.0, 150.0)]
)
GLIDER = planners.Glider(speed=0.3)
START, GOAL = (-2.6e4, -1.2e4), (2.2e4, 1.4e4)
QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])  # counter-clockwise
MIRROR = np.diag([1.0, -1.0])  # north for south


@dataclass(frozen=True)
class Sea:
    """Members on a square and profiles along a track.

    axis (N,) [m]; members (E, Z, N, N, 2) [m/s], rows to the north; profiles (P, B, 6): seconds, x, y, depth, u, v.
    """

    axis: np.ndarray
    members: np.ndarray
    profiles: np.ndarray
    error: float = 0.05

    def moved_by(self, matrix):
        """Places and velocities multiplied by a matrix that maps the square onto itself."""
        members = self.members @ matrix.T
        # of a quarter turn the value at (x, y) is that of (y, -x)
        turned = abs(matrix[0, 1]) > 0.5
        members = np.rot90(members, -1, axes=(2, 3)) if turned else members[:, :, ::-1]
        profiles = self.profiles.copy()
        for pair in (slice(1, 3), slice(4, 6)):
            profiles[..., pair] = profiles[..., pair] @ matrix.T
        return replace(self, members=members, profiles=profiles)

    def times(self, factor):
        """All speeds multiplied."""
        profiles = self.profiles * [1, 1, 1, 1, factor, factor]
        return Sea(self.axis, factor * self.members, profiles, abs(factor) * self.error)


def sea(seed=0, rough=2e-3, profiles=25, seconds=1200.0, half=2.5e4, bend=True) -> Sea:
    """Members of six random waves without divergence that decay with depth; the truth is one more."""
    rng, n = np.random.default_rng(seed), 12
    k = rng.normal(0.0, 1 / 3.5e4, (n + 1, 6, 2))
    phase, decay = rng.uniform(0, 2 * np.pi, (n + 1, 6)), rng.uniform(120, 500, (n + 1, 6))

    def flow(member, x, y, z):
        argument = k[member] @ [x, y] + phase[member][:, None]
        wave = 2.8e3 * np.cos(argument) * np.exp(-z / decay[member][:, None])
        return np.stack([k[member, :, 1] @ wave, -k[member, :, 0] @ wave], -1)

    axis = 9e3 * np.arange(-5.0, 6.0)
    x, y = (each.ravel() for each in np.meshgrid(axis, axis))
    members = np.array([[flow(m, x, y, z) for z in LEVELS] for m in range(n)])
    members = members.reshape(n, LEVELS.size, axis.size, axis.size, 2)
    members += rough * rng.standard_normal(members.shape)
    along, depth = np.linspace(-1, 1, profiles), np.linspace(12.0, 250.0, 9)
    across = 0.6 * half * np.sin(2 * along) + 3e3 if bend else 0.0 * along
    t, x, y, z = (
        np.broadcast_to(each, (profiles, 9)).ravel()
        for each in (
            seconds * np.arange(profiles)[:, None],
            half * along[:, None],
            across[:, None],
            depth,
        )
    )
    uv = flow(n, x, y, z) + 0.05 * rng.standard_normal((x.size, 2))
    return Sea(axis, members, np.column_stack([t, x, y, z, uv]).reshape(profiles, 9, 6))


def places(xy, centre):
    """Longitude, latitude and the matrices (..., 2, 2) from the sea's axes to true east and north."""
    frame = Proj(proj="aeqd", lon_0=centre[0], lat_0=centre[1], ellps="WGS84")
    lon, lat = frame(*np.moveaxis(np.asarray(xy, float), -1, 0), inverse=True)
    a = np.deg2rad(frame.get_factors(lon, lat).meridian_convergence)
    return (
        lon,
        lat,
        np.moveaxis([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]], (0, 1), (-2, -1)),
    )


def tables(s: Sea, centre=HERE, east=0.0, per_metre=1.0, date="2018-11-16"):
    """A table of the profiles and a dataset of the members; ``east`` [degrees] is added to all longitudes."""
    lon, lat, turn = places(np.stack(np.meshgrid(s.axis, s.axis), -1), centre)
    true = per_metre * np.einsum("yxij,ezyxj->iezyx", turn, s.members)
    unit = {1.0: "m s-1", 100.0: "cm s-1"}[per_metre]
    forecast = xr.Dataset(
        {
            name: (
                ("member", "depth", "y", "x"),
                values,
                {"standard_name": f"{way}ward_sea_water_velocity", "units": unit},
            )
            for name, way, values in zip("uv", ("east", "north"), true, strict=True)
        },
        {
            "member": ("member", np.arange(len(s.members)), {"standard_name": "realization"}),
            "depth": (
                "depth",
                LEVELS,
                {"positive": "down", "units": "m", "standard_name": "depth"},
            ),
            "lon": (("y", "x"), lon + east, {"units": "degrees_east"}),
            "lat": (("y", "x"), lat, {"units": "degrees_north"}),
            "time": np.datetime64(date, "ns"),
        },
    )
    p = s.profiles.reshape(-1, 6)
    lon, lat, turn = places(p[:, 1:3], centre)
    u, v = np.einsum("nij,nj->in", turn, p[:, 4:])
    time = np.datetime64(date, "ns") + (1e9 * p[:, 0]).astype("timedelta64[ns]")
    of_log = {"time": time, "lon": lon + east, "lat": lat, "depth": p[:, 3], "u": u, "v": v}
    return pd.DataFrame(of_log | {"error": s.error}), forecast


def replayed(s: Sea, centre=HERE, settings=STATED, **more):
    """The estimate after the log."""
    return rk.replay(*tables(s, centre, **more), settings=settings).estimate


@dataclass(frozen=True)
class Answer:
    """Velocities (n, 2) in the sea's axes, and their error (n,), which no turn changes."""

    velocity: np.ndarray
    error: np.ndarray

    def is_like(self, other, limit):
        """Assert that no velocity differs by more than a share of their root mean square, and no error by more of itself."""
        off = np.abs(self.velocity - other.velocity).max() / np.sqrt(np.mean(other.velocity**2))
        assert off <= limit, off
        assert np.abs(self.error / other.error - 1).max() <= limit


def answer(estimate, centre=HERE, matrix=None, factor=1.0, east=0.0) -> Answer:
    """What an estimate says at the asked places of the sea as it was before a matrix and a factor changed it."""
    matrix = np.eye(2) if matrix is None else matrix
    lon, lat, turn = places(ASKED[:, :2] @ matrix.T, centre)
    v = estimate.velocity_at(lon + east, lat, ASKED[:, 2])
    own = np.einsum("nij,ni->nj", turn, np.stack([v.u, v.v], -1)) @ matrix
    return Answer(own / factor, np.hypot(v.u_standard_error, v.v_standard_error) / abs(factor))


def mission(flow, start=START, goal=GOAL, centre=HERE, **more):
    """The plan between places given in the sea's metres."""
    lon, lat, _ = places([start, goal], centre)
    begin, end = (rk.Place(float(x), float(y), 0.0) for x, y in zip(lon, lat, strict=True))
    settings = planners.MissionSettings(depth=250.0, tolerance=300.0, **more)
    return planners.plan_mission(flow, planners.MissionRequest(begin, (end,), GLIDER, settings))
