"""Plans of ten dives to goals that a random flight of ten dives has met, and again from the plan as a warm start.

The flow is a member of the quasi-geostrophic set where the shared data are there, else random eddies.
"""

from dataclasses import replace

import numpy as np

from planners import Glider, MissionRequest, MissionSettings, plan_mission
from planners.simulation.currents import currents_of
from planners.simulation.fly import Legs, fly
from replay_kit.core.flow.estimate import FlowEstimate
from tests.benchmarks.islands import members_flow
from tests.benchmarks.measure import Row, cpu, row
from tests.planners.flow_samples import eddying_flow, place

_MEMBER, _DIVES = 5, 10
_VEHICLE = Glider()


def rows(tiny: bool) -> list[Row]:
    """Return the processor time of plans, and by what share the slowest plan is later than the flight."""
    count = 1 if tiny else 6
    flow = members_flow(_MEMBER, tiny) or eddying_flow(1 if tiny else _MEMBER, speed=0.25)
    drawn = [_case(flow, np.random.default_rng(seed)) for seed in range(count)]
    plans = [cpu(lambda: plan_mission(flow, asked)) for asked, _ in drawn]  # noqa: B023
    warm = [
        cpu(lambda: plan_mission(flow, asked, warm=plan))[0]  # noqa: B023
        for (asked, _), (_, plan) in zip(drawn, plans, strict=True)
    ]
    late = [plan.duration / lasts - 1.0 for (_, plan), (_, lasts) in zip(plans, drawn, strict=True)]
    missed = sum(plan.status != "reached" for _, plan in plans)
    took, name = [one for one, _ in plans], f"plan of {_DIVES} dives, {count} goals"
    error = {"late_share": max(late), "unreached": float(missed)}
    more = {"cold_asked_s": 0.5, "warm_median_s": float(np.median(warm)), "warm_asked_s": 0.1}
    return [row(name, float(np.median(took)), error=error, slowest_s=max(took), **more)]


def _case(flow: FlowEstimate, rng: np.random.Generator) -> tuple[MissionRequest, float]:
    """Return a mission whose goal ten dives of random headings and angles meet, and when they do [s]."""
    deepest = min(500.0, 0.95 * float(flow.levels[-1]))
    half = 0.5 * np.array([flow.grid.east.max(), flow.grid.north.max()])
    turns = np.tile([[0.0], [deepest], [0.0]], _DIVES)
    while True:
        start = rng.uniform(-half, half)
        headings = rng.uniform(0.0, 2.0 * np.pi) + rng.normal(0.0, 0.3, _DIVES)
        angles = np.deg2rad(rng.uniform(16.0, 25.0, _DIVES))
        legs = Legs(headings, angles, turns, np.zeros(_DIVES))
        flight = fly(currents_of(flow), _VEHICLE, (start, 0.0), legs)
        end = flight.place[0, -1]
        if np.all(np.abs(end) < 2.0 * half):
            break
    ends = place(flow, *start), place(flow, *end)
    settings = replace(MissionSettings(), depth=deepest)
    request = MissionRequest(ends[0], (ends[1],), _VEHICLE, settings)
    return request, float(flight.time[0, -1])
