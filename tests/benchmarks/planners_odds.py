"""Missions planned for the odds beside the quickest ones: in fresh samples of the estimate, and in withheld truths."""

from dataclasses import dataclass, replace

import numpy as np

from planners import (
    Glider,
    MissionPlan,
    MissionRequest,
    MissionSettings,
    Pilot,
    fly_scenarios,
    mission_odds,
    plan_for_odds,
    plan_mission,
)
from planners.simulation.currents import Sample
from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import NodeKernel
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator import build, embed_member
from replay_kit.forecast import read_ensemble
from replay_kit.studies.twins.adcp import random_observations
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.truths import SPEED, Pair, draw_reachable, fly_steadily, leave_out
from replay_kit.studies.twins.vehicle import random_places
from tests.benchmarks.measure import Row, cpu, row, seconds
from tests.places import DATA, SAMPLES

#: Profiles given to the estimates of uncertain missions, and of easy ones; samples searched, and fresh ones.
UNCERTAIN, EASY = 10, 150
_SEARCHED, _JUDGING, _FRESH = 40, 40, 100
# Standard deviations of a mean to the ends of its interval of 90 %.
_NINETY = 1.645


@dataclass(frozen=True, slots=True)
class Paired:
    """One mission both ways, the quickest first: shares of fresh samples, whether it arrives in the truth; the share stated; what it takes.

    ``odds_over_plan`` is the processor time of the odds of the quickest, with drawing their samples, over that of planning it.
    """

    fresh: tuple[float, float]
    truth: tuple[float, float]
    stated: float
    oracle: float
    safe: float
    costs_h: float
    took: float
    odds_over_plan: float


def odds_row(pings: int, truths: int, missions: int, fresh: int = _FRESH, legs: int = 10) -> Row:
    """Return the row of some missions of some legs in estimates of some truths that have met so many profiles."""
    qg, config = DATA / "qg" / "climatology.nc", RunConfig()
    whole = qg.exists() and truths > 1
    ensemble = read_ensemble(qg if whole else SAMPLES / "ensemble.nc", config.forecast)
    found = list[Paired]()
    members = [int((k + 0.5) * ensemble.n_members / truths) for k in range(truths)]
    for case in (leave_out(ensemble, member) for member in members):
        field, truth = build_field(case.truth), embed_member(case.truth, 0, config.estimator)
        flow, depth = _estimate(case.ensemble, field, pings), 500.0
        grids, rng = (flow.grid, case.ensemble.grid), np.random.default_rng((0, case.member or 0))
        for pair in draw_missions(field, flow.mean_flow(), grids, (missions, legs, depth), rng):
            request = MissionRequest(
                pair.start,
                (pair.target,),
                Glider(0.3, None, 15.0, 35.0),
                MissionSettings(depth=depth, surface_time=600.0),
            )
            if one := _paired(flow, as_sample(flow, truth), request, fresh):
                found.append(one)
    return _row(pings, found)


def _estimate(ensemble: Ensemble, field: Field, pings: int) -> FlowEstimate:
    """Return the estimate after profiles at random places."""
    estimator = build([ensemble], EstimatorConfig(), GatingConfig())
    profiles = random_observations(field, pings, 0.09, 0)
    state, _ = estimator.assimilate(estimator.initial(), profiles)
    return estimator.flow(state)


def as_sample(flow: FlowEstimate, truth: FlowEstimate) -> FlowEstimate:
    """Return a truth as a sample of an estimate on the same nodes, whose kernel differs from the truth's in its speed alone."""
    # latent velocities have the kernel's variance, the coefficients of a lattice are those of the stream function itself
    scale = (
        truth.horizontal.kernel.speed / flow.horizontal.kernel.speed
        if isinstance(truth.horizontal, NodeKernel)
        else 1.0
    )
    return replace(flow.mean_flow(), latent=truth.latent * scale**2)


def draw_missions(
    field: Field,
    flow: FlowEstimate,
    grids: tuple[Grid, ...],
    size: tuple[int, int, float],
    rng: np.random.Generator,
) -> tuple[Pair, ...]:
    """Return starts and goals at the surface, each goal the end of a mission of random headings flown in a current.

    Args:
        field: The truth, for places at its wet surface.
        flow: The current that the missions are flown in.
        grids: The missions keep to water that is as deep as their dives in all of these, the current's first.
        size: Number of missions, dives of each, and their depth [m].
        rng: Draws starts, headings and glide angles.

    Raises:
        ForecastError: Hardly any mission stays in the water.
    """
    count, legs, depth = size

    def fly() -> Array:
        start = random_places(field, count, rng)
        headings = rng.uniform(0.0, 2.0 * np.pi, (count, 1)) + 0.3 * rng.standard_normal(
            (count, legs)
        )
        return fly_dives(
            flow, start, headings, np.deg2rad(rng.uniform(16.0, 25.0, (count, legs))), depth
        )

    return draw_reachable(
        fly, grids, count, f"missions of {legs} dives to {depth:g} m", 0.0, water_depth=depth
    )


