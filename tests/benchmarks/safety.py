"""Missions among islands, areas a few metres wide, steps and walls of the bottom, in currents that change: none may cross anything.

What is called reached is flown again by other code, in short steps, and so is each waypoint file, read back, by gliders that expect one
current or another in their first dive; their tracks are looked at every metre.
"""

import sys
from collections import Counter
from contextlib import suppress
from typing import Any

import numpy as np

from planners import MissionPlan, plan_mission, waypoints_of
from replay_kit.core.errors import PlanError
from tests.benchmarks.measure import Row, cpu, row
from tests.benchmarks.safety_reach import one_mission as one_reached
from tests.benchmarks.safety_reach import reach_row
from tests.planners.hazardous import MISSED, harm_done, harm_of_files, random_mission
from tests.reference.vehicle import fly_commands

# RMS speeds of the eddies at the first level [m/s]: in most missions, and where a first dive ends kilometres off what it is steered for.
_MODERATE, _STRONG = (0.03, 0.15), (0.15, 0.35)
# Samples of the estimate, of which the glider expects the first dive's current.
_DRAWN = 6


def rows(tiny: bool, count: int = 300) -> list[Row]:
    """Return how many plans called reached, and how many files, lead through something; what is stated and what comes of it."""
    made = []
    for speeds, missions in ((_MODERATE, count), (_STRONG, count // 3)):
        outcomes = [one_mission(seed, speeds) for seed in range(1 if tiny else missions)]
        found = sum((Counter(outcome["found"]) for outcome in outcomes), Counter[str]())
        took = [outcome["seconds"] for outcome in outcomes]
        eddies = "eddies of {:g} to {:g} m/s".format(*speeds)
        name = f"{len(outcomes)} missions among thin areas, islands, steps of the bottom, in changing {eddies}: 0 asked to cross one"
        kinds = "crossed below_bottom crossed_by_file below_bottom_by_file missed_by_file"
        errors, most = {what: found.pop(what, 0) for what in kinds.split()}, max(took)
        made.append(row(name, float(np.median(took)), "", error=errors, slowest_s=most, **found))
    return [*made, reach_row([one_reached(seed) for seed in range(2 if tiny else 2 * count // 3)])]


def one_mission(seed: int, speeds: tuple[float, float]) -> dict[str, Any]:
    """Return what was found of one mission, counted, and the processor time of its plan [s]."""
    mission, found = random_mission(seed, speeds), Counter[str]()

    def planned() -> MissionPlan | None:
        with suppress(PlanError):
            return plan_mission(mission.flow, mission.request)
        return None

    seconds, plan = cpu(planned)
    found["refused" if plan is None else plan.status] += 1
    if plan is not None and plan.status == "reached":
        flown = plan.track, fly_commands(mission.sea, plan)
        harms = {"": {harm_done(mission, track) for track in flown}}
        few, _ = waypoints_of(mission.flow, plan, mission.request)
        reliable = "clear" if few.arrives else "not_reliable"
        called = reliable if few.violation is None else "withheld"
        found[f"lists_{called}"] += 1
        if called == "clear":
            harms["_by_file"] = harm_of_files(mission, plan, few, _DRAWN)
            found["missed_by_file"] += MISSED in harms["_by_file"]
        areas = {area.name for area in mission.request.no_go}
        for suffix, harm in harms.items():
            found[f"below_bottom{suffix}"] += "the bottom" in harm
            found[f"crossed{suffix}"] += bool(areas & harm)
            if harm != {None}:
                print(f"mission {seed}: {harm}", file=sys.stderr)
    return {"found": dict(found), "seconds": seconds}
