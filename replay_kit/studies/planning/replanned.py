"""The study of replanning as the command has it: what twin missions come to when they are planned anew at each surfacing."""

import math
from functools import partial

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.studies.planning.pictures import draw_replanned
from replay_kit.studies.planning.replan_rows import NEAR, ReplanJob, ReplanRow, summarise
from replay_kit.studies.planning.replanning import run_replanning
from replay_kit.studies.planning.told import Asked, Picture, Table, Told
from replay_kit.studies.planning.world import World

NAME = "replanning"
_MEDIAN, _NINETY = 0.3, 0.7


def replanning(world: World) -> Told:
    """Return what comes of missions that are planned anew from each surfacing, beside the plan made once.

    Raises:
        ConfigError: The truth is no member of the ensemble.
    """
    members = tuple(withheld.case.member for withheld in world.truths)
    if any(member is None for member in members):
        raise ConfigError("--truth: the study replanning leaves members out in turn; leave it out of --study")
    job = ReplanJob(
        missions=world.job.replans,
        legs=world.job.legs,
        most_legs=math.ceil(1.5 * world.job.legs),
        depth=world.depth,
        noise=world.job.noise,
        seed=world.job.seed,
        members=tuple(member for member in members if member is not None),
    )
    rows = run_replanning(
        (world.ensemble,),
        RunConfig(estimator=world.truths[0].config),
        job,
        world.calls.legs_planner(world.depth),
        lambda done, total, what: world.say(f"replanning, {what}", 1),
    )
    caption = f"Each mission's miss, planned once and planned anew; dashed: {NEAR:g} m"
    picture = Picture("replanning_misses", caption, (5.5, 5.0), partial(draw_replanned, rows))
    return Told(NAME, "Missions planned anew at each surfacing", (_table(rows),), _asked(rows), (_words(rows, job),), (picture,))


def _table(rows: tuple[ReplanRow, ...]) -> Table:
    columns = ("truth", "to the goal [km]", "once: miss [m]", "planned anew: miss [m]", "ratio", "legs once", "legs anew", "ended")
    cells = [
        (row.member, row.distance / 1e3, row.once.miss, anew.miss, row.ratio, row.once.legs, anew.legs, anew.ended)
        for row, anew in ((row, row.replanned) for row in rows)
    ]
    title = "Twin missions: the plan made once without a measurement, and planned anew with those of each leg"
    return Table(NAME, title, columns, tuple(cells))


def _asked(rows: tuple[ReplanRow, ...]) -> tuple[Asked, ...]:
    all_of = summarise(rows)
    return (
        Asked("final miss over that of the plan made once, median over the missions", all_of.ratio_median, at_most=_MEDIAN),
        Asked("the same, nine of ten missions at most", all_of.ratio_90, at_most=_NINETY),
    )


def _words(rows: tuple[ReplanRow, ...], job: ReplanJob) -> str:
    all_of = summarise(rows)
    compared = (
        f"both ways arrive within {NEAR:g} m in {all_of.both_near}, after {all_of.time_ratio_median:.2f} of the other's time (median)"
        if all_of.both_near
        else f"both ways arrive within {NEAR:g} m in none, so no times are compared"
    )
    return (
        f"Goals are where {job.legs} legs at random headings and glide angles lead in the truth. The median miss is "
        f"{all_of.once_median:.0f} m by the plan made once and {all_of.replanned_median:.0f} m planned anew; {all_of.once_near:.0%} and "
        f"{all_of.replanned_near:.0%} end within {NEAR:g} m; {compared}. By the surfacing nearest to the goal, which nobody flying blind "
        f"knows, the ratio is {all_of.closest_ratio_median:.2g} in the median and {all_of.closest_ratio_90:.2g} for nine of ten."
    )