def fly_dives(
    flow: FlowEstimate, start: Array, headings: Array, angles: Array, depth: float, steps: int = 20
) -> Array:
    """Return the paths of missions of one dive a leg in a current, shape (2 L steps + 1, n, 3) [m]: all at once, constant speed.

    Args:
        flow: The current.
        start: shape (n, 2) [m], local east and north, at the surface.
        headings: shape (n, L), clockwise from local north [rad].
        angles: shape (n, L), below the horizontal in dives, above it in climbs [rad].
        depth: Of the dives [m].
        steps: For each dive and each climb.
    """
    path = np.column_stack([start, np.zeros(len(start))])[None]
    for heading, angle in zip(headings.T, angles.T, strict=True):
        along, down = SPEED * np.cos(angle), SPEED * np.sin(angle)
        for vertical in (down, -down):
            through_water = np.column_stack(
                [along * np.sin(heading), along * np.cos(heading), vertical]
            )
            path = np.concatenate(
                [path, fly_steadily(flow, path[-1], through_water, depth / down, steps)[1:]]
            )
    return path


def _paired(
    flow: FlowEstimate, truth: FlowEstimate, request: MissionRequest, count: int
) -> Paired | None:
    """Return a mission both ways; None where the goal is out of reach in the estimate."""
    planning, quickest = cpu(lambda: plan_mission(flow, request))
    if quickest.status != "reached" or not len(quickest.headings_deg):
        return None
    took, chosen = seconds(lambda: plan_for_odds(flow, flow.sample(_SEARCHED, 3), request))
    odds, _ = cpu(lambda: mission_odds(flow, flow.sample(_JUDGING, 4), quickest, request))
    fresh = flow.sample(count, 1_000_003)

    def shares(samples: list[Sample]) -> tuple[float, float]:
        first, second = (
            fly_scenarios(flow, samples, one, pilot=Pilot()).reached for one in (quickest, chosen)
        )
        return first, second

    stated = mission_odds(flow, flow.sample(_JUDGING, 5), chosen, request).corrected
    return Paired(
        shares(list(fresh)),
        shares([truth]),
        stated.reached,
        float(_knowing(truth, chosen, request)),
        stated.safe,
        float(chosen.statistics["odds_costs_h"]),
        took,
        odds / planning,
    )


def _knowing(truth: FlowEstimate, plan: MissionPlan, request: MissionRequest) -> bool:
    """Return whether a planner who knows the truth arrives in the time of a plan, in which a pilot may be late."""
    settings = replace(request.settings, max_duration=plan.duration)
    return plan_mission(truth, replace(request, settings=settings)).status == "reached"


def _row(pings: int, found: list[Paired]) -> Row:
    def interval(gains: np.ndarray) -> dict[str, float]:
        half = _NINETY * float(gains.std(ddof=1)) / gains.size**0.5 if gains.size > 1 else 0.0
        return {"mean": float(gains.mean()), "half_of_90": half, "least": float(gains.min())}

    fresh, truth = (np.array([getattr(one, name) for one in found]) for name in ("fresh", "truth"))
    off = np.array([one.stated for one in found]) - fresh[:, 1]
    more = {
        **{f"fresh_gain_{name}": value for name, value in interval(fresh @ [-1.0, 1.0]).items()},
        **{f"truth_gain_{name}": value for name, value in interval(truth @ [-1.0, 1.0]).items()},
        "quickest_fresh": float(fresh[:, 0].mean()),
        "odds_fresh": float(fresh[:, 1].mean()),
        "quickest_in_truth": float(truth[:, 0].mean()),
        "odds_in_truth": float(truth[:, 1].mean()),
        "oracle_in_truth": float(np.mean([one.oracle for one in found])),
        "stated_minus_fresh": float(off.mean()),
        "costs_h": float(np.mean([one.costs_h for one in found])),
        "odds_over_plan": float(np.median([one.odds_over_plan for one in found])),
    }
    return row(
        f"{len(found)} missions for the odds after {pings} profiles: share that arrives, beside the quickest",
        float(np.median([one.took for one in found])),
        "the quickest mission",
        error={"stated_off": float(abs(off.mean()))},
        **more,
    )


def rows(tiny: bool) -> list[Row]:
    """Return the rows of uncertain missions and of easy ones."""
    if tiny:
        return [odds_row(UNCERTAIN, 1, 1, 20, 4)]
    return [odds_row(pings, 10, 4) for pings in (UNCERTAIN, EASY)]
