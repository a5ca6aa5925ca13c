"""Methods that answer records of dives: baselines, the models of ``estimator/next_dive``, and those on an ensemble's estimate.

A method makes what is asked the records of one task on one mission, in order, and remembers what it needs.
"""

from collections.abc import Callable, Sequence

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.next_dive.filter import DiveMean
from replay_kit.estimator.next_dive.mixtures import Persistence
from replay_kit.estimator.next_dive.process import MeanCurrentProcess
from replay_kit.estimator.next_dive.profiles import Bins, ColumnModel
from replay_kit.studies.bench.missions import Dive
from replay_kit.studies.bench.records import Answer, Record

_NOTHING = np.empty((0, 2))


#: What answers the records of one task on one mission.
Entry = Callable[[Record], Answer]


class LastDive:
    """The last dive's mean current, or current by depth; the baseline that stands in for missing answers."""

    def __init__(self) -> None:
        """Begin before the first dive."""
        self._persistence = Persistence()

    def __call__(self, record: Record) -> Answer:
        """Return the last dive's, with the size of changes so far as its error."""
        for dive in record.given:
            if dive.mean is not None:
                self._persistence = self._persistence.after(dive.mean)
        if record.target.depth.size:
            last = next((dive for dive in reversed(record.known) if dive.depth.size), None)
            return Answer(_at_depths([] if last is None else [last], record))
        known = self._persistence
        if known.velocity is None:
            return Answer(np.zeros((1, 2)))
        if not known.changes or known.squares == 0.0:
            return Answer(known.velocity[None])
        std = np.full((1, 2), np.sqrt(0.5 * known.squares / known.changes))
        return Answer(known.velocity[None], std, known)


def mean_so_far(record: Record) -> Answer:
    """Return the mean of all dives so far, at each depth where a profile is asked."""
    if record.target.depth.size:
        return Answer(_at_depths(record.known, record))
    return Answer(_mean([dive.mean for dive in record.known]))


def last_here(record: Record) -> Answer:
    """Return the mean current of the dive that began nearest to this one, but for the two before it."""
    before = [dive for dive in record.known[:-2] if dive.mean is not None]
    known = before[::-1] or [*record.known[-1:]]
    if not known:
        return Answer(np.zeros((1, 2)))
    (longitude, latitude), narrower = (
        record.target.place,
        np.cos(np.deg2rad(record.target.place[1])),
    )
    off = [
        np.hypot(narrower * (dive.place[0] - longitude), dive.place[1] - latitude) for dive in known
    ]
    return Answer(_mean([known[int(np.argmin(off))].mean]))


def last_mean(record: Record) -> Answer:
    """Return the last mean current at all depths; the dive's own where it is known."""
    own = [] if record.target.mean is None else [record.target.mean]
    means = own or [dive.mean for dive in record.known if dive.mean is not None][-1:]
    return Answer(np.tile(_mean(means), (record.target.depth.size, 1)))


def zero(record: Record) -> Answer:
    """Return no current."""
    return Answer(np.zeros_like(record.truth))


def _mean(means: Sequence[Array | None]) -> Array:
    known = [mean for mean in means if mean is not None]
    return np.mean(known, axis=0)[None] if known else np.zeros((1, 2))


def _at_depths(dives: Sequence[Dive], record: Record) -> Array:
    """Return the mean of dives' bins at the depths asked: linear between cells as thick as bins are apart, the nearest beyond."""
    depth = np.concatenate([np.empty(0), *(dive.depth for dive in dives)])
    if not depth.size:
        return np.zeros((record.target.depth.size, 2))
    velocity = np.concatenate([dive.velocity for dive in dives])
    apart = np.abs(np.concatenate([np.diff(dive.depth) for dive in dives]))
    width = float(np.median(apart[apart > 0.0])) if np.any(apart > 0.0) else 1.0
    cell = np.round((depth - depth.min()) / width).astype(np.int64)
    _, of_bin, count = np.unique(cell, return_inverse=True, return_counts=True)
    sums = [np.bincount(of_bin, weights=values) / count for values in (depth, *velocity.T)]
    return np.column_stack([np.interp(record.target.depth, sums[0], each) for each in sums[1:]])


class Process:
    """The process of mean currents, about nothing or about an ensemble's backgrounds as in a replay."""

    def __init__(self, n_backgrounds: int = 0) -> None:
        """Begin before the first dive."""
        self._model = MeanCurrentProcess.default(n_backgrounds)
        self._state = self._model.initial()
        self._backgrounds: dict[int, Array] = {}
        self._ways = Persistence()

    def __call__(self, record: Record) -> Answer:
        """Return the mixture of the settings."""
        for dive in record.given:
            if dive.mean is not None:
                self._state = self._model.step(self._state, self._dive_mean(dive, dive.mean))
            if dive.way is not None:
                self._ways = self._ways.after(dive.way)
        if record.backgrounds is not None:
            self._backgrounds[record.target.number] = record.backgrounds[:, 0]
        target = self._dive_mean(record.target, np.zeros(2))
        return Answer.of_mixture(self._model.forecast(self._state, target))

    def _dive_mean(self, dive: Dive, mean: Array) -> DiveMean:
        way, way_std = dive.way, 0.0
        if way is None and self._ways.velocity is not None:
            # the last way, with the changes so far as its error
            way = self._ways.velocity
            way_std = float(np.sqrt(0.5 * self._ways.squares / max(self._ways.changes, 1)))
        return DiveMean(
            (dive.begin_ns + dive.end_ns) // 2,
            dive.seconds,
            np.zeros(2) if way is None else way,
            0.0,
            mean,
            dive.inverted,
            backgrounds=self._backgrounds.get(dive.number, _NOTHING),
            way_std=way_std,
        )


