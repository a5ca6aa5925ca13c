"""The planners: one constant velocity against an exhaustive search, a mission of ten dives against its peers.

The flows are members of the quasi-geostrophic set where the shared data are there, else random eddies.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from planners import GlideSettings, plan
from planners.flow import field_function
from planners.route.region import region_of
from planners.track import fly_glide, fractions_of_duration, rk4_step
from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.horizontal import NodeKernel
from replay_kit.estimator.basis.modes import embed_member
from replay_kit.forecast import read_ensemble
from tests.benchmarks import planners_mission, planners_odds, planners_scenario
from tests.benchmarks.measure import Row, row, seconds
from tests.benchmarks.planners_depth import depth_row
from tests.benchmarks.planners_masked import bounds, masked_row
from tests.benchmarks.planners_search import tabulated
from tests.places import DATA
from tests.planners.flow_samples import eddying_flow, place
from tests.reference.planner import exhaustive_closest_approach

QG = DATA / "qg" / "climatology.nc"
SPEED = 0.3
# Members that pairs are drawn in, a few in each.
_MEMBERS = (5, 12, 17, 23, 29, 35, 41, 53, 60, 71)
# Shortest and longest time to the target's depth [s].
_TIMES = (12 * 3600.0, 48 * 3600.0)
# A target that the search misses by this is out of reach [m].
_MISSED = 2e3


def rows(tiny: bool) -> list[Row]:
    """Return what was measured."""
    made = [
        *glide_rows(tiny),
        flow_row(tiny),
        masked_row(1 if tiny else 200),
        depth_row(1, 112) if tiny else depth_row(40),
    ]
    made += planners_mission.rows(_flows(tiny)[0], 1 if tiny else 6, tiny)
    made += planners_scenario.rows(
        None if tiny or not QG.exists() else QG,
        _MEMBERS[1:2] if tiny else _MEMBERS[1:6:4],
        1 if tiny else 5,
        tiny,
    )
    return made + planners_odds.rows(tiny)


@cache
def _flows(tiny: bool) -> tuple[FlowEstimate, ...]:
    if tiny or not QG.exists():
        return tuple(eddying_flow(seed, speed=0.25) for seed in ((1,) if tiny else _MEMBERS))
    config = RunConfig()
    ensemble = read_ensemble(QG, config.forecast)
    return tuple(embed_member(ensemble, member, config.estimator) for member in _MEMBERS)


def glide_rows(tiny: bool, reachable: int = 100, unreachable: int = 20) -> list[Row]:
    """One constant velocity: closest approach against the best of an exhaustive search; time cold and warm."""
    counts = (1, 1) if tiny else (reachable, unreachable)
    near = _glide_row(_flows(tiny), counts[0], True, tiny)
    return [near] if tiny else [near, _glide_row(_flows(tiny), counts[1], False, tiny)]


def _glide_row(flows: tuple[FlowEstimate, ...], count: int, reachable: bool, tiny: bool) -> Row:
    rng = np.random.default_rng(7 if reachable else 8)
    settings = GlideSettings(max_duration=1.5 * _TIMES[1] if reachable or not tiny else 2e4)
    size = {"headings": 90, "times": 20} if tiny else {}
    cold, warm, searched, worse, right = [], [], [], [], 0
    for k in range(count):
        flow = flows[k % len(flows)]
        began = time.perf_counter()
        begin, end, best = _pair(flow, rng, settings, reachable, size)
        searched.append(time.perf_counter() - began)
        start, goal = place(flow, *begin), place(flow, *end)
        if k < len(flows):
            plan(
                flow, start, goal, settings=settings
            )  # the graph of these nodes is built once for all estimates on them
        took, made = seconds(lambda: plan(flow, start, goal, settings=settings))  # noqa: B023
        cold.append(took)
        warm.append(seconds(lambda: plan(flow, start, goal, settings=settings, warm=made))[0])  # noqa: B023
        worse.append(
            made.closest_approach - best if reachable else made.closest_approach / best - 1.0
        )
        right += made.status == ("reached" if reachable else "unreachable")
    kind = "targets that the truth reaches" if reachable else "targets out of reach"
    error = {"worse_m": float(max(worse))} if reachable else {"past_share": float(max(worse))}
    return row(
        f"one glide, {count} {kind}, {flows[0].nodes.shape[0]} nodes: as near as an exhaustive search (10 m, or 1 % where out of reach)",
        float(np.median(cold)),
        "search of 360 headings by 60 times in a table, refined",
        float(np.median(searched)),
        1.0,
        error,
        said_right=right,
        cold_median_s=float(np.median(cold)),
        cold_asked_s=0.5,
        cold_90_percent_s=float(np.quantile(cold, 0.9)),
        warm_median_s=float(np.median(warm)),
        warm_asked_s=0.2,
        worse_median=float(np.median(worse)),
    )


def draw_pair(flow: FlowEstimate, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a start at the surface and a target at depth that a random glide in the flow reaches."""
    region, depth = region_of(flow.grid), min(500.0, 0.9 * float(flow.levels[-1]))
    while True:
        begin = np.array([*_inside(flow, rng), 0.0])
        heading, lasts = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*_TIMES)
        down = depth / lasts
        along = np.sqrt(SPEED**2 - down**2)
        through = np.array([along * np.sin(heading), along * np.cos(heading), down])
        track = fly_glide(
            flow, begin, through, lasts * fractions_of_duration(0.0, depth, flow.levels, 60)
        )
        if region.allowed(track.position).all():
            return begin, np.array([*track.position[-1, :2], depth])


