"""The study of replanning: twin missions replanned at each surfacing, compared with the single plan made at the start."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.studies.planning.job import PlanningJob, StudyReport
from replay_kit.studies.planning.pictures import draw_replanned
from replay_kit.studies.planning.twin_missions import ReplanRow, run_replanning
from replay_kit.studies.planning.world import World
from replay_kit.studies.reports.tables import NAN, Criterion, Picture, named_columns
from replay_kit.workflows.planning import MissionPlanner

NAME = "replanning"
#: Arrival times are compared between missions that arrive this near [m].
NEAR = 500.0
_MEDIAN, _NINETY = 0.3, 0.7
_TITLE = (
    "Twin missions: a single plan made without a measurement, and replanned with those of each leg"
)


def replanning(world: World) -> StudyReport:
    """Return the outcome of missions that are replanned at each surfacing, beside the single plan.

    Raises:
        ConfigError: The truth is no member of the ensemble.
    """
    members = tuple(
        withheld.case.member for withheld in world.truths if withheld.case.member is not None
    )
    if len(members) < len(world.truths):
        raise ConfigError(
            "--truth: the study replanning leaves members out in turn; leave it out of --study"
        )
    config, planner = (
        RunConfig(estimator=world.truths[0].config),
        MissionPlanner.of(PlannerConfig(kind="mission", depth=world.depth)),
    )
    rows = run_replanning((world.ensemble,), config, world.job, members, planner, world.advance)
    found = summarise(rows)
    caption = f"Each mission's miss distance with a single plan and replanned; dashed: {NEAR:g} m"
    misses = np.array([(row.single.miss, row.replanned.miss) for row in rows])
    criteria = (
        Criterion(
            "miss distance over that of the single plan, median over the missions",
            found["ratio_median"],
            at_most=_MEDIAN,
        ),
        Criterion("the same, nine of ten missions at most", found["ratio_90"], at_most=_NINETY),
    )
    return StudyReport(
        NAME,
        "Missions replanned at each surfacing",
        (named_columns(NAME, _TITLE, [_cells(row) for row in rows]),),
        criteria,
        (_findings(found, world.job),),
        (Picture("replanning_misses", caption, (5.5, 5.0), partial(draw_replanned, misses, NEAR)),),
    )


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


def summarise(rows: Sequence[ReplanRow]) -> dict[str, float]:
    """Return the figures over all missions, distances in metres; arrival times are compared only where both arrive.

    ``near`` is the share of the missions that end within 500 m of the goal, ``both_near`` the number of those in which both do.
    ``closest`` is of the surfacings nearest to the goal, though without a position nobody knows which that is.
    """
    single, replanned = np.array([(row.single.miss, row.replanned.miss) for row in rows]).T
    closest = np.array([row.replanned.closest / row.single.closest for row in rows])
    both = [
        row.replanned.duration / row.single.duration
        for row in rows
        if max(row.single.miss, row.replanned.miss) <= NEAR
    ]
    figures = {
        "single": single,
        "replanned": replanned,
        "ratio": replanned / single,
        "closest_ratio": closest,
    }
    return {
        **{f"{name}_median": float(np.median(values)) for name, values in figures.items()},
        # the least value that nine of ten do not exceed: one of them, without interpolation
        **{
            f"{name}_90": float(np.quantile(values, 0.9, method="inverted_cdf"))
            for name, values in figures.items()
        },
        **{
            f"{name}_near": float(np.mean(figures[name] <= NEAR))
            for name in ("single", "replanned")
        },
        "both_near": len(both),
        "time_ratio_median": float(np.median(both)) if both else NAN,
    }


def _findings(found: Mapping[str, float], job: PlanningJob) -> str:
    compared = (
        f"both arrive within {NEAR:g} m in {found['both_near']} missions, the replanned one after {found['time_ratio_median']:.2f} of the "
        "time of the single plan (median)"
        if found["both_near"]
        else f"in no mission do both arrive within {NEAR:g} m, so times are not compared"
    )
    return (
        f"Goals are the ends of {job.legs} legs at random headings and glide angles in the truth. The median miss distance is "
        f"{found['single_median']:.0f} m with the single plan and {found['replanned_median']:.0f} m replanned; "
        f"{found['single_near']:.0%} and {found['replanned_near']:.0%} end within {NEAR:g} m; {compared}. At the surfacing nearest to the "
        f"goal, which is not known without a position, the ratio is {found['closest_ratio_median']:.2g} in the median and "
        f"{found['closest_ratio_90']:.2g} for nine of ten."
    )
