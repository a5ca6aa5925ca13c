"""Missions among islands, areas a few metres wide, steps and walls of the bottom: none that is called reached may cross one."""

from collections import Counter
from typing import Any

import numpy as np

from planners import plan_mission, waypoints_of
from replay_kit.core.errors import PlanError
from tests.benchmarks.estimator import row
from tests.benchmarks.measure import seconds
from tests.planners.hazardous import flown_track, harm_done, random_mission


def hazards_row(count: int) -> dict[str, Any]:
    """Return how many plans called reached cross something at steps of a metre, and how many have each status."""
    statuses, harmed, took, unsafe_lists = Counter[str](), Counter[str](), [0.0], 0
    for seed in range(count):
        mission = random_mission(seed)
        try:
            spent, plan = seconds(lambda: plan_mission(mission.flow, mission.request))  # noqa: B023
        except PlanError:
            statuses["refused"] += 1
            continue
        took.append(spent)
        statuses[plan.status] += 1
        if plan.status != "reached":
            continue
        harm = harm_done(mission, flown_track(mission, plan)) or harm_done(mission, plan.track)
        harmed["below_bottom" if harm == "the bottom" else "crossed"] += harm is not None
        few = waypoints_of(mission.flow, plan, no_go=mission.request.no_go, bathymetry=mission.request.bathymetry)
        unsafe_lists += few.violation is not None
    name = f"{count} missions among thin areas, islands and steps of the bottom: none crosses one at steps of a metre"
    errors = {"crossed": harmed["crossed"], "below_bottom": harmed["below_bottom"]}
    return row(name, float(np.median(took)), "", None, None, errors, slowest_s=max(took), lists_withheld=unsafe_lists, **statuses)
