"""A mission along a shelf, longer than a window: the error of windows that follow the vehicle beside that of one window alone.

The sea is a random stream function of eddies, part of which the members share; the truth is one more draw. It has five functions of depth
on six levels, cosines with the variance of each 0.3 times that of the one before: with two, 50 members span 98 modes and leave out most of
the truth. The vehicle crosses the whole strip in a zigzag. The peer is an estimator of the middle third, with the measurements there.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.points import best_velocity_at
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.core.grid import Ensemble, Projection
from replay_kit.core.observation import Observation
from replay_kit.core.region import Region, box_around
from replay_kit.estimator import ReducedBasisEstimator, build
from replay_kit.estimator.basis.slices import correlation_length
from replay_kit.estimator.windows.filter import WindowedEstimator
from replay_kit.forecast.grids.horizontal import in_frame
from replay_kit.studies.twins.field import build_field
from tests import synthetic
from tests.benchmarks.measure import Row, cpu, peak_mb, row

_WEST, _SOUTH, _STEP = -14.0, 40.0, 1.0 / 12.0
_NOISE, _PLACE = 0.05, ("longitude", "latitude")  # m/s
_DEPTHS = np.array([10.0, 60.0, 110.0, 160.0, 210.0])
LEVELS = np.array([5.0, 50.0, 100.0, 150.0, 200.0, 300.0])
# Functions of depth, and the variance of each relative to that of the one before.
_FUNCTIONS, _DECAY = 5, 0.3


@dataclass(frozen=True)
class Strip:
    """The sea and the mission: points of the grid, members, an eddy's size in cells, points of a window, pings."""

    rows: int = 40
    columns: int = 210
    members: int = 50
    eddy: float = 2.5
    window: int = 1600
    pings: int = 1200


TINY = Strip(10, 30, 8, 1.2, 144, 24)
DEFAULT = EstimatorConfig()
# For tests that ask nothing of the error: without the fit of the prior's share.
QUICK = EstimatorConfig(modes=20, sample_share=0.4)


