"""What a map's plan is compared with: lawn-mowers drawn in its box; and what all of them are worth in samples."""

from collections.abc import Sequence

import numpy as np

from planners.front.current import Complex
from planners.learning.closed_loop import Sea, Stretch, drawn_sea, fly_survey, from_others, slices
from planners.learning.loops import Survey
from planners.learning.mapping import COUNTED, Mapping
from planners.learning.rows import Rows, covariance, gains, rows_at, stacked
from planners.learning.scene import Scene
from planners.learning.values import Candidate
from replay_kit.core.arrays import Array
from replay_kit.core.evidence import bootstrap_interval

#: What is to be mapped as a vehicle has it, and the survey that it flies.
Flown = tuple[Mapping, Survey]
# Most lanes of a lawn-mower; resamples of an interval.
_LANES, _RESAMPLES = 8, 400


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


def lawn_mowers(mapping: Mapping) -> Survey:
    """Return lawn-mowers through the box from the start, by the number, direction and side of their lanes; each goes on to and fro.

    Args:
        mapping: What is to be mapped.
    """
    low, high = mapping.box.min(axis=0), mapping.box.max(axis=0)
    tracks = []
    for lanes in range(1, _LANES + 1):
        for turned in (False, True):
            for first in (False, True):
                for side in (False, True):
                    tracks.append(_mower(low, high, lanes, (turned, first, side)))
    ways = [_spaced(mapping, corners) for corners in tracks]
    middles, ends = np.array([one[0] for one in ways]), np.array([one[1] for one in ways])
    return Survey(ends, ends, middles, mapping.profile_times, np.ones(len(ends), dtype=bool))


def _mower(low: Array, high: Array, lanes: int, turns: tuple[bool, bool, bool]) -> Complex:
    """Return the corners of a lawn-mower over a box; lanes lie in the middle of their strips."""
    turned, first, side = turns
    across = (np.arange(lanes) + 0.5) / lanes
    across = across[::-1] if first else across
    # lanes end half a strip from the box's edge, but where the box is short
    inset = min(0.5 / lanes, 0.25)
    corners = []
    for k, share in enumerate(across):
        ends = (inset, 1.0 - inset) if (k % 2 == 0) != side else (1.0 - inset, inset)
        corners += [(along, share) if not turned else (share, along) for along in ends]
    unit = np.array(corners)
    places = low + unit * (high - low)
    return places[:, 0] + 1j * places[:, 1]


def _spaced(mapping: Mapping, corners: Complex) -> tuple[Complex, Complex]:
    """Return middles and ends of the legs along a track from the start past corners, to and fro, in the current that is known."""
    track = np.concatenate(
        [[mapping.start], corners, corners[-2::-1], corners[1:], corners[-2::-1]]
    )
    middles, ends, place, next_corner = list[complex](), list[complex](), mapping.start, 1
    for step in range(mapping.times.size - 1):
        left = float(mapping.times[step + 1] - mapping.times[step])
        begin = place
        while left > 0.0 and next_corner < track.size:
            way = complex(track[next_corner]) - place
            if abs(way) < 1.0:
                next_corner += 1
                continue
            speed = _over_ground(mapping, place, way / abs(way), float(mapping.profile_times[step]))
            spent = min(left, abs(way) / speed)
            place, left = place + way / abs(way) * speed * spent, left - spent
            next_corner += spent * speed >= abs(way) - 1e-6
        middles.append(0.5 * (begin + place))
        ends.append(place)
    return np.array(middles), np.array(ends)


def _over_ground(mapping: Mapping, place: complex, direction: complex, time: float) -> float:
    u = complex(mapping.mean.at(np.array([place]), time)[0]) * direction.conjugate()
    return max(float(np.sqrt(max((COUNTED * mapping.speed) ** 2 - u.imag**2, 0.0))) + u.real, 0.02)


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
