"""How true the odds of plans are: missions reported as reached, flown in fresh samples of the estimate and in withheld truths."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import planners
from replay_kit.config.plan import ACCEPTED_RISK, ARRIVING
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import NodeKernel
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.progress import Progress, silent
from replay_kit.estimator import embed_member
from replay_kit.studies.bench.frame import Figure, Lost, of_case
from replay_kit.studies.jobs import Advance, build_method, check_positive, each_counted
from replay_kit.studies.reports.tables import NAN
from replay_kit.studies.twins.adcp import random_observations
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.truths import (
    SPEED,
    Case,
    Pair,
    draw_reachable,
    fly_dives,
    leave_out,
    members_named,
)
from replay_kit.studies.twins.vehicle import random_places
from replay_kit.workflows.planning.adapters import JUDGING

TASK = "plans"
_METHOD = "default"
# Shares that arrive, least asked for: of fresh samples, in withheld truths.
_FRESH, _TRUTH = 0.87, 0.8
# Miss distance that counts as arrival [m].
_TOLERANCE = planners.MissionSettings().tolerance
# Members that are the truth in turn when none are named.
_TRUTHS = 20
# Least and greatest glide angle of a mission, and of the flights that goals are drawn with, so that some of its range is left [degrees].
_ANGLES, _DRAWN_ANGLES = (15.0, 35.0), (16.0, 25.0)
# Standard deviation of the headings of such a flight about a common one [rad].
_SCATTER = 0.3
# Drift at each surfacing [s].
_SURFACE_TIME = 600.0
# Added to the seed of the samples that a plan is judged by.
_OTHER_SEED = 1_000_003


@dataclass(frozen=True, slots=True)
class PlanJob:
    """Which truths, and how many missions of what size.

    Attributes:
        leave_out: Positions of members from 0, with commas between them, or ``all``: each is the truth in turn; None for at most
            twenty, evenly spread.
        plans: Missions, spread over the truths.
        pings: Given to each estimate.
        noise: Standard deviation of each component of each bin [m/s].
        legs: Of each mission that goals are drawn with.
        depth: Of a mission's dives, at most [m].
        fresh: Samples that a plan reported as reached is flown in, beside those that judged it.
        seed: Of all random draws.
    """

    leave_out: str | None = None
    plans: int = 100
    pings: int = 450
    noise: float = 0.09
    legs: int = 10
    depth: float = 500.0
    fresh: int = 500
    seed: int = 0

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        counts = ("plans", "pings", "legs", "fresh", "noise")
        check_positive(**{name: getattr(self, name) for name in counts})

    def cases(self, ensemble: Ensemble, truth: Ensemble | None) -> list[Case]:
        """Return the truths with the members that do not know them.

        Args:
            ensemble: All members.
            truth: An ensemble of one; None to leave members out.

        Raises:
            ConfigError: A member does not exist, too few are left, or members are to be left out beside a truth.
        """
        if truth is not None:
            if self.leave_out is not None:
                raise ConfigError("bench plans: expected one of --truth and --leave-out")
            return [Case(None, truth, ensemble)]
        n_members = ensemble.n_members
        if self.leave_out is not None:
            members = members_named(self.leave_out, n_members)
        else:
            count = min(_TRUTHS, n_members, self.plans)
            members = tuple(int(k) for k in (np.arange(count) + 0.5) * n_members / count)
        return [leave_out(ensemble, member) for member in members]


@dataclass(frozen=True, slots=True)
class JudgedMission:
    """A mission.

    Attributes:
        is_reached: Whether its plan is reported as reached.
        fresh: Share of fresh samples that arrives; NaN unless it is.
        miss: Its miss distance in the truth [m]; NaN likewise.
    """

    is_reached: bool
    fresh: float = NAN
    miss: float = NAN


def run_plans(
    ensemble: Ensemble,
    truth: Ensemble | None,
    config: EstimatorConfig,
    job: PlanJob,
    progress: Progress = silent,
) -> Iterator[list[Figure | Lost]]:
    """Yield how many missions are reported as reached, and how many of these arrive; its cases are the truths.

    Args:
        ensemble: All members.
        truth: An ensemble of one; None to leave members out.
        config: Everything but the preset.
        job: The options.
        progress: Called with missions done, missions in all, and what is being run.

    Raises:
        ConfigError: An option is wrong.
        ForecastError: Hardly any mission stays in the truth's water.
    """
    job.check()
    cases, advance = job.cases(ensemble, truth), Advance(job.plans, progress)
    shares = [len(part) for part in np.array_split(np.arange(job.plans), len(cases))]
    calls = (
        (case, share, config, job, advance)
        for case, share in zip(cases, shares, strict=True)
        if share
    )
    for (case, *_), made in each_counted(_of_truth, calls, advance, lambda _, share, *__: share):
        yield [*of_case(figures_of(made), TASK, case.truth.source)]


def figures_of(missions: Sequence[JudgedMission]) -> list[Figure]:
    """Return the figures of one truth's missions: of those reported as reached, shares that arrive and the miss in the truth."""
    reached = [one for one in missions if one.is_reached]
    figures = [Figure(_METHOD, "reported as reached", len(reached), len(missions))]
    if not reached:
        return figures
    fresh, miss = np.array([(one.fresh, one.miss) for one in reached]).T
    arrived = float(np.sum(miss <= _TOLERANCE))
    return [
        *figures,
        Figure(_METHOD, "arrive in fresh samples", float(fresh.sum()), fresh.size, _FRESH),
        Figure(_METHOD, "arrive in the truth", arrived, miss.size, _TRUTH),
        Figure(_METHOD, "miss in the truth [m]", float(miss.sum()), miss.size),
    ]


