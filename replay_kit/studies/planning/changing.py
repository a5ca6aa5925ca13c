"""The study of a sea that changes: missions of days planned on forecasts that change, on frozen ones, and not at all."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from planners import Glider, MissionPlan, MissionSettings, plan_mission
from planners.mission.flights import fly_mission
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import inside_grid
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.tasks import each_call
from replay_kit.studies.missions.scene import withhold
from replay_kit.studies.planning.job import PlanningJob, StudyReport
from replay_kit.studies.planning.voyages import (
    Crossing,
    Sea,
    Voyage,
    follow_plan,
    frozen,
    given_up,
    head_at_goal,
    replan,
    sea_of,
)
from replay_kit.studies.planning.world import ANGLES, World
from replay_kit.studies.reports.tables import NAN, Cell, Criterion, named_columns
from replay_kit.studies.twins.reachable import SPEED, place_at

NAME = "changing"
# Way kept from the edge of the region [m], depth of the dives [m], longest mission [s].
_MARGIN, _DEPTH, _LONGEST = 15e3, 1000.0, 5 * 86_400.0
_DRAWS = 200
# What is required: share of the reachable that arrive, of the truth's earliest, miss of a perfect current [m], later than the habit.
_ARRIVE, _EARLIEST, _PERFECT, _LATER, _BY = 30.0 / 34.0, 1.015, 300.0, 0.05, 1.01
# Share of the forecast's time after which missions begin, when its members have parted.
_BEGINS = 0.3
# Arrivals are the same within this share: a passage is sought between points of the track.
_SAME = 1e-3
_HEADING = "A sea that changes"
_TITLE = (
    "Missions of days in a sea that changes; arrivals within 1.5 km over the earliest in the truth"
)


@dataclass(frozen=True, slots=True)
class Sailed:
    """One mission, flown in several ways.

    Attributes:
        member: The truth, position from 0.
        distance: Between start and goal [m].
        earliest: When the plan made in the truth passes the goal in it [s]; inf where it does not: the goal is out of reach.
        perfect: Miss of the plan made in the truth as it changes, followed to its end [m].
        held: Miss of the plan made in the truth of the start, held, followed to its end [m].
        replanned: Arrival [s] with a new plan at each surfacing on the mean of the other members as it changes.
        habit: Arrival with the head at the goal at each surfacing [s].
        known: Arrival [s] of replanning in the mean of the other members itself.
        known_habit: Arrival of the habit there [s].
        plans: Made by the replanned mission.
    """

    member: int
    distance: float
    earliest: float
    perfect: float = NAN
    held: float = NAN
    replanned: float = NAN
    habit: float = NAN
    known: float = NAN
    known_habit: float = NAN
    plans: int = 0

    @property
    def reachable(self) -> bool:
        """Whether the truth lets a glider that knows it arrive."""
        return bool(np.isfinite(self.earliest))

    @property
    def cells(self) -> dict[str, Cell]:
        """Its row."""
        ways = {"replanned": self.replanned, "habit": self.habit}
        return {
            "truth": self.member,
            "to the goal [km]": self.distance / 1e3,
            "earliest [h]": self.earliest / 3600.0 if self.reachable else NAN,
            "changing truth followed: miss [m]": self.perfect,
            "held truth followed: miss [m]": self.held,
            **{
                f"{name}: over the earliest": time / self.earliest if np.isfinite(time) else NAN
                for name, time in ways.items()
            },
            "in the estimate: replanned over the habit": self.known / self.known_habit
            if np.isfinite(self.known_habit)
            else NAN,
            "plans": self.plans,
        }


def changing(world: World) -> StudyReport:
    """Return the outcome of missions of days in a sea that changes.

    Raises:
        ConfigError: The truth is no member of the ensemble, or the forecast has one time only.
    """
    members = tuple(
        withheld.case.member for withheld in world.truths if withheld.case.member is not None
    )
    if len(members) < len(world.truths):
        raise ConfigError(
            "--truth: the study changing leaves members out in turn; leave it out of --study"
        )
    if len(world.series) < 2:
        raise ConfigError(
            f"--study changing: expected a forecast of several dated times, got {world.ensemble.source} of one; give a file with leads or "
            "times, with --reference-time where the file states none"
        )
    chosen = [members[k % len(members)] for k in range(world.job.crossings)]
    calls = (
        (world.series, world.truths[0].config, world.job, member, world.job.seed + k)
        for k, member in enumerate(chosen)
    )
    rows = []
    for row in each_call(sail, calls):
        rows.append(row)
        world.advance(f"changing, truth {row.member}")
    return report_of(rows)


def sail(
    series: Sequence[Ensemble], config: EstimatorConfig, job: PlanningJob, member: int, seed: int
) -> Sailed:
    """Return one mission in the truth of a member, flown in all ways."""
    case, rng = withhold(series, member), np.random.default_rng((seed, member))
    start_ns = int(case.times_ns[0] + _BEGINS * (case.times_ns[-1] - case.times_ns[0]))
    kept = _around(case.times_ns, start_ns, given_up(_LONGEST))
    truth, known = sea_of(case.truths[kept], config), sea_of(case.forecasts[kept], config)
    grid = truth[0].grid
    (here, there), settings = (
        _drawn(grid, rng, job.crossing),
        MissionSettings(depth=min(_DEPTH, float(grid.levels[-1])), max_duration=_LONGEST),
    )
    crossing = Crossing(
        place_at(grid, here),
        place_at(grid, there),
        start_ns,
        Glider(SPEED, None, *ANGLES),
        settings,
    )
    request = crossing.request(crossing.start, start_ns)
    in_truth = plan_mission(truth, request)
    best = (
        follow_plan(truth, crossing, in_truth)
        if len(in_truth.headings_deg)
        else Voyage(inf, 0, inf, 0)
    )
    row = Sailed(member, float(np.linalg.norm(there - here)), best.arrival, best.closest)
    if not row.reachable:
        return row
    first, limit = plan_mission(known, request), given_up(best.arrival)
    replanned = replan(truth, known, crossing, first, limit)
    like = first if len(first.headings_deg) else in_truth
    return replace(
        row,
        perfect=end_miss(truth, in_truth),
        held=end_miss(truth, plan_mission(frozen(truth, start_ns), request)),
        replanned=replanned.arrival,
        habit=head_at_goal(truth, crossing, like, limit).arrival,
        known=replan(known, known, crossing, first, limit).arrival,
        known_habit=head_at_goal(known, crossing, like, limit).arrival,
        plans=replanned.plans,
    )


def _around(times_ns: NDArray[np.int64], start_ns: int, seconds: float) -> slice:
    """Return which of a forecast's times [ns, UTC] a mission of so many seconds meets, from before it to after it; two at least."""
    first = max(int(np.searchsorted(times_ns, start_ns, side="right")) - 1, 0)
    last = int(np.searchsorted(times_ns, start_ns + round(seconds * 1e9)))
    return slice(min(first, len(times_ns) - 2), last + 1)


