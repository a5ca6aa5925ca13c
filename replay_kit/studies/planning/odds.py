"""How true the odds of missions are: plans called reached, flown in fresh samples of the estimate and in withheld truths."""

from dataclasses import dataclass, replace

import numpy as np

import planners
from replay_kit.config.plan import ACCEPTED_RISK, ARRIVING
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.horizontal import NodeKernel
from replay_kit.studies.planning.job import StudyReport
from replay_kit.studies.planning.world import Withheld, World, draw_missions
from replay_kit.studies.reports.tables import NAN, Cell, Criterion, Table, named_columns
from replay_kit.studies.twins.reachable import Pair
from replay_kit.workflows.planning.adapters import JUDGING

NAME = "odds"
# Shares that arrive, least asked for: in fresh samples, in withheld truths.
_FRESH, _TRUTH = 0.87, 0.8
# Drift at each surfacing [s].
_SURFACE_TIME = 600.0
# Added to the seed of the samples that a plan is judged by.
_OTHER_SEED = 1_000_003
_TITLE = (
    "Missions with headings corrected at each surfacing: share that arrives within the tolerance"
)


@dataclass(frozen=True, slots=True)
class _Judged:
    """A mission: its status, the share of the samples that arrives, that of fresh ones, and its miss in the truth [m]."""

    member: int
    status: str
    stated: float
    fresh: float
    miss: float
    tolerance: float

    @property
    def cells(self) -> dict[str, Cell]:
        return {
            "truth": self.member,
            "status": self.status,
            "arrive in the samples": self.stated,
            "arrive in fresh samples": self.fresh,
            "miss in the truth [m]": self.miss,
        }


def odds(world: World) -> StudyReport:
    """Return how many of the missions reported as reached arrive in fresh samples of the estimate, and in the truth."""
    made = world.each_truth(_of_truth, world.job.pairs)
    return _report(world, [one for of_truth in made for one in of_truth])


def _of_truth(world: World, count: int) -> list[_Judged]:
    """Return the missions of the one truth of a world."""
    (withheld,), job = world.truths, world.job
    flow = withheld.estimate()
    # a planner knows only the estimate, so its goals are drawn as reachable there
    pairs = draw_missions(withheld, flow.mean_flow(), count, world.depth, job.legs, job.seed)
    samples = flow.sample(JUDGING, job.seed), flow.sample(job.fresh, job.seed + _OTHER_SEED)
    made = []
    for pair in pairs:
        world.advance(f"odds, truth {withheld.member}")
        made.append(_judged(world, withheld, (flow, *samples), pair))
    return made


def _judged(
    world: World,
    withheld: Withheld,
    known: tuple[FlowEstimate, tuple[FlowEstimate, ...], tuple[FlowEstimate, ...]],
    pair: Pair,
) -> _Judged:
    """Return a mission planned and judged on (estimate, samples, fresh samples), flown in fresh ones and the truth where it is reached."""
    flow, judging, fresh = known
    settings = planners.MissionSettings(depth=world.depth, surface_time=_SURFACE_TIME)
    request = planners.MissionRequest(pair.start, (pair.target,), world.glider, settings)
    plan = planners.plan_mission(flow, request)
    if len(plan.headings_deg) == 0:
        return _Judged(withheld.member, plan.status, NAN, NAN, NAN, settings.tolerance)
    judged = planners.with_odds(
        plan, stated := planners.mission_odds(flow, judging, plan, request), ARRIVING, ACCEPTED_RISK
    )
    share, miss = NAN, NAN
    if judged.status == "reached":
        share = planners.mission_odds(flow, fresh, plan, request).corrected.reached
        miss = planners.fly_scenarios(
            flow, (as_sample(flow, withheld.truth),), plan, pilot=planners.Pilot()
        ).miss_median
    return _Judged(
        withheld.member, judged.status, stated.corrected.reached, share, miss, settings.tolerance
    )


def as_sample(flow: FlowEstimate, truth: FlowEstimate) -> FlowEstimate:
    """Return a truth as a sample of an estimate on the same nodes, whose kernel differs from the truth's in its speed alone."""
    # latent velocities have the kernel's variance, the coefficients of a lattice are those of the stream function itself
    scale = (
        truth.horizontal.kernel.speed / flow.horizontal.kernel.speed
        if isinstance(truth.horizontal, NodeKernel)
        else 1.0
    )
    return replace(flow.mean_flow(), latent=truth.latent * scale**2)


def _report(world: World, made: list[_Judged]) -> StudyReport:
    reached = [one for one in made if one.status == "reached"]
    tables: tuple[Table, ...] = (named_columns(NAME, _TITLE, [one.cells for one in made]),)
    if not reached:
        words = f"None of {len(made)} missions is reported as reached: in none do {ARRIVING:.0%} of {JUDGING} samples arrive."
        return StudyReport(NAME, "Odds of missions", tables, (), (words,))
    fresh, arrived = (
        np.array([one.fresh for one in reached]),
        np.array([one.miss <= one.tolerance for one in reached]),
    )
    criteria = (
        Criterion(
            "share of fresh samples that arrives, mean over the plans reported as reached",
            float(fresh.mean()),
            at_least=_FRESH,
        ),
        Criterion(
            "share of the plans reported as reached that arrives in the withheld truth",
            float(arrived.mean()),
            at_least=_TRUTH,
        ),
    )
    stated = float(np.mean([one.stated for one in reached]))
    findings = (
        f"{len(reached)} of {len(made)} missions are reported as reached, as {ARRIVING:.0%} or more of {JUDGING} samples arrive "
        f"({stated:.1%} in the mean). In {world.job.fresh} fresh samples {fresh.mean():.1%} arrive in the mean and {fresh.min():.1%} in "
        f"the worst plan; {float(np.mean(fresh >= _FRESH)):.0%} of the plans have {_FRESH:.0%} or more. In the truth {int(arrived.sum())} "
        f"of {len(reached)} arrive; the median miss there is {float(np.median([one.miss for one in reached])):.0f} m."
    )
    return StudyReport(NAME, "Odds of missions", tables, criteria, (findings,))