def _of_truth(
    case: Case, count: int, config: EstimatorConfig, job: PlanJob, advance: Advance
) -> list[JudgedMission]:
    """Return missions planned on an estimate of one truth, and judged."""
    member = case.ensemble.n_members if case.member is None else case.member
    field, truth = build_field(case.truth), embed_member(case.truth, 0, config)
    depth = min(job.depth, float(case.ensemble.grid.levels[-1]))
    flow = _estimate(case, field, config, job)
    # a planner knows only the estimate, so its goals are drawn as reachable there; the seed is neither the pings' nor the samples'
    rng = np.random.default_rng((job.seed, 2, member))
    grids = flow.grid, case.ensemble.grid
    pairs = draw_missions(field, flow.mean_flow(), grids, (count, job.legs, depth), rng)
    samples = flow.sample(JUDGING, job.seed), flow.sample(job.fresh, job.seed + _OTHER_SEED)
    made = []
    for pair in pairs:
        advance(f"{TASK}, {case.truth.source}")
        made.append(_judged((flow, *samples), as_sample(flow, truth), pair, depth))
    return made


def _estimate(case: Case, field: Field, config: EstimatorConfig, job: PlanJob) -> FlowEstimate:
    """Return the estimate after profiles at random places."""
    config = config.model_copy(update={"preset": "default"})
    estimator = build_method("default", case.ensemble, config)
    state = estimator.initial()
    for after, _ in estimator.steps(
        state, random_observations(field, job.pings, job.noise, job.seed)
    ):
        state = after
    return estimator.flow(state)


def _judged(
    known: tuple[FlowEstimate, Sequence[FlowEstimate], Sequence[FlowEstimate]],
    truth: FlowEstimate,
    pair: Pair,
    depth: float,
) -> JudgedMission:
    """Return a mission planned and judged on (estimate, samples, fresh samples), flown in fresh ones and the truth where it is reached."""
    flow, judging, fresh = known
    settings = planners.MissionSettings(depth=depth, surface_time=_SURFACE_TIME)
    glider = planners.Glider(SPEED, None, *_ANGLES)
    request = planners.MissionRequest(pair.start, (pair.target,), glider, settings)
    plan = planners.plan_mission(flow, request)
    if len(plan.headings_deg) == 0:
        return JudgedMission(False)
    stated = planners.mission_odds(flow, judging, plan, request)
    if planners.with_odds(plan, stated, ARRIVING, ACCEPTED_RISK).status != "reached":
        return JudgedMission(False)
    share = planners.mission_odds(flow, fresh, plan, request).corrected.reached
    flown = planners.fly_scenarios(flow, (truth,), plan, pilot=planners.Pilot())
    return JudgedMission(True, share, flown.miss_median)


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
        headings = rng.uniform(0.0, 2.0 * np.pi, (count, 1)) + _SCATTER * rng.standard_normal(
            (count, legs)
        )
        return fly_dives(
            flow, start, headings, np.deg2rad(rng.uniform(*_DRAWN_ANGLES, (count, legs))), depth
        )

    return draw_reachable(
        fly, grids, count, f"missions of {legs} dives to {depth:g} m", 0.0, water_depth=depth
    )
