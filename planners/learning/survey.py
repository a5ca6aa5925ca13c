"""A survey before a stretch without fixes: the loop that leaves the least error at the stretch's end, and what it is worth."""

from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from planners.front.current import Complex
from planners.learning.closed_loop import Flown, Sea, Stretch, drawn_sea, fly_after, slices
from planners.learning.loops import (
    SCOUTING,
    WAITING,
    Aim,
    Survey,
    allowed_errors,
    clear,
    search,
    shapes,
    timed,
)
from planners.learning.rows import rows_at
from planners.learning.scene import Scene, dives_of, leg_of, scene_of, value_map
from planners.learning.transit import Transit, end_sensitivity, path_of, plan_transit
from planners.learning.values import Candidate, LearnLeg, LearnPlan, LearnRequest
from planners.route.hazards import first_crossing
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import grid_bearing_of_true_north, heading_deg, inside_grid
from replay_kit.core.plan import PlanStatus

# Loops that are named in the table beside waiting, scouting and the plan.
_NAMED = 4


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """The surveys that were compared: those offered, which of them may be flown, the errors they leave, and the best."""

    offered: Survey
    allowed: NDArray[np.bool_]
    errors: Array
    best: Survey
    error: float


def plan_survey(
    flow: FlowEstimate, request: LearnRequest, survey: float, blind: float
) -> LearnPlan:
    """Return the survey from the start and back that leaves the least error at the end of a stretch without fixes, and the stretch.

    Args:
        flow: The estimate, with its uncertainty.
        request: Start, and the goals of the stretch in order.
        survey: Duration of the survey [s].
        blind: Duration of the stretch [s].

    Raises:
        PlanError: A place is outside, on land or forbidden, no survey can be flown, or nothing is left to learn.
    """
    scene = scene_of(flow, request, survey + blind)
    stretch = Stretch(
        scene.start, scene.goals, scene.begin, survey, blind, scene.speed, scene.settings.error
    )
    n_dives = int(survey / scene.leg_time + 1e-9)
    if n_dives < 2:
        raise PlanError(
            f"a survey of {survey / 3600.0:g} h cannot return: it holds {n_dives} surfacings of {scene.leg_time / 3600.0:.1f} h each, and "
            "one out and one back are needed; allow more time, or shallower dives"
        )
    planned = plan_transit(
        scene.mean, np.array([scene.start]), stretch.leaves, scene.goals, blind, scene.speed
    )
    aim = _aim(scene, stretch, planned)
    _check_predictable(scene, stretch, planned, aim)
    if aim.before() <= scene.settings.tolerance:
        raise PlanError(
            f"no uncertainty is left to reduce: without a survey the stretch ends within {aim.before():.0f} m (root mean square) of where "
            f"it is planned, within the tolerance of {scene.settings.tolerance:g} m; leave the survey out"
        )
    found = _search(scene, stretch, aim, n_dives)
    sea = drawn_sea(
        scene.known,
        slices(scene.known, scene.begin, stretch.leaves + blind),
        scene.settings.samples,
        scene.settings.seed,
    )
    candidates, misses = _candidates(scene, stretch, sea, aim, found)
    return _plan(scene, request, stretch, (planned, aim, found), (candidates, misses))


def _check_predictable(scene: Scene, stretch: Stretch, planned: Transit, aim: Aim) -> None:
    """Raise PlanError where the stretch ends, or most of its ends would lie, outside of the region: nothing is known of the current there.

    Args:
        scene: Of the plan.
        stretch: What is asked for.
        planned: The stretch in the current that is known.
        aim: Its end without a survey.
    """
    grid, hours = scene.known.flow.grid, stretch.blind / 3600.0
    half, end = 0.5 * float(np.hypot(np.ptp(grid.east), np.ptp(grid.north))), planned.ends[0, -1]
    advice = "choose a shorter stretch, or a mission with fixes: --goal without --then and --blind"
    if not inside_grid(grid, end.real, end.imag):
        raise PlanError(
            f"{hours:g} h without fixes at {stretch.speed:.2f} m/s end outside of the estimate's region, "
            f"{abs(end - stretch.goals[-1]) / 1e3:.0f} km from the goal, carried by the current that is known; {advice}"
        )
    if aim.before() > half:
        raise PlanError(
            f"{hours:g} h without fixes cannot be predicted: without a survey the stretch ends some {aim.before() / 1e3:.0f} km "
            "(root mean square) from where it is planned, farther than the region's corners are from its middle, "
            f"{half / 1e3:.0f} km; {advice}"
        )


