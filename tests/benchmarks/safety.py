"""Missions among islands, areas a few metres wide, steps and walls of the bottom, in currents that change: none may cross anything.

What is called reached is flown again by other code, in short steps, and so is each waypoint file, read back, by gliders that expect one
current or another in their first dive; their tracks are looked at every metre.
"""

import sys
from collections import Counter
from time import process_time
from typing import Any

import numpy as np

from planners import plan_mission, waypoints_of
from replay_kit.core.errors import PlanError
from tests.benchmarks.measure import Row, row
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
        kinds = (
            "crossed",
            "below_bottom",
            "crossed_by_file",
            "below_bottom_by_file",
            "missed_by_file",
        )
        errors = {what: found.pop(what, 0) for what in kinds}
        made.append(
            row(name, float(np.median(took)), "", error=errors, slowest_s=max(took), **found)
        )
    return [*made, reach_row([one_reached(seed) for seed in range(2 if tiny else 2 * count // 3)])]


def one_mission(seed: int, speeds: tuple[float, float]) -> dict[str, Any]:
    """Return what was found of one mission, counted, and the processor time of its plan [s]."""
    mission, found, began = random_mission(seed, speeds), Counter[str](), process_time()
    try:
        plan = plan_mission(mission.flow, mission.request)
    except PlanError:
        return {"found": {"refused": 1}, "seconds": process_time() - began}
    seconds = process_time() - began
    found[plan.status] += 1
    if plan.status == "reached":
        harms = {
            "": {
                harm_done(mission, plan.track),
                harm_done(mission, fly_commands(mission.sea, plan)),
            }
        }
        few, _ = waypoints_of(mission.flow, plan, mission.request)
        called = (
            "withheld" if few.violation is not None else "clear" if few.arrives else "not_reliable"
        )
        found[f"lists_{called}"] += 1
        if called == "clear":
            harms["_by_file"] = harm_of_files(mission, plan, few, _DRAWN)
            found["missed_by_file"] += MISSED in harms["_by_file"]
        for suffix, harm in harms.items():
            for kind, what in (
                ("below_bottom", {"the bottom"}),
                ("crossed", {area.name for area in mission.request.no_go}),
            ):
                found[kind + suffix] += bool(what & harm)
            if harm != {None}:
                print(f"mission {seed}: {harm}", file=sys.stderr)
    return {"found": dict(found), "seconds": seconds}
