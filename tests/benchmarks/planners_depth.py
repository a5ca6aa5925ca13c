"""The depth of the dives as a control: missions in random eddies with a range of depths, over those with one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planners import MissionRequest, MissionSettings, plan_mission
from replay_kit.core.flow.estimate import FlowEstimate
from tests.benchmarks.measure import Row, cpu, row
from tests.planners.flow_samples import eddying_flow, place

LEVELS = (5.0, 50.0, 100.0, 200.0, 350.0, 500.0, 700.0)
_FIXED, _RANGE = 500.0, (100.0, 700.0)
# Depths of which the best serves each mission.
_EACH = (100.0, 150.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0)


def depth_row(count: int, first: int = 100, each: tuple[float, ...] = _EACH) -> Row:
    """Return by how much missions of 20 to 60 km are quicker with a range of depths than at 500 m, with an interval of 90 %.

    None may be slower by more than 1 % than at the best of some depths, the same in all its legs.
    """
    return row_of([one for k in range(first, first + count) if (one := one_mission(k, each))])


def one_mission(seed: int, each: tuple[float, ...] = _EACH) -> tuple[float, float, float] | None:
    """Return by how much a mission is quicker than at 500 m, and slower than at the best fixed depth [%], and the time of a plan [s]."""
    flow, request = random_mission(seed)
    one = plan_mission(flow, request)
    if one.status != "reached":
        return None
    settings = replace(request.settings, depth=_RANGE[1], depths=_RANGE)
    spent, ranging = cpu(lambda: plan_mission(flow, replace(request, settings=settings)))
    fixed = (replace(request.settings, depth=depth) for depth in each if depth != _FIXED)
    plans = [one, *(plan_mission(flow, replace(request, settings=asked)) for asked in fixed)]
    best = min(plan.duration for plan in plans if plan.status == "reached")
    quicker, slower = ranging.duration / one.duration, ranging.duration / best
    return 100.0 * (1.0 - quicker), 100.0 * (slower - 1.0), spent


def row_of(found: Sequence[tuple[float, float, float]]) -> Row:
    """Return the row of some missions."""
    gains, over, took = np.array(found).T
    drawn = np.random.default_rng(0).choice(gains, (4000, len(gains))).mean(axis=1)
    low, high = np.quantile(drawn, [0.05, 0.95])
    return row(
        f"depth of dives within 100 to 700 m, {len(gains)} missions that 500 m serves: 5 % quicker",
        float(np.median(took)),
        "",
        error={
            "slower_percent": max(0.0, float(-gains.min())),
            "over_best_fixed_percent": max(0.0, float(over.max())),
        },
        gain_percent=float(gains.mean()),
        gain_from=float(low),
        gain_to=float(high),
        over_best_fixed_mean=float(over.mean()),
    )


def random_mission(seed: int) -> tuple[FlowEstimate, MissionRequest]:
    """Return eddies of 0.1 to 0.3 m/s at the surface and a mission of 20 to 60 km in them."""
    rng = np.random.default_rng(seed)
    flow = eddying_flow(seed, speed=float(rng.uniform(0.1, 0.3)), levels=LEVELS)
    limits = 0.8 * np.array([flow.grid.east.max(), flow.grid.north.max()])
    while True:
        begin, end = rng.uniform(-limits, limits, (2, 2))
        if 2e4 < np.linalg.norm(end - begin) < 6e4:
            break
    settings = MissionSettings(depth=_FIXED, surface_time=600.0)
    return flow, MissionRequest(place(flow, *begin), (place(flow, *end),), settings=settings)