class ByDepth:
    """The model of the current by depth, about nothing or about an ensemble's estimate as in a replay."""

    def __init__(self, n_backgrounds: int = 0) -> None:
        """Begin before the first dive."""
        self._n_backgrounds = n_backgrounds
        self._model: ColumnModel | None = None
        self._about: dict[int, Array] = {}

    def __call__(self, record: Record) -> Answer:
        """Return the mean at each depth of what stays from dive to dive, with errors."""
        if self._model is None:
            deepest = max(dive.depth.max(initial=0.0) for dive in (*record.known, record.target))
            self._model = ColumnModel.default(1.25 * float(deepest), self._n_backgrounds)
            self._state = self._model.initial()
        for dive in record.given:
            if dive.depth.size:
                bins = self._bins(dive, dive.velocity)
                self._state = self._model.step(self._state, bins)
        if record.backgrounds is not None:
            self._about[record.target.number] = np.nan_to_num(record.backgrounds[1:])
        asked = self._bins(record.target, np.zeros_like(record.truth))
        expected, std = self._model.forecast(self._state, asked)
        if record.target.mean is not None:
            # the dive's own mean current is known
            expected = expected - expected.mean(axis=0) + record.target.mean
        return Answer(expected, std)

    def _bins(self, dive: Dive, velocity: Array) -> Bins:
        nothing = np.zeros((self._n_backgrounds, *velocity.shape))
        return Bins(dive.depth, velocity, self._about.get(dive.number, nothing))


class Background:
    """What an ensemble says of dives: the forecast alone, and the estimate after what is known."""

    def __init__(self, estimator: EvolvingEstimator) -> None:
        """Begin before the first measurement."""
        self._estimator, self._state = estimator, estimator.initial()

    def of(self, record: Record) -> Array:
        """Return the current asked of a record by both, shape (2, n, 2) [m/s]; NaN where they say nothing."""
        for dive in record.given:
            for measurement in dive.given:
                self._state, _ = self._estimator.step(self._state, measurement)
        return np.stack(
            [
                _asked(self._estimator.flow(state).at(record.target.begin_ns), record)
                for state in (self._estimator.initial(), self._state)
            ]
        )


def _asked(flow: FlowEstimate, record: Record) -> Array:
    target = record.target
    if target.depth.size:
        return _along(flow, target.at[:, 0], target.at[:, 1], target.depth)
    assert target.path is not None
    along = _along(flow, target.path.longitude, target.path.latitude, target.path.depth)
    return np.asarray(target.path.weight @ along)[None]


def _along(flow: FlowEstimate, longitude: Array, latitude: Array, depth: Array) -> Array:
    found = flow.velocity_at(longitude, latitude, depth)
    return np.column_stack([found.u, found.v])


def background(which: int) -> Callable[[Record], Answer]:
    """Return the method that is a background alone: 0 the forecast, 1 the estimate of the filter."""

    def answer(record: Record) -> Answer:
        assert record.backgrounds is not None
        return Answer(np.nan_to_num(record.backgrounds[which]))

    return answer


#: Methods of mean currents and of currents by depth; each makes what answers one task on one mission.
MEAN_METHODS: dict[str, Callable[[], Entry]] = {
    "process": Process,
    "last_dive": LastDive,
    "mean_so_far": lambda: mean_so_far,
    "last_here": lambda: last_here,
    "zero": lambda: zero,
}
PROFILE_METHODS: dict[str, Callable[[], Entry]] = {
    "by_depth": ByDepth,
    "last_dive": LastDive,
    "mean_so_far": lambda: mean_so_far,
    "last_mean": lambda: last_mean,
    "zero": lambda: zero,
}
#: Those that need an ensemble.
ENSEMBLE_METHODS: dict[str, Callable[[], Entry]] = {
    "filter": lambda: background(1),
    "forecast": lambda: background(0),
}


def methods_of(profiles: bool, with_ensemble: bool) -> dict[str, Callable[[], Entry]]:
    """Return the methods that can do a task.

    Args:
        profiles: Whether currents by depth are asked.
        with_ensemble: Whether there is one.
    """
    known = PROFILE_METHODS if profiles else MEAN_METHODS
    if not with_ensemble:
        return dict(known)
    joint: Callable[[], Entry] = (lambda: ByDepth(1)) if profiles else (lambda: Process(2))
    return {"estimate": joint, **known, **ENSEMBLE_METHODS}
