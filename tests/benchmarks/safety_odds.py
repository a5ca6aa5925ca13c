"""What is stated of uncertain missions and comes of them: plans for a risk, their files and odds, in fresh samples by other code."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from scipy.stats import beta

from planners import MissionPlan, Pilot, mission_odds, plan_scenarios, waypoints_of
from planners.output.waypoints import waypoint_text
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.surfacing import Ellipse
from tests.benchmarks.measure import Row, row
from tests.planners.hazardous import (
    HazardousMission,
    harm_done,
    random_mission,
    remembered_currents,
)
from tests.reference.vehicle import Sea, fly_plan, follow_waypoints, read_csv_waypoints

# RMS speeds of the eddies at the first level [m/s], of which the estimate's errors are three tenths; the risk that is accepted.
_SPEEDS, RISK = (0.03, 0.15), 0.05
# Samples planned in, others that the odds are stated by, and fresh ones flown in; what is added to a mission's number for their seeds.
_SAMPLES, _FRESH = 40, 2
_SEARCH, _JUDGE, _TRUTH, _TOLD = 10_000, 20_000, 30_000, 40_000
# Longest step of the flights [s]: the current changes by a thousandth of its speed over one.
_STEP = 120.0


def uncertain_row(missions: Sequence[Mapping[str, Any]]) -> Row:
    """Return what was stated of some missions planned for a risk of 5 %, beside what came of it in fresh samples."""
    found = [one for one in missions if "stated" in one]
    statuses = Counter(one["status"] for one in missions)

    def mean(name: str) -> float:
        return float(np.mean(np.concatenate([np.ravel(one[name]) for one in found if name in one])))

    crossed = np.concatenate([one["crossed"] for one in found if one["keeps"]] or [np.zeros(0)])
    lists = np.concatenate([one["list_crossed"] for one in found if "list_crossed" in one] or [[]])
    figures = {name: mean(name) for name in ("stated", "arrived", "in_ellipse")}
    if any("in_time" in one for one in found):
        figures["in_time"] = mean("in_time")
    return row(
        f"{len(missions)} missions for a risk of 5 %, each in {_FRESH} fresh samples: crossings, odds, ellipses as stated",
        float(np.median([one["seconds"] for one in missions])),
        "",
        error={
            "crossed_at_most": _at_most(crossed),
            "lists_crossed_at_most": _at_most(lists),
            "stated_off": abs(figures["stated"] - figures["arrived"]),
        },
        flights=crossed.size,
        crossed=float(crossed.sum()),
        list_flights=lists.size,
        lists_crossed=float(lists.sum()),
        **figures,
        **statuses,
    )


def _at_most(crossed: np.ndarray) -> float:
    """Return the upper end of a share by as many flights, one-sided, with a confidence of 95 % (Clopper and Pearson 1934)."""
    hits = float(crossed.sum())
    return float(beta.ppf(0.95, hits + 1.0, crossed.size - hits)) if hits < crossed.size else 1.0


def one_mission(seed: int, lists: bool) -> dict[str, Any]:
    """Return what was stated of a mission, and of its list if wanted, and what came of it in each of some fresh samples."""
    mission, began = random_mission(seed, _SPEEDS), process_time()
    flow, request = mission.flow, mission.request
    searched = flow[0].sample(_SAMPLES, _SEARCH + seed)
    try:
        plan, summary = plan_scenarios(flow, searched, request, allowed=RISK, pilot=Pilot())
    except PlanError:
        return {"status": "refused", "seconds": process_time() - began}
    seconds = process_time() - began
    if plan.status != "reached":
        return {"status": plan.status, "seconds": seconds}
    odds = mission_odds(flow, flow[0].sample(_SAMPLES, _JUDGE + seed), plan, request)
    seas = [_sea(mission, one) for one in flow[0].sample(_FRESH, _TRUTH + seed)]
    known = replace(mission.sea, longest_step=_STEP)
    flown = [fly_plan(sea, plan, known)[0] for sea in seas]
    tracks = [np.array([[*at, depth] for at, depth, _ in path]) for path in flown]
    off = np.array([np.linalg.norm(track[-1, :2] - plan.track[-1, :2]) for track in tracks])
    arrived = off <= plan.settings.tolerance
    told: dict[str, Any] = {
        "status": plan.status,
        "seconds": seconds,
        "stated": odds.corrected.reached,
        "arrived": arrived,
        # as the command plan, which states the share of the samples that were searched
        "keeps": 1.0 - summary.safe <= RISK + 1e-9,
        "crossed": np.array([harm_done(mission, track) is not None for track in tracks]),
        "in_ellipse": [_held(sea, plan, odds.ellipses) for sea in seas],
    }
    if np.isfinite(latest := odds.corrected.arrival_90_percent):
        told["in_time"] = arrived & np.array([path[-1][2] <= latest + 1.0 for path in flown])
    return told | (_of_list(mission, plan, searched, seas, _TOLD + seed) if lists else {})


def _sea(mission: HazardousMission, sample: FlowEstimate) -> Sea:
    """Return a sample of the current: what it differs by from the first estimate persists."""
    off = sample.latent - mission.flow[0].latent
    flows = [replace(flow, latent=flow.latent + off) for flow in mission.flow]
    return Sea(flows, mission.request.start_time_ns, _STEP)


def _held(sea: Sea, plan: MissionPlan, ellipses: np.ndarray) -> list[bool]:
    """Return which surfacings, with the commands held, lie in their ellipses."""
    ends = fly_plan(sea, plan)[1]
    longitude, latitude = to_geographic(sea.flows[0].grid.projection, *np.array(ends).T)
    return [
        Ellipse(*one).holds(float(x), float(y))
        for one, x, y in zip(ellipses.tolist(), longitude, latitude, strict=True)
    ]


def _of_list(
    mission: HazardousMission, plan: MissionPlan, searched: Any, seas: list[Sea], seed: int
) -> dict[str, Any]:
    """Return what gliders cross that head for the waypoints of the CSV, each expecting another current in its first dive."""
    asked = mission.request
    few = waypoints_of(
        mission.flow, plan, no_go=asked.no_go, bathymetry=asked.bathymetry, samples=searched
    )
    if few.violation is not None or few.risk is None or few.risk.violating > RISK + 1e-9:
        return {}
    rows = read_csv_waypoints(waypoint_text(few, Path("few.csv")))
    places = np.array([[one["longitude"], one["latitude"]] for one in rows])
    expected = remembered_currents(mission, plan, len(seas), seed)[-len(seas) :]
    tracks = [
        follow_waypoints(sea, plan, rows, places, current)
        for sea, current in zip(seas, expected, strict=True)
    ]
    return {"list_crossed": np.array([harm_done(mission, track) is not None for track in tracks])}
