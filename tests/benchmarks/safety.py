"""Missions among islands, areas a few metres wide, steps and walls of the bottom, in currents that change: none may cross anything.

What is called reached is flown again by other code, in short steps, and so is each waypoint file, read back; their tracks are looked at
every metre.
"""

import sys
from collections import Counter
from time import process_time
from typing import Any

import numpy as np

from planners import plan_mission, waypoints_of
from replay_kit.core.errors import PlanError
from tests.benchmarks.estimator import row
from tests.planners.hazardous import harm_done, harm_of_files, random_mission
from tests.reference.vehicle import fly_commands


def rows(tiny: bool, count: int = 300) -> list[dict[str, Any]]:
    """Return how many plans called reached, and how many waypoint files, lead through something; and how many have each status."""
    outcomes = [one_mission(seed) for seed in range(2 if tiny else count)]
    found = sum((Counter(outcome["found"]) for outcome in outcomes), Counter[str]())
    took = [outcome["seconds"] for outcome in outcomes]
    name = f"{len(outcomes)} missions among thin areas, islands, steps of the bottom, in changing currents: 0 asked to cross one"
    errors = {
        what: found.pop(what, 0)
        for what in ("crossed", "below_bottom", "crossed_by_file", "below_bottom_by_file")
    }
    return [
        row(
            name,
            float(np.median(took)),
            "",
            None,
            None,
            errors,
            slowest_s=max(took),
            peak_mb=None,
            **found,
        )
    ]


def one_mission(seed: int) -> dict[str, Any]:
    """Return what was found of one mission, counted, and the processor time of its plan [s]."""
    mission, found, began = random_mission(seed), Counter[str](), process_time()
    try:
        plan = plan_mission(mission.flow, mission.request)
    except PlanError:
        return {"found": {"refused": 1}, "seconds": process_time() - began}
    seconds = process_time() - began
    found[plan.status] += 1
    if plan.status == "reached":
        harms = {
            "": {
                "track": harm_done(mission, plan.track),
                "commands": harm_done(mission, fly_commands(mission.sea, plan)),
            }
        }
        few = waypoints_of(
            mission.flow, plan, no_go=mission.request.no_go, bathymetry=mission.request.bathymetry
        )
        found["lists_written" if few.violation is None else "lists_withheld"] += 1
        if few.violation is None:
            harms["_by_file"] = harm_of_files(mission, plan, few)
        for suffix, harm in harms.items():
            for kind, what in (
                ("below_bottom", {"the bottom"}),
                ("crossed", {area.name for area in mission.request.no_go}),
            ):
                found[kind + suffix] += bool(what & set(harm.values()))
            if any(harm.values()):
                print(f"mission {seed}: {harm}", file=sys.stderr)
    return {"found": dict(found), "seconds": seconds}