def _aim(scene: Scene, stretch: Stretch, planned: Transit) -> Aim:
    """Return where the stretch ends as what counts."""
    sense = end_sensitivity(scene.mean, stretch.start, stretch.leaves, planned)
    rows = rows_at(
        scene.known, np.stack([sense.points.real, sense.points.imag], axis=-1), sense.times
    )
    return scene.aim(rows.combined(sense.weights))


def _search(scene: Scene, stretch: Stretch, aim: Aim, n_dives: int) -> _Found:
    """Return the surveys that may be flown and the best.

    Raises:
        PlanError: None can be flown.
    """
    rings, span = scene.hazards, (stretch.begin, stretch.survey, n_dives)

    def make(shape: Complex) -> tuple[Survey, NDArray[np.bool_]]:
        made = timed(scene.mean, stretch.start, shape, span, stretch.speed)
        free = made.flown & scene.inside(made)
        free[free] = clear(
            made.picked(np.flatnonzero(free)), stretch.start, rings, scene.settings.margin
        )
        return made, free

    ahead = complex(stretch.goals[0] - stretch.start) or 1.0 + 0j
    offered, allowed = make(shapes(ahead))
    against = abs(complex(scene.mean.at(np.array([stretch.start]), stretch.begin)[0]))
    allowed[WAITING] &= against < stretch.speed
    if not allowed[WAITING + 1 :].any():
        why = f"the current, {against:.2f} m/s at the start, is too strong for {stretch.speed:.2f} m/s through water"
        if offered.flown[WAITING + 1 :].any():
            why = "land, shallows, areas or the edge of the region are in the way of each of them"
        raise PlanError(
            f"no survey of {stretch.survey / 3600.0:g} h can leave and return: of {len(allowed) - 1} loops none can be flown, as {why}; "
            "choose another start, a shorter survey, or shallower dives"
        )
    errors = allowed_errors(aim, offered, allowed)
    shape, error = search(aim, make, offered.corners - stretch.start, errors)
    return _Found(offered, allowed, errors, make(shape[None])[0], error)


def _candidates(
    scene: Scene, stretch: Stretch, sea: Sea, aim: Aim, found: _Found
) -> tuple[tuple[Candidate, ...], dict[str, Flown]]:
    """Return the candidates as they turn out in samples, and the flights of those that the message names."""
    noise = np.random.default_rng(scene.settings.seed + 1).standard_normal(
        (sea.count, found.best.times.size, 2)
    )
    flown: dict[str, Flown] = {"now": fly_after(sea, stretch, None, noise, scene.given)}
    named: list[tuple[str, float, Survey | None]] = [("leaving now", aim.before(), None)]
    if found.allowed[WAITING]:
        named.append(
            ("waiting as long", float(found.errors[WAITING]), found.offered.picked([WAITING]))
        )
    if found.allowed[SCOUTING]:
        named.append(
            (
                "scouting ahead and back",
                float(found.errors[SCOUTING]),
                found.offered.picked([SCOUTING]),
            )
        )
    named.append(("this survey", found.error, found.best))
    rows = []
    for name, predicted, survey in named:
        one = (
            flown["now"] if survey is None else fly_after(sea, stretch, survey, noise, scene.given)
        )
        flown[name] = one
        within = float(np.mean(one.misses <= scene.settings.tolerance))
        rows.append(
            Candidate(name, predicted, one.miss_90, *one.interval(), within, name == "this survey")
        )
    at = scene.place(scene.start)
    turn = float(
        np.rad2deg(grid_bearing_of_true_north(scene.projection, at.longitude, at.latitude))
    )
    order = [
        k
        for k in np.argsort(found.errors)
        if np.isfinite(found.errors[k]) and k not in (WAITING, SCOUTING)
    ][:_NAMED]
    for k in order:
        corner = complex(found.offered.corners[k, 0]) - stretch.start
        bearing = float(np.mod(heading_deg(corner.real, corner.imag) - turn, 360.0))
        name = f"a loop towards {bearing:.0f} degrees, {abs(corner) / 1e3:.1f} km out"
        rows.append(Candidate(name, float(found.errors[k]), nan, nan, nan, nan))
    return tuple(rows), flown


