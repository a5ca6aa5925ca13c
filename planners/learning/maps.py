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
    if request.profiles < 1:
        raise PlanError(f"profiles of a map: expected 1 or more, got {request.profiles}")
    scene = scene_of(flow, request, None, box.depths)
    places, counted = _places(scene, box)
    times: Array = scene.begin + scene.leg_time * np.arange(request.profiles + 1, dtype=np.float64)
    which = tuple(range(1, len(box.depths) + 1)) or (0,)
    given = scene.aim(Combined(rows_at(scene.known, places[:1], times[-1:]), np.eye(2))).given
    mapping = Mapping(
        scene.known,
        scene.mean,
        places,
        which,
        scene.start,
        times,
        scene.speed,
        scene.settings.error**2,
        given,
    )
    before = mapping.before()
    if before <= 0.5 * scene.settings.error:
        raise PlanError(
            f"no uncertainty is left to reduce: the current in the box is known to {before:.3f} m/s, and a profile errs by "
            f"{scene.settings.error:g} m/s; choose another box"
        )
    survey, after, mower, mower_error, is_mower = choose_map(scene, mapping)
    notes = (
        ()
        if counted > 0.99
        else (
            f"{100.0 * (1.0 - counted):.0f} % of the box lie outside of the region or on land and do not count",
        )
    )
    return _plan(scene, request, (mapping, survey, after), (mower, mower_error, is_mower), notes)


def choose_map(scene: Scene, mapping: Mapping) -> tuple[Survey, float, Survey, float, bool]:
    """Return the survey and its error, the best lawn-mower and its error, and whether that is the survey.

    Raises:
        PlanError: No leg may be flown.
    """
    ahead = look_ahead(mapping, scene.allowed, covariance_now(scene, mapping))
    mowers = lawn_mowers(mapping)
    begins = np.concatenate(
        [np.full((len(mowers.ends), 1), mapping.start), mowers.ends[:, :-1]], axis=1
    )
    free: NDArray[np.bool_] = np.asarray(
        np.all(
            scene.allowed(begins.ravel(), mowers.ends.ravel()).reshape(mowers.ends.shape), axis=1
        )
    )
    errors = np.where(free, mapping.errors(mowers), np.inf)
    k = int(np.argmin(errors))
    mower, mower_error = mowers.picked([k]), float(errors[k])
    tried = [
        refined(mapping, scene.allowed, one, scene.settings.seed)
        for one in ([ahead, mower] if free[k] else [ahead])
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


def realised(
    sea: Sea,
    mapping: Mapping,
    survey: Survey | None,
    noise: Array,
    given: Sequence[tuple[Array, Array]] = (),
) -> Array:
    """Return the root mean square error of a component in the box after a survey flown in each true current [m/s], shape (S,).

    Args:
        sea: What it is flown in; its currents are means over the dives.
        mapping: What is to be mapped; of the dives' mean alone.
        survey: One; None for none.
        noise: shape (S, N, 2) of unit variance, errors of the profiles.
        given: Profiles that others bring: places, shape (m, 2) [m], and times, shape (m,) [s].
    """
    end = float(mapping.times[-1])
    box = mapping.box[:, 0] + 1j * mapping.box[:, 1]
    true = sea.truth.at(np.broadcast_to(box, (sea.count, box.size)), end) - sea.mean.at(
        box[None], end
    )
    left = np.stack([true.real, true.imag], axis=-1)
    measured, values = from_others(sea, float(np.sqrt(mapping.variance)), given)
    if survey is not None:
        stretch = Stretch(
            mapping.start,
            box[:1],
            float(mapping.times[0]),
            end - float(mapping.times[0]),
            0.0,
            mapping.speed,
            0.0,
        )
        places, met, _ = fly_survey(sea, stretch, survey)
        found = met - np.stack(
            [
                sea.mean.at(one[None], time)[0]
                for one, time in zip(places.T, survey.times, strict=True)
            ],
            axis=1,
        )
        own = np.stack([found.real, found.imag], axis=-1) + np.sqrt(mapping.variance) * noise
        rows = rows_at(mapping.known, np.stack([places.real, places.imag], axis=-1), survey.times)
        measured = rows if measured is None else stacked(rows, measured)
        values = np.concatenate([own.reshape(sea.count, -1), values], axis=1)
    if measured is not None:
        left = left - estimated(mapping, measured, values)
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


def _plan(
    scene: Scene,
    request: LearnRequest,
    chosen: tuple[Mapping, Survey, float],
    peer: tuple[Survey, float, bool],
    notes: tuple[str, ...],
) -> LearnPlan:
    """Return the plan with its message, its evidence and its track."""
    (mapping, survey, after), (mower, mower_error, is_mower) = chosen, peer
    before = mapping.before()
    candidates, count, more = _compared(
        scene,
        mapping,
        {
            "no profiles": (before, None),
            "the best lawn-mower": (mower_error, mower),
            "this plan": (after, survey),
        },
    )
    legs, times, track = dives_of(scene, scene.start, survey.ends[0], mapping.times)
    words = f"{request.profiles} profiles reduce the error of the current in the box from {before:.3f} to {after:.3f} m/s"
    words += (
        " along a lawn-mower, than which nothing better was found"
        if is_mower
        else f"; the best lawn-mower to {mower_error:.3f} m/s"
    )
    sought = mapping.sought()
    combined = Combined(sought, np.eye(len(sought.now)) / np.sqrt(len(sought.now)))
    aim = Aim(scene.known, combined, mapping.variance, mapping.given)
    box = mapping.box[:, 0] + 1j * mapping.box[:, 1]
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
        before=before,
        after=after,
        candidates=candidates,
        value=value_map(scene, aim, float(mapping.profile_times[0]), box, "m/s"),
        found_name="error in the box",
        unit="m/s",
        notes=(*notes, *more),
        figures={"samples": count, "surfacings": int(survey.times.size)},
    )


def _compared(
    scene: Scene, mapping: Mapping, named: dict[str, tuple[float, Survey | None]]
) -> tuple[tuple[Candidate, ...], int, tuple[str, ...]]:
    """Return surveys with their errors in samples, how many these are, and a note where there are none.

    Samples are of the dives' mean: of other depths the prediction stands alone.
    """
    settings, sea = scene.settings, None
    if mapping.which == (0,):
        span = slices(scene.known, scene.begin, float(mapping.times[-1]))
        sea = drawn_sea(scene.known, span, settings.samples, settings.seed)
    *_, (_, last) = named.values()
    assert last is not None, "the last survey is the plan's"
    rng = np.random.default_rng(settings.seed + 1)
    noise = rng.standard_normal((settings.samples, last.times.size, 2))

    def candidate(name: str, predicted: float, survey: Survey | None) -> Candidate:
        figures = (
            (np.nan,) * 3
            if sea is None
            else _interval(realised(sea, mapping, survey, noise, scene.given))
        )
        return Candidate(name, predicted, *figures, np.nan, name == "this plan")

    found = (candidate(name, *one) for name, one in named.items() if np.isfinite(one[0]))
    if sea is not None:
        return tuple(found), settings.samples, ()
    note = "no errors in samples: these are of the mean current over the dives, and the box counts at depths"
    return tuple(found), 0, (note,)