@dataclass(frozen=True, eq=False)
class Sea:
    """Members, the last of which is the truth, shape (E + 1, 2, Z, J, I) [m/s], true east and north; and where they are [degrees]."""

    longitude: np.ndarray
    latitude: np.ndarray
    velocity: np.ndarray

    def part(
        self, region: Region | None, members: slice, frame: Projection | None = None
    ) -> Ensemble:
        """Return members in a region, in a local frame of their own or another one."""
        west, south, east, north = (-180.0, -90.0, 180.0, 90.0) if region is None else region
        rows = np.flatnonzero((self.latitude >= south) & (self.latitude <= north))
        columns = np.flatnonzero((self.longitude >= west) & (self.longitude <= east))
        values = self.velocity[members][..., rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        found = synthetic.in_local_frame(
            (self.longitude[columns], self.latitude[rows]), LEVELS, values
        )
        return found if frame is None else in_frame(found, frame)


def sea(strip: Strip, seed: int = 0) -> Sea:
    """Return a sea of eddies."""
    rng = np.random.default_rng(seed)
    latitude = _SOUTH + _STEP * np.arange(strip.rows)
    longitude = _WEST + _STEP * np.arange(strip.columns)
    dy = 111_195.0 * _STEP
    dx = dy * np.cos(np.deg2rad(latitude.mean()))
    # closer to each other near the surface, where the stratification is
    stretched = (1.0 - np.exp(-LEVELS / 200.0)) / (1.0 - np.exp(-LEVELS[-1] / 200.0))
    numbers = range(_FUNCTIONS)
    functions = [
        _DECAY ** (0.5 * k) * np.cos(0.9 * k * np.pi * stretched) * np.exp(-LEVELS / 600.0)
        for k in numbers
    ]

    def field() -> np.ndarray:
        edge = 20
        drawn = gaussian_filter(
            rng.standard_normal((strip.rows + edge, strip.columns + edge)), strip.eddy
        )
        inner = drawn[edge // 2 : -edge // 2, edge // 2 : -edge // 2]
        return inner / inner.std()

    shared = [field() for _ in functions]
    velocity = np.empty((strip.members + 1, 2, LEVELS.size, strip.rows, strip.columns))
    for member in velocity:
        parts = [np.sqrt(0.3) * common + np.sqrt(0.7) * field() for common in shared]
        psi = sum(part * depth[:, None, None] for part, depth in zip(parts, functions, strict=True))
        member[0], member[1] = -np.gradient(psi, dy, axis=1), np.gradient(psi, dx, axis=2)
    velocity *= 0.25 / np.sqrt(np.mean(velocity[:, :, 0] ** 2))
    return Sea(longitude, latitude, velocity)


def mission(
    of: Sea, strip: Strip, truth: Ensemble, margin: float, seed: int = 1
) -> list[Observation]:
    """Return the pings of a zigzag from one end to the other, half a margin or more inside the strip."""
    along = np.linspace(-0.5, 0.5, strip.pings)
    inset = 0.5 * margin / 111_195.0
    inset_x = inset / np.cos(np.deg2rad(of.latitude[-1]))
    longitude = of.longitude.mean() + along * (np.ptp(of.longitude) - 2.0 * inset_x)
    turns = 2.0 * np.pi * strip.columns / strip.rows * (along + 0.5)
    half = 0.5 * np.ptp(of.latitude) - inset
    latitude = of.latitude.mean() + half / np.pi * np.arcsin(np.sin(turns))
    places = np.transpose(to_local(truth.grid.projection, longitude, latitude))
    field, rng = build_field(truth), np.random.default_rng(seed)
    values = field.velocity(*places.T[..., None], _DEPTHS)
    values += _NOISE * rng.standard_normal(values.shape)
    return [
        synthetic.profile(truth.grid, *places[k], _DEPTHS, values[k], _NOISE, time_ns=k * 10**9)
        for k in range(strip.pings)
    ]


def windowed(
    of: Sea, strip: Strip, first: Observation, margin: float, config: EstimatorConfig = DEFAULT
) -> WindowedEstimator:
    """Return the estimator of windows about the first ping."""
    side = np.sqrt(strip.window)
    half = (
        0.5
        * _STEP
        * (np.array([max(side, strip.window / strip.rows), min(side, strip.rows)]) - 1.0)
    )
    members = slice(0, strip.members)
    here = np.array([first.longitude, first.latitude])
    region = box_around([here - half, here + half], 0.0)
    corners = [(of.longitude[0], of.latitude[0]), (of.longitude[-1], of.latitude[-1])]
    frame = of.part(region, members).grid.projection

    @lru_cache(maxsize=2)
    def of_region(region: Region) -> ReducedBasisEstimator:
        return build([of.part(region, members, frame)], config, GatingConfig())

    return WindowedEstimator(region, margin, box_around(corners, 1e4), of_region)


def rows(tiny: bool) -> list[Row]:
    """Return the row: time and error of the windows beside those of one."""
    strip, config = (replace(TINY, columns=20, pings=16), QUICK) if tiny else (Strip(), DEFAULT)
    of = sea(strip)
    truth = of.part(None, slice(strip.members, None))
    length = correlation_length(of.part(None, slice(0, strip.members)))
    margin = 4.0 * length
    pings = mission(of, strip, truth, margin)
    peak_mb(anew=True)
    began = time.process_time()
    estimator = windowed(of, strip, pings[0], margin, config)
    state, jumps, flows = estimator.initial(), list[float](), list[FlowEstimate]()
    for ping in pings:
        states = state, estimator.moved(state, ping)
        state = states[1]
        if state.left:
            jumps.append(_jump(estimator, states, ping))
            flows += estimator.left_flows(state)
        state, _ = estimator.assimilate(estimator.without_left(state), [ping])
    flows.append(estimator.flow(state))
    spent, memory = time.process_time() - began, peak_mb()
    west, east = np.quantile(of.longitude, [1.0 / 3.0, 2.0 / 3.0])
    third = (float(west), float(of.latitude[0]), float(east), float(of.latitude[-1]))
    inside = [ping for ping in pings if west <= ping.longitude <= east]

    def alone() -> FlowEstimate:
        one = build([of.part(third, slice(0, strip.members))], config, GatingConfig())
        return one.flow(one.assimilate(one.initial(), inside)[0])

    peer_s, single = cpu(alone)
    ours, theirs = _error(flows, inside, truth), _error([single], inside, truth)
    found = {"relative_to_one_window": ours / theirs}
    size = f"mission of {strip.columns * _STEP * 85.0:.0f} km, {strip.pings} pings"
    # of the errors, not of the times: the peer knows a third of the way
    more = {"ratio": theirs / ours, "error_windows": ours, "error_one_window": theirs}
    return [
        row(
            f"{size}, {len(flows)} windows of {strip.window} points",
            *(spent, "one window of the middle third, with the pings there", peer_s, 1.0 / 1.05),
            found | {"jump_in_standard_errors": max(jumps, default=0.0)},
            **(more | {"windows": len(flows), "peak_mb": memory}),
        )
    ]


def _jump(estimator: WindowedEstimator, states: Sequence[Any], ping: Observation) -> float:
    """Return by how many standard errors the estimate under the vehicle changes at a handover, RMS over depths and components."""
    flows = [estimator.flow(state) for state in states]
    one, other = (flow.velocity_at(ping.longitude, ping.latitude, _DEPTHS) for flow in flows)
    change = np.array([other.u - one.u, other.v - one.v])
    return float(np.sqrt(np.mean((change / [one.u_standard_error, one.v_standard_error]) ** 2)))


def _error(flows: Sequence[FlowEstimate], pings: Sequence[Observation], truth: Ensemble) -> float:
    """Return the RMS error [m/s] about the track, in each place of the surest estimate that holds it."""
    at = [np.array([getattr(one, name) for one in pings])[:, None] for name in _PLACE]
    frame = truth.grid.projection
    true = build_field(truth).velocity(*to_local(frame, *at), _DEPTHS)
    turned = rotate_to_geographic(frame, *at, true[..., 0], true[..., 1])
    found = best_velocity_at(flows, *at, _DEPTHS)
    return float(np.sqrt(np.nanmean((np.stack([found.u, found.v]) - np.stack(turned)) ** 2)))