def _pair(
    flow: FlowEstimate,
    rng: np.random.Generator,
    settings: GlideSettings,
    reachable: bool,
    size: dict[str, int],
) -> tuple[Array, Array, float]:
    """Return a start, a target, and what the search finds; of targets that need not be reachable one that it misses by kilometres."""
    while True:
        begin, end = draw_pair(flow, rng)
        if not reachable:
            end[:2] = _inside(flow, rng)
        best = exhaustive_closest_approach(
            flow, begin, end, SPEED, settings.max_duration, table=tabulated(flow), **size
        )
        if reachable or best > _MISSED:
            return begin, end, best


def _inside(flow: FlowEstimate, rng: np.random.Generator) -> Array:
    low, high = bounds(flow)
    return rng.uniform(0.95 * low + 0.05 * high, 0.05 * low + 0.95 * high)


def flow_row(tiny: bool) -> Row:
    """The Hessian of where a flight of twelve RK4 steps ends, against the same field differentiated by CasADi."""
    flow = _on_nodes(_flows(tiny)[0])
    begin, weights, latent = (
        ca.MX.sym("begin", 3),
        ca.MX.sym("weights", 3),
        ca.MX.sym("latent", *flow.latent.shape),
    )
    field = field_function(flow)
    through, step, given = ca.DM([0.2, 0.1, 0.01]), 900.0, ca.DM(flow.latent)

    def hessian(current: Callable[[Any], Any]) -> ca.Function:
        def rate(at: Any) -> Any:
            return through + ca.vertcat(current(at), 0.0)

        at = begin
        for _ in range(12):
            at = rk4_step(rate, at, step, rate(at))
        return ca.Function(
            "hessian",
            [begin, weights, latent],
            [ca.hessian(ca.dot(weights, at), begin)[0]],
            {"cse": True},
        )

    ours, theirs = hessian(lambda at: field(at, latent)), hessian(_plain(flow, latent))
    points = np.random.default_rng(0).uniform(
        [-2e4, -2e4, 30.0], [2e4, 2e4, 200.0], (2 if tiny else 50, 3)
    )
    (ours_s, values), (theirs_s, expected) = (
        seconds(lambda: [np.asarray(one(at, [0.3, 0.7, 0.2], given)) for at in points], 3)  # noqa: B023
        for one in (ours, theirs)
    )
    apart = max(
        float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(values, expected, strict=True)
    )
    unequal = max(
        float(np.abs(np.asarray(field(at, given)).ravel() - flow.velocity(*at)).max())
        for at in points
    )
    error = {"velocity": unequal, "mean": apart}
    return row(
        f"Hessian of {len(points)} flights of 12 steps, {len(flow.nodes)} nodes",
        ours_s,
        "automatic",
        theirs_s,
        1.0,
        error,
    )


def _on_nodes(flow: FlowEstimate) -> FlowEstimate:
    """Return a flow of kernels at nodes, of currents of the same size drawn at random where the estimate is a sum of other functions."""
    if isinstance(flow.horizontal, NodeKernel):
        return flow
    shape = 2 * len(flow.nodes), flow.levels.size
    drawn = replace(
        flow,
        horizontal=NodeKernel(flow.horizontal.kernel, flow.nodes),
        latent=np.random.default_rng(0).normal(size=shape),
        modes=np.zeros((shape[0], 0)),
        covariance=None,
    )
    points = np.column_stack([flow.nodes, np.full(len(flow.nodes), 100.0)]).T
    size, asked = (float(np.sqrt(np.mean(one.velocity(*points) ** 2))) for one in (drawn, flow))
    return replace(drawn, latent=drawn.latent * asked / size)


def _plain(flow: FlowEstimate, latent: Any) -> Callable[[Any], Any]:
    """Return the field written out plainly, for CasADi to differentiate."""

    def field(at: Any) -> Any:
        kernel, n = flow.horizontal.kernel, len(flow.nodes)
        lower = ca.low(ca.DM(flow.levels), at[2])
        levels = ca.MX(ca.DM(flow.levels))
        share = (at[2] - levels[lower]) / (levels[lower + 1] - levels[lower])
        here = latent[:, lower] * (1.0 - share) + latent[:, lower + 1] * share
        x, y = (
            (at[0] - flow.nodes[:, 0]) / kernel.length_east,
            (at[1] - flow.nodes[:, 1]) / kernel.length_north,
        )
        k = (kernel.speed * kernel.length_east) ** 2 * ca.exp(-0.5 * (x * x + y * y))
        u, v = k * here[:n], k * here[n:]
        terms = y / kernel.length_north * u - x / kernel.length_east * v
        east = ca.sum1(u) / kernel.length_north**2 - ca.dot(y, terms) / kernel.length_north
        return ca.vertcat(
            east, ca.sum1(v) / kernel.length_east**2 + ca.dot(x, terms) / kernel.length_east
        )

    return field