def end_miss(truth: Sea, plan: MissionPlan) -> float:
    """Return how far from its goal a plan ends [m] that is followed in a truth; NaN without legs."""
    return float(fly_mission([truth], plan).miss[0, -1]) if len(plan.headings_deg) else NAN


def _drawn(
    grid: Grid, rng: np.random.Generator, distance: tuple[float, float]
) -> tuple[Array, Array]:
    """Return a start and a goal, shape (2,) [m], inside the region's edge and so far apart."""
    low, high = (np.array([f(grid.east), f(grid.north)]) for f in (np.min, np.max))
    for _ in range(_DRAWS):
        start, course, far = (
            rng.uniform(low, high),
            rng.uniform(0.0, 2.0 * np.pi),
            rng.uniform(*distance),
        )
        ends = np.stack([start, start + far * np.array([np.sin(course), np.cos(course)])])
        around = np.concatenate(
            [
                ends + _MARGIN * np.array(side)
                for side in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
            ]
        )
        if np.all(inside_grid(grid, *around.T)):
            return ends[0], ends[1]
    raise ConfigError(
        f"--study changing: no start and goal {distance[0] / 1e3:g} km apart lie inside the region; give a larger region"
    )


def report_of(rows: Sequence[Sailed]) -> StudyReport:
    """Return the outcome of some missions."""
    table = named_columns(NAME, _TITLE, [row.cells for row in rows])
    reachable = [row for row in rows if row.reachable]
    if not reachable:
        return StudyReport(
            NAME,
            _HEADING,
            (table,),
            (),
            (f"None of {len(rows)} goals is within reach in the truth.",),
        )
    found = figures(reachable)
    criteria = (
        Criterion(
            "share of the reachable goals at which replanned missions arrive",
            found["arrive"],
            at_least=_ARRIVE,
        ),
        Criterion(
            "their arrival over the earliest in the truth, median",
            found["over_earliest"],
            at_most=_EARLIEST,
        ),
        Criterion(
            "miss of a plan in a perfect changing current, largest [m]",
            found["perfect"],
            at_most=_PERFECT,
        ),
        Criterion(
            "missions later than the habit, in the estimate itself",
            found["later_known"],
            at_most=0.0,
        ),
        Criterion(
            "share of the missions later than the habit by more than 1 %, in the truth",
            found["later"],
            at_most=_LATER,
        ),
    )
    findings = (
        f"{len(reachable)} of {len(rows)} goals are within reach of a glider that knows the truth as it changes. Replanned on the mean of "
        f"the other members at each surfacing {found['arrive']:.0%} of these arrive, in the median after {found['over_earliest']:.3f} of "
        f"the earliest time; with the head at the goal {found['habit_arrive']:.0%} do, after {found['habit_over_earliest']:.3f}. The "
        f"truth's own plan, followed as it is, ends {found['perfect_median']:.0f} m off in the median; that of the truth of the start, "
        f"held, {found['held_median'] / 1e3:.1f} km.",
    )
    return StudyReport(NAME, _HEADING, (table,), criteria, findings)


def figures(rows: Sequence[Sailed]) -> dict[str, float]:
    """Return the figures over missions whose goals are within reach."""
    earliest, replanned, habit = (
        np.array([getattr(row, name) for row in rows])
        for name in ("earliest", "replanned", "habit")
    )
    known, known_habit = (
        np.array([getattr(row, name) for row in rows]) for name in ("known", "known_habit")
    )
    arrived, at_home = np.isfinite(replanned), np.isfinite(habit)
    return {
        "arrive": float(np.mean(arrived)),
        "over_earliest": float(np.median((replanned / earliest)[arrived]))
        if arrived.any()
        else NAN,
        "habit_arrive": float(np.mean(at_home)),
        "habit_over_earliest": float(np.median((habit / earliest)[at_home]))
        if at_home.any()
        else NAN,
        "perfect": float(np.max([row.perfect for row in rows])),
        "perfect_median": float(np.median([row.perfect for row in rows])),
        "held_median": float(np.nanmedian([row.held for row in rows])),
        # one that does not arrive is later than one that does; where neither arrives none is
        "later_known": float(np.sum(known > known_habit * (1.0 + _SAME))),
        "later": float(np.mean(replanned > _BY * habit)),
    }
