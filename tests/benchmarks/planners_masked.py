"""Missions among random islands, shelves and areas beside start and goal: none may cross what it may not and not say so."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from planners import MissionPlan, MissionRequest, MissionSettings, NoGo, plan_mission
from planners.route.hazards import no_go_rings
from planners.route.region import region_of
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from tests.benchmarks.measure import Row, row, seconds
from tests.planners.flow_samples import eddying_flow, place

# Between the points of a path that are looked at [m].
_SPACING = 5.0


def masked_row(count: int) -> Row:
    """Return how many plans crossed land or an area without being called unsafe, and how many have each status."""
    statuses, crossed, took = Counter[str](), 0, [0.0]
    for seed in range(count):
        rng = np.random.default_rng(seed)
        flow = islands(eddying_flow(seed, speed=0.12), rng)
        limits = 0.9 * np.array([flow.grid.east.max(), flow.grid.north.max()])
        begin, end = rng.uniform(-limits, limits, (2, 2))
        beside = [begin if rng.random() < 0.5 else end for _ in range(rng.integers(0, 3))]
        areas = [
            random_area(flow, at + rng.normal(0.0, 2.5e3, 2), rng, f"area {k}")
            for k, at in enumerate(beside)
        ]
        settings = MissionSettings(
            depth=float(rng.choice([80.0, 200.0, 390.0])),
            yos=int(rng.integers(1, 4)),
            surface_time=600.0,
        )
        request = asked(flow, begin, end, settings, *areas)
        try:
            spent, plan = seconds(lambda: plan_mission(flow, request))  # noqa: B023
        except PlanError:
            statuses["refused"] += 1
            continue
        took.append(spent)
        statuses[plan.status] += 1
        crossed += plan.status != "unsafe" and crosses(flow, plan, areas)
    name = f"{count} missions among random islands and areas: none crosses one and does not say so"
    return row(
        name,
        float(np.median(took)),
        "",
        error={"crossed": crossed},
        slowest_s=max(took),
        **statuses,
    )


def bounds(flow: FlowEstimate) -> tuple[Array, Array]:
    """Return the least and the largest local east and north of a flow's grid [m]."""
    low, high = (np.array([f(flow.grid.east), f(flow.grid.north)]) for f in (np.min, np.max))
    return low, high


def asked(
    flow: FlowEstimate, begin: Array, end: Array, settings: MissionSettings, *areas: NoGo
) -> MissionRequest:
    """Return a request of a mission between two local points, past some areas."""
    start, goal = (place(flow, *at, 0.0) for at in (begin, end))
    return MissionRequest(start, (goal,), settings=settings, no_go=areas)


def islands(flow: FlowEstimate, rng: np.random.Generator) -> FlowEstimate:
    """Return a flow with blocks of land, from the surface or from some level down."""
    wet = flow.grid.wet.copy()
    for _ in range(rng.integers(1, 5)):
        j, i = (rng.integers(0, size) for size in wet.shape[1:])
        high, wide = rng.permutation([rng.integers(1, 4), rng.integers(1, 3)])
        wet[rng.integers(0, 3) :, j : j + high, i : i + wide] = False
    keep, grid = np.tile(wet[0].ravel(), 2), replace(flow.grid, wet=wet)
    return replace(
        flow,
        grid=grid,
        horizontal=replace(flow.horizontal, nodes=grid.nodes),
        latent=flow.latent[keep],
        modes=flow.modes[keep],
    )


def crosses(flow: FlowEstimate, plan: MissionPlan, areas: Sequence[NoGo]) -> bool:
    """Return whether a plan's track is anywhere on land, outside of the region or in an area that may not be entered under water."""
    track = _dense(plan.track)
    rings = [
        ring
        for area in areas
        if not area.surface_only
        for ring in no_go_rings(flow.grid.projection, area)
    ]
    return not region_of(flow.grid).allowed(track).all() or any(
        bool(ring.inside(track[:, :2]).any()) for ring in rings
    )


def random_area(flow: FlowEstimate, centre: Array, rng: np.random.Generator, name: str) -> NoGo:
    """Return an area of up to 3 km around a place."""
    bearings, far = (
        np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 7))),
        rng.uniform(300.0, 3000.0),
    )
    corners = [
        place(flow, *(centre + far * np.array([np.sin(at), np.cos(at)])), 0.0) for at in bearings
    ]
    return NoGo(
        tuple((corner.longitude, corner.latitude) for corner in corners),
        name,
        surface_only=bool(rng.random() < 0.3),
    )


def _dense(track: Array) -> Array:
    parts = [track[:1]]
    for begin, end in pairwise(track):
        pieces = max(int(np.ceil(np.linalg.norm(end - begin) / _SPACING)), 1)
        parts.append(begin + np.arange(1, pieces + 1)[:, None] / pieces * (end - begin))
    return np.vstack(parts)
