"""The study of replanning: twin missions replanned at each surfacing, compared with the single plan made at the start."""

import math
from functools import partial

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.studies.planning.pictures import draw_replanned
from replay_kit.studies.planning.replan_rows import NEAR, ReplanJob, ReplanRow, ReplanSummary, summarise
from replay_kit.studies.planning.result import StudyReport
from replay_kit.studies.planning.twin_missions import run_replanning
from replay_kit.studies.planning.world import World
from replay_kit.studies.reports.tables import Criterion, Picture, named_columns
from replay_kit.workflows.planning import MissionPlanner

NAME = "replanning"
_MEDIAN, _NINETY = 0.3, 0.7
_TITLE = "Twin missions: a single plan made without a measurement, and replanned with those of each leg"


def replanning(world: World) -> StudyReport:
    """Return the outcome of missions that are replanned at each surfacing, beside the single plan.

    Raises:
        ConfigError: The truth is no member of the ensemble.
    """
    members = tuple(withheld.case.member for withheld in world.truths if withheld.case.member is not None)
    if len(members) < len(world.truths):
        raise ConfigError("--truth: the study replanning leaves members out in turn; leave it out of --study")
    job = ReplanJob(
        missions=world.job.replans,
        legs=world.job.legs,
        most_legs=math.ceil(1.5 * world.job.legs),
        depth=world.depth,
        noise=world.job.noise,
        seed=world.job.seed,
        members=members,
    )
    config, planner = RunConfig(estimator=world.truths[0].config), MissionPlanner.of(PlannerConfig(kind="mission", depth=world.depth))
    rows = run_replanning((world.ensemble,), config, job, planner, lambda done, total, what: world.advance(f"replanning, {what}"))
    summary = summarise(rows)
    picture = Picture(
        "replanning_misses",
        f"Each mission's miss distance with a single plan and replanned; dashed: {NEAR:g} m",
        (5.5, 5.0),
        partial(draw_replanned, rows),
    )
    table = named_columns(NAME, _TITLE, [_cells(row) for row in rows])
    criteria = (
        Criterion("miss distance over that of the single plan, median over the missions", summary.ratio_median, at_most=_MEDIAN),
        Criterion("the same, nine of ten missions at most", summary.ratio_90, at_most=_NINETY),
    )
    title = "Missions replanned at each surfacing"
    return StudyReport(NAME, title, (table,), criteria, (_findings(summary, job),), (picture,))


def _cells(row: ReplanRow) -> dict[str, str | float]:
    return {
        "truth": row.member,
        "to the goal [km]": row.distance / 1e3,
        "single plan: miss [m]": row.single.miss,
        "replanned: miss [m]": row.replanned.miss,
        "ratio": row.ratio,
        "legs of the single plan": row.single.legs,
        "legs replanned": row.replanned.legs,
        "ended": row.replanned.ended,
    }


def _findings(summary: ReplanSummary, job: ReplanJob) -> str:
    compared = (
        f"both arrive within {NEAR:g} m in {summary.both_near} missions, the replanned one after {summary.time_ratio_median:.2f} of the "
        "time of the single plan (median)"
        if summary.both_near
        else f"in no mission do both arrive within {NEAR:g} m, so times are not compared"
    )
    return (
        f"Goals are the ends of {job.legs} legs at random headings and glide angles in the truth. The median miss distance is "
        f"{summary.single_median:.0f} m with the single plan and {summary.replanned_median:.0f} m replanned; {summary.single_near:.0%} and "
        f"{summary.replanned_near:.0%} end within {NEAR:g} m; {compared}. At the surfacing nearest to the goal, which is not known without "
        f"a position, the ratio is {summary.closest_ratio_median:.2g} in the median and {summary.closest_ratio_90:.2g} for nine of ten."
    )
