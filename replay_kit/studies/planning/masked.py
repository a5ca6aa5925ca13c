"""Missions among islands and areas drawn at random: no path that the planner reports as clear may cross them."""

from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

import planners
from replay_kit.core.arrays import Array
from replay_kit.studies.planning.flights import crossed, fly_plan
from replay_kit.studies.planning.job import StudyReport
from replay_kit.studies.planning.masks import Masked, draw_masked
from replay_kit.studies.planning.pictures import draw_masked_cases
from replay_kit.studies.planning.world import World, attempted
from replay_kit.studies.reports.tables import NAN, Cell, Criterion, Picture, Table, named_columns

NAME = "masked"
_CLEAN = ("reached", "unreachable")
_SHOWN = 6
_CAPTION = (
    "Some of the missions, from dot to star: land grey, areas orange, arrows the current at 250 m"
)
# Three times what most goals take; missions against the current would take minutes to plan.
_MOST_LEGS = 40


@dataclass(frozen=True, slots=True)
class _Row:
    """One case.

    Attributes:
        truth: Member that is the truth.
        case: Number of the case on it.
        status: Of the plan, or ``refused``.
        blocked: Whether the straight line from start to goal is.
        distance: From start to goal [m].
        legs: Of the plan.
        miss: Its predicted miss distance [m].
        crosses: What its path crosses; empty when it keeps clear.
        recomputed_crosses: The same of the path computed independently from headings and glide angles.
        apart: Between the ends of the two paths [m].
        seconds: To plan.
        message: Of the planner.
    """

    truth: int
    case: int
    status: str
    blocked: bool
    distance: float
    legs: int = 0
    miss: float = NAN
    crosses: str = ""
    recomputed_crosses: str = ""
    apart: float = NAN
    seconds: float = NAN
    message: str = ""

    @property
    def clean(self) -> bool:
        """Whether the planner reports the path as clear."""
        return self.status in _CLEAN

    @property
    def crossing(self) -> bool:
        """Whether either path crosses something."""
        return bool(self.crosses or self.recomputed_crosses)


_COLUMNS = (
    *(
        "truth",
        "case",
        "status",
        "blocked",
        "distance [m]",
        "legs",
        "miss [m]",
        "path crosses",
        "recomputed path crosses",
    ),
    *("ends apart [m]", "seconds", "message"),
)


def masked(world: World) -> StudyReport:
    """Return the outcome of missions in random masked cases, their paths recomputed and checked independently."""
    rows: list[_Row] = []
    views: list[tuple[Masked, Array, str]] = []
    for _, found in world.each_truth(_of_truth, world.job.masks):
        rows += [row for _, row, _ in found]
        views += [
            (case, track, row.status)
            for case, row, track in found
            if case.blocked and track is not None
        ]
    views = views[:_SHOWN]
    every = Table(
        "masked_cases",
        "Each case",
        _COLUMNS,
        tuple(tuple(asdict(row).values()) for row in rows),
        shown=False,
    )
    return StudyReport(
        NAME,
        "Missions among islands and areas drawn at random",
        (_counts(rows), every),
        _criteria(rows),
        (_findings(rows),),
        (Picture("masked_cases", _CAPTION, (11.0, 7.0), partial(draw_masked_cases, tuple(views))),),
    )


def _of_truth(world: World, count: int) -> list[tuple[Masked, _Row, Array | None]]:
    """Return random cases on the one truth of a world, their rows and paths."""
    (withheld,), found = world.truths, []
    for k in range(count):
        rng = np.random.default_rng((world.job.seed, 3, withheld.member, k))
        case = draw_masked(withheld.estimated["default"], world.depth, withheld.config.nugget, rng)
        world.advance(f"masked, truth {withheld.member}")
        found.append((case, *_planned(world, case, (withheld.member, k))))
    return found


def _planned(world: World, case: Masked, number: tuple[int, int]) -> tuple[_Row, Array | None]:
    """Return a case's row, and its path; None without one."""
    settings = planners.MissionSettings(depth=world.depth, max_legs=_MOST_LEGS)
    areas = tuple(planners.NoGo(area, f"area {k + 1}") for k, area in enumerate(case.areas))
    row = partial(_Row, *number, blocked=case.blocked, distance=case.pair.distance)

    request = planners.MissionRequest(
        case.pair.start, (case.pair.target,), world.glider, settings, areas
    )
    plan, message, seconds = attempted(partial(planners.plan_mission, case.flow, request))
    legs = 0 if plan is None else len(plan.headings_deg)
    if plan is None or not legs:
        return row(
            status="refused" if plan is None else plan.status, seconds=seconds, message=message
        ), None
    recomputed = fly_plan(case.flow, plan, world.depth)
    figures: dict[str, Any] = {
        "miss": float(plan.closest_approach[-1]),
        "crosses": crossed(case.flow.grid, case.areas, plan.track) or "",
        "recomputed_crosses": crossed(case.flow.grid, case.areas, recomputed) or "",
        "apart": float(np.linalg.norm(recomputed[-1] - plan.track[-1])),
    }
    return row(
        status=plan.status, legs=legs, seconds=seconds, message=message, **figures
    ), plan.track


def _counts(rows: list[_Row]) -> Table:
    out: list[dict[str, Cell]] = []
    for status in dict.fromkeys(row.status for row in rows):
        alike = [row for row in rows if row.status == status]
        seconds = np.array([row.seconds for row in alike])
        out.append(
            {
                "status": status,
                "cases": len(alike),
                "straight line blocked": sum(row.blocked for row in alike),
                "crossings": sum(row.crossing for row in alike),
                "median seconds": float(np.median(seconds)),
                "most seconds": float(seconds.max()),
            }
        )
    return named_columns(NAME, "Missions among islands and areas, by the plan's status", out)


def _criteria(rows: list[_Row]) -> tuple[Criterion, ...]:
    clean = [row for row in rows if row.clean]
    apart = max((row.apart for row in clean), default=NAN)
    return (
        Criterion(
            "crossings of paths reported as clear, planned or recomputed",
            sum(row.crossing for row in clean),
            at_most=0,
        ),
        Criterion(
            "largest distance between the ends of a planned and its recomputed path [m]",
            apart,
            at_most=50.0,
        ),
    )


def _findings(rows: list[_Row]) -> str:
    blocked, clean = sum(row.blocked for row in rows), sum(row.clean for row in rows)
    return (
        f"{len(rows)} cases; in {blocked} the straight line from start to goal is blocked. {clean} plans are reported as clear. Each path "
        "is checked every 10 m against the land of the nearest grid point and against the winding number of each area, both as planned "
        "and as recomputed from headings and glide angles by separate code. Plans with status `unsafe` state that they "
        "cross something."
    )