def _plan(
    scene: Scene,
    request: LearnRequest,
    stretch: Stretch,
    made: tuple[Transit, Aim, _Found],
    outcome: tuple[tuple[Candidate, ...], dict[str, Flown]],
) -> LearnPlan:
    """Return the plan with its message and track."""
    (planned, aim, found), (candidates, flown) = made, outcome
    legs, times, track = dives_of(
        scene,
        stretch.start,
        found.best.ends[0],
        np.linspace(stretch.begin, stretch.leaves, found.best.times.size + 1),
    )
    blind_legs, blind_times, blind_track = _blind(scene, stretch, planned)
    crossed = _crossed(scene, blind_track)
    miss = float(abs(planned.ends[0, -1] - scene.goals[-1]))
    status: PlanStatus = (
        "unsafe" if crossed else "reached" if miss <= scene.settings.tolerance else "unreachable"
    )
    message = _words(candidates, stretch) + _out_of_reach(
        flown["this survey"], stretch, scene.settings.tolerance
    )
    chosen = next(one for one in candidates if one.chosen)
    if status == "reached" and (rare := chosen.shortfall(scene.settings)):
        status, message = "uncertain", message + rare
    if status == "unreachable":
        message += (
            f"; the goal is {miss / 1e3:.1f} km out of reach of {stretch.blind / 3600.0:g} h at {stretch.speed:.2f} m/s through water: "
            "allow more time, or a nearer goal"
        )
    if crossed:
        message += f"; the stretch after the survey crosses {crossed}: give places on the way round with --then, or less time"
    names = {"now": "leaving now"}
    figures = {
        f"bound_{names.get(name, name)}": float(np.quantile(np.abs(one.offsets), 0.9))
        for name, one in flown.items()
    }
    return LearnPlan(
        status=status,
        message=message,
        objective="survey",
        request=request,
        goal=request.goals[-1],
        depth=scene.settings.depth,
        legs=(*legs, *blind_legs),
        track_time=np.concatenate([times, blind_times]),
        track=np.concatenate([track, blind_track]),
        miss=miss,
        before=aim.before(),
        after=found.error,
        candidates=candidates,
        value=value_map(
            scene,
            aim,
            0.5 * (stretch.begin + stretch.leaves),
            np.append(scene.goals, stretch.start),
            "m",
        ),
        found_name="90 % miss",
        unit="m",
        statistics={
            **figures,
            "samples": scene.settings.samples,
            "surfacings": int(found.best.times.size),
        },
    )


def _blind(
    scene: Scene, stretch: Stretch, planned: Transit
) -> tuple[tuple[LearnLeg, ...], Array, Array]:
    """Return the legs of the stretch without fixes, and its track, at half the dives' depth."""
    times, path = path_of(scene.mean, np.array([stretch.start]), stretch.leaves, planned)
    legs, begin, when = [], stretch.start, stretch.leaves
    for held, end, duration in zip(
        planned.through_water[0], planned.ends[0], planned.durations, strict=True
    ):
        legs.append(leg_of(scene, begin, complex(end), (when, when + duration), complex(held)))
        begin, when = complex(end), when + float(duration)
    track = np.column_stack([path.real, path.imag, np.full(path.size, 0.5 * scene.settings.depth)])[
        1:
    ]
    return tuple(legs), times[1:] - scene.begin, track


def _crossed(scene: Scene, track: Array) -> str | None:
    """Return what the stretch without fixes crosses that it may not; None for nothing. It may pass where surfacing alone is forbidden."""
    rings = [ring for ring in scene.hazards if not ring.surface_only]
    begins = np.concatenate([scene.task.start[None, :2], track[:-1, :2]])
    found = first_crossing(
        rings, np.stack([begins, track[:, :2]], axis=1), np.full(len(track), scene.settings.margin)
    )
    return None if found is None else found[0]


def _out_of_reach(flown: Flown, stretch: Stretch, tolerance: float) -> str:
    """Return in how many samples the goal is out of reach, which no survey mends; nothing where it hardly ever is."""
    share = float(np.mean(flown.short > tolerance))
    if share < 0.05:
        return ""
    return f"; the goal is out of reach of {stretch.speed:.2f} m/s in {100.0 * share:.0f} % of the samples, which no survey mends"


def _words(candidates: tuple[Candidate, ...], stretch: Stretch) -> str:
    """Return the answer in words: what each is worth, and what to do."""
    by_name = {one.name: one for one in candidates if one.found == one.found}
    parts = [
        f"{name} {one.found / 1e3:.1f} km ({one.low / 1e3:.1f} to {one.high / 1e3:.1f})"
        for name, one in by_name.items()
    ]
    words = (
        f"90 % of {stretch.blind / 3600.0:g} h without fixes end within, after {stretch.survey / 3600.0:g} h: "
        + ", ".join(parts)
    )
    plan, waiting = by_name["this survey"], by_name.get("waiting as long")
    scouting = by_name.get("scouting ahead and back")
    now = by_name.get("leaving now")
    if now is not None and plan.found > now.high:
        words += "; leaving now misses less than after this survey"
    elif now is not None and plan.found >= now.low:
        words += "; the survey is no certain gain over leaving now"
    elif waiting is not None and plan.found >= waiting.low:
        words += "; the survey is no certain gain over waiting"
    elif scouting is not None and plan.found >= scouting.low:
        words += "; scouting ahead and back is as good"
    return words
