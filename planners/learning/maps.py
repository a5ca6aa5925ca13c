"""The next profiles of a map of a box's current, against lawn-mowers, and what both are worth in samples."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from planners.learning.choose import Aim
from planners.learning.closed_loop import Sea, Stretch, drawn_sea, fly_survey, from_others, slices
from planners.learning.loops import Survey
from planners.learning.mapping import Mapping, look_ahead, refined
from planners.learning.mowers import lawn_mowers
from planners.learning.rows import (
    Combined,
    Rows,
    covariance,
    gains,
    lower_root,
    rows_at,
    stacked,
    unknowns_at,
)
from planners.learning.scene import Scene, dives_of, scene_of, value_map
from planners.learning.values import Box, Candidate, LearnPlan, LearnRequest
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.evidence import bootstrap_interval
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_local, unwrap_longitude

#: What is to be mapped as a vehicle has it, and the survey that it flies.
Flown = tuple[Mapping, Survey]
# Places along the longer side of a box at which the current counts; resamples of an interval.
_ALONG, _RESAMPLES = 11, 400
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


def best_mower(scene: Scene, mapping: Mapping) -> tuple[Survey, float]:
    """Return the lawn-mower that leaves the least error, and that error [m/s]; infinite where none may be flown."""
    mowers = lawn_mowers(mapping)
    begins = np.concatenate(
        [np.full((len(mowers.ends), 1), mapping.start), mowers.ends[:, :-1]], axis=1
    )
    legs = scene.allowed(begins.ravel(), mowers.ends.ravel()).reshape(mowers.ends.shape)
    errors = np.where(np.all(legs, axis=1), mapping.errors(mowers), np.inf)
    k = int(np.argmin(errors))
    return mowers.picked([k]), float(errors[k])


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


def realised(
    sea: Sea,
    flown: Sequence[Flown],
    noise: Array,
    given: Sequence[tuple[Array, Array]] = (),
) -> Array:
    """Return the root mean square error of a component in the box after surveys flown in each true current [m/s], shape (S,).

    Args:
        sea: What they are flown in; its currents are means over the dives.
        flown: The same map of the dives' mean alone as each vehicle has it, and the vehicle's survey; one at least.
        noise: shape (S, N, 2) of unit variance, errors of the profiles of all surveys in turn; without any (N = 0) none is flown.
        given: Profiles that others bring: places, shape (m, 2) [m], and times, shape (m,) [s].
    """
    first, _ = flown[0]
    end, error = float(first.times[-1]), float(np.sqrt(first.variance))
    box = first.box[:, 0] + 1j * first.box[:, 1]
    true = sea.truth.at(np.broadcast_to(box, (sea.count, box.size)), end) - sea.mean.at(
        box[None], end
    )
    left = np.stack([true.real, true.imag], axis=-1)
    measured, values = from_others(sea, error, given)
    begun = 0
    for mapping, survey in flown if noise.shape[1] else ():
        begin = float(mapping.times[0])
        stretch = Stretch(mapping.start, box[:1], begin, end - begin, 0.0, mapping.speed, 0.0)
        places, met, _ = fly_survey(sea, stretch, survey)
        means = [
            sea.mean.at(one[None], time)[0]
            for one, time in zip(places.T, survey.times, strict=True)
        ]
        found = met - np.stack(means, axis=1)
        own = np.stack([found.real, found.imag], axis=-1)
        own = own + error * noise[:, begun : begun + survey.times.size]
        begun += survey.times.size
        rows = rows_at(mapping.known, np.stack([places.real, places.imag], axis=-1), survey.times)
        measured = rows if measured is None else stacked(rows, measured)
        values = np.concatenate([own.reshape(sea.count, -1), values], axis=1)
    if measured is not None:
        left = left - estimated(first, measured, values)
    return np.asarray(np.sqrt(np.mean(left**2, axis=(1, 2))))


def estimated(mapping: Mapping, rows: Rows, values: Array) -> Array:
    """Return the box's currents less the estimate's after measurements, shape (S, P, 2), at the end, of the dives' mean."""
    sought = rows_at(mapping.known, mapping.box, np.full(len(mapping.box), mapping.times[-1]))
    weighed = gains(rows, values, mapping.variance)
    return (covariance(sought, rows) @ weighed[..., None]).reshape(len(values), -1, 2)


def _interval(errors: Array) -> tuple[float, float, float]:
    """Return the root mean square of errors, shape (S,), and an interval that holds it with a probability of 90 %, by bootstrap."""
    square = errors**2
    return float(np.sqrt(square.mean())), *bootstrap_interval(
        lambda drawn: np.sqrt(square[drawn].mean(axis=1)), errors.size, _RESAMPLES
    )


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
        figures={"samples": samples, "surfacings": int(survey.times.size)},
    )


def compared(
    scene: Scene, named: dict[str, tuple[float, Sequence[Flown]]]
) -> tuple[tuple[Candidate, ...], tuple[str, ...]]:
    """Return surveys with their errors in samples, and a note where there are none.

    Samples are of the dives' mean: of other depths the prediction stands alone.

    Args:
        scene: Of a vehicle.
        named: Of each its predicted error [m/s], infinite where it may not be flown, and what each vehicle maps and flies; the last one
            is the plan.
    """
    *_, (_, flown) = named.values()
    (mapping, _), settings, sea = flown[0], scene.settings, None
    if mapping.which == (0,):
        span = slices(scene.known, scene.begin, float(mapping.times[-1]))
        sea = drawn_sea(scene.known, span, settings.samples, settings.seed)
    rng, count = np.random.default_rng(settings.seed + 1), sum(one.times.size for _, one in flown)
    noise = rng.standard_normal((settings.samples, count, 2))

    def candidate(name: str, predicted: float, made: Sequence[Flown]) -> Candidate:
        figures = (np.nan,) * 3
        if sea is not None:
            errors = realised(sea, made or flown, noise if made else noise[:, :0], scene.given)
            figures = _interval(errors)
        return Candidate(name, predicted, *figures, np.nan, name == list(named)[-1])

    found = tuple(candidate(name, *one) for name, one in named.items() if np.isfinite(one[0]))
    note = "no errors in samples: these are of the mean current over the dives, and the box counts at depths"
    return found, () if sea is not None else (note,)
