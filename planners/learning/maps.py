"""The next profiles of a map of a box's current, against lawn-mowers, and what both are worth in samples."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from planners.learning.comparison import best_mower, compared
from planners.learning.loops import Aim, Survey
from planners.learning.mapping import Mapping, look_ahead, refined
from planners.learning.rows import (
    Combined,
    covariance,
    lower_root,
    rows_at,
    unknowns_at,
)
from planners.learning.scene import Scene, dives_of, scene_of, value_map
from planners.learning.values import Box, Candidate, LearnPlan, LearnRequest
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_local, unwrap_longitude

# Places along the longer side of a box at which the current counts.
_ALONG = 11
# A lawn-mower is offered when the plan is no better than by this share.
_AS_GOOD = 0.01


def plan_map(flow: FlowEstimate, request: LearnRequest, box: Box) -> LearnPlan:
    """Return the profiles that leave the least error of the current in a box.

    Args:
        flow: The estimate, with its uncertainty.
        request: Start, number of profiles, and how they are brought.
        box: Whose current counts.

    Raises:
        PlanError: The box is outside or on land, no leg may be flown, or nothing is left to learn.
    """
    scene, mapping, notes = mapping_of(flow, request, box)
    check_uncertain(scene, mapping)
    survey, after, mower, mower_error, is_mower = choose_map(scene, mapping)
    words = error_words(request.profiles, mapping.before(), after)
    words += (
        " along a lawn-mower, than which nothing better was found"
        if is_mower
        else f"; the best lawn-mower to {mower_error:.3f} m/s"
    )
    candidates, more = compared(
        scene,
        {
            "no profiles": (mapping.before(), ()),
            "the best lawn-mower": (mower_error, ((mapping, mower),)),
            "this plan": (after, ((mapping, survey),)),
        },
    )
    return map_plan(scene, (mapping, survey, after), candidates, request, words, (*notes, *more))


def mapping_of(
    flow: FlowEstimate, request: LearnRequest, box: Box
) -> tuple[Scene, Mapping, tuple[str, ...]]:
    """Return the scene of a map's request, what is to be mapped, and what should be known of the box.

    Raises:
        PlanError: The box is outside or on land, or no profiles are asked for.
    """
    if request.profiles < 1:
        raise PlanError(f"profiles of a map: expected 1 or more, got {request.profiles}")
    scene = scene_of(flow, request, None, box.depths)
    places, counted = _places(scene, box)
    times: Array = scene.begin + scene.leg_time * np.arange(request.profiles + 1, dtype=np.float64)
    which = tuple(range(1, len(box.depths) + 1)) or (0,)
    given = scene.aim(Combined(rows_at(scene.known, places[:1], times[-1:]), np.eye(2))).given
    where = scene.known, scene.mean, places, which, scene.start, times
    mapping = Mapping(*where, scene.speed, scene.settings.error**2, given)
    share = 100.0 * (1.0 - counted)
    note = f"{share:.0f} % of the box lie outside of the region or on land and do not count"
    return scene, mapping, () if counted > 0.99 else (note,)


def check_uncertain(scene: Scene, mapping: Mapping) -> None:
    """Raise PlanError where the current in the box is known so well that profiles are of no use."""
    before = mapping.before()
    if before <= 0.5 * scene.settings.error:
        raise PlanError(
            f"no uncertainty is left to reduce: the current in the box is known to {before:.3f} m/s, and a profile errs by "
            f"{scene.settings.error:g} m/s; choose another box"
        )


def error_words(profiles: int, before: float, after: float) -> str:
    """Return what profiles make of the error in the box, in words."""
    return f"{profiles} profiles reduce the error of the current in the box from {before:.3f} to {after:.3f} m/s"


def choose_map(scene: Scene, mapping: Mapping) -> tuple[Survey, float, Survey, float, bool]:
    """Return the survey and its error, the best lawn-mower and its error, and whether that is the survey.

    Raises:
        PlanError: No leg may be flown.
    """
    ahead = look_ahead(mapping, scene.allowed, covariance_now(scene, mapping))
    mower, mower_error = best_mower(scene, mapping)
    tried = [
        refined(mapping, scene.allowed, one, scene.settings.seed)
        for one in ([ahead, mower] if np.isfinite(mower_error) else [ahead])
    ]
    survey, error = min(tried, key=lambda one: one[1])
    if mower_error <= error * (1.0 + _AS_GOOD):
        return mower, mower_error, mower, mower_error, True
    return survey, error, mower, mower_error, False


def covariance_now(scene: Scene, mapping: Mapping) -> Array:
    """Return the covariance of the unknowns when a plan begins, shape (n, n), as if the profiles of others were made by then."""
    own = unknowns_at(scene.known, scene.begin)
    cov = covariance(own, own)
    if mapping.given is None:
        return cov
    lower = lower_root(mapping.given, mapping.variance)
    inside = solve_triangular(lower, covariance(mapping.given, own), lower=True)
    return np.asarray(cov - inside.T @ inside)


def _places(scene: Scene, box: Box) -> tuple[Array, float]:
    """Return the places of a box whose current counts, shape (P, 2) [m], and their share of all.

    Raises:
        PlanError: None lies in water within the region, or a depth is not within the levels.
    """
    grid, region = scene.known.flow.grid, scene.task.region
    name = f"the box from {box.west:g}, {box.south:g} to {box.east:g}, {box.north:g}"
    deep = [depth for depth in box.depths if not 0.0 <= depth <= float(grid.levels[-1])]
    if deep:
        raise PlanError(
            f"{name}: expected depths from the surface to {grid.levels[-1]:g} m, the deepest level, got {deep[0]:g} m"
        )
    shape = np.array(
        [
            (box.east - box.west) * np.cos(np.deg2rad(0.5 * (box.south + box.north))),
            box.north - box.south,
        ]
    )
    count = np.maximum(np.round(_ALONG * shape / shape.max()).astype(int), 2)
    west = float(unwrap_longitude(np.array([box.west]), scene.projection.longitude)[0])
    longitude, latitude = np.meshgrid(
        np.linspace(west, west + box.east - box.west, count[0]),
        np.linspace(box.south, box.north, count[1]),
    )
    points = np.column_stack(to_local(scene.projection, longitude.ravel(), latitude.ravel()))
    inside: NDArray[np.bool_] = np.asarray(np.all(np.isfinite(points), axis=1))
    inside[inside] = region.inside_outline(points[inside])
    if not inside.any():
        raise PlanError(
            f"{name} lies outside of the estimate's region, longitude {grid.longitude.min():.3f} to {grid.longitude.max():.3f}, latitude "
            f"{grid.latitude.min():.3f} to {grid.latitude.max():.3f}; choose a box within it"
        )
    deepest = max(box.depths, default=0.0)
    wet = inside.copy()
    wet[inside] = region.wet(np.column_stack([points[inside], np.full(int(inside.sum()), deepest)]))
    if not wet.any():
        shallow = f" or in water shallower than {deepest:g} m" if deepest > 0.0 else ""
        raise PlanError(f"{name} lies on land{shallow}; choose a box in water")
    return points[wet], float(wet.mean())


def map_plan(
    scene: Scene,
    chosen: tuple[Mapping, Survey, float],
    candidates: tuple[Candidate, ...],
    request: LearnRequest,
    words: str,
    notes: tuple[str, ...],
) -> LearnPlan:
    """Return the plan of one vehicle's survey: its legs and track, and what the next profile is worth.

    Args:
        scene: Of the vehicle.
        chosen: What is to be mapped, the survey, and the error after it [m/s].
        candidates: What it was compared with.
        request: Of the vehicle.
        words: The answer.
        notes: What should be known.
    """
    mapping, survey, after = chosen
    legs, times, track = dives_of(scene, scene.start, survey.ends[0], mapping.times)
    combined = Combined(
        mapping.sought, np.eye(mapping.variances.size) / np.sqrt(mapping.variances.size)
    )
    aim = Aim(scene.known, combined, mapping.variance, mapping.given)
    box = mapping.box[:, 0] + 1j * mapping.box[:, 1]
    samples = scene.settings.samples if np.isfinite(candidates[0].found) else 0
    return LearnPlan(
        status="reached",
        message=words,
        objective="map",
        request=request,
        goal=scene.place(complex(survey.ends[0, -1])),
        depth=scene.settings.depth,
        legs=legs,
        track_time=times,
        track=track,
        miss=0.0,
        before=mapping.before(),
        after=after,
        candidates=candidates,
        value=value_map(scene, aim, float(mapping.profile_times[0]), box, "m/s"),
        found_name="error in the box",
        unit="m/s",
        notes=notes,
        statistics={"samples": samples, "surfacings": int(survey.times.size)},
    )
