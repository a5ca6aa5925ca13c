"""The next dive as a replay expects it: the models of ``estimator/next_dive``, with the filter's own prediction as what they are about."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_local
from replay_kit.core.observation import Observation, PathMean, usable
from replay_kit.core.surfacing import DiveOutcome
from replay_kit.estimator.evolving import EvolvingEstimator, EvolvingState
from replay_kit.estimator.next_dive.profiles import Bins, ColumnModel, ColumnState, joined
from replay_kit.estimator.update.screening import local_mean
from replay_kit.studies.dives.predict import Expected
from replay_kit.studies.dives.read import Dive
from replay_kit.workflows.replay.dive_forecasts import (
    ForecastState,
    backgrounds_of,
    forecast_mean,
    with_profile,
)


@dataclass(frozen=True, slots=True, eq=False)
class NextDive:
    """What the dives so far say of the next one.

    Attributes:
        model: Of the current by depth.
        columns: Its state.
        means: State of the model of mean currents.
    """

    model: ColumnModel
    columns: ColumnState
    means: ForecastState


@dataclass(frozen=True, slots=True, eq=False)
class DiveForecasts:
    """What was expected of a dive.

    Attributes:
        error: shape (n, 2) [m/s], of all its bins, measured minus expected; local axes.
        std: shape (n, 2) [m/s], of that.
        outcome: Of its mean current and its surfacing; None without a mean current between fixes.
    """

    error: Array
    std: Array
    outcome: DiveOutcome | None

    @property
    def mean_error(self) -> Array | None:
        """Measured mean current minus the expected one, shape (1, 2) [m/s], true east and north; None without."""
        if self.outcome is None:
            return None
        seconds = (self.outcome.fix.time_ns - self.outcome.forecast.start.time_ns) * 1e-9
        return np.array([self.outcome.off]) / seconds


def before_dives(dives: Sequence[Dive]) -> NextDive:
    """Return what is known before the first of some dives."""
    deepest = max(
        (
            float(profile.depth.max())
            for dive in dives
            for profile in dive.profiles
            if profile.depth.size
        ),
        default=0.0,
    )
    model = ColumnModel.default(deepest, 1)
    return NextDive(model, model.initial(), ForecastState())


def after_dive(
    before: NextDive,
    estimator: EvolvingEstimator,
    state: EvolvingState,
    dive: Dive,
    usable: Sequence[tuple[Observation, Expected]],
) -> tuple[NextDive, DiveForecasts]:
    """Return what is known after a dive, and what was expected of it.

    Args:
        before: Of the dives before.
        estimator: The filter.
        state: Its state before the dive.
        dive: The dive.
        usable: Its profiles with a bin that the filter can use, with the filter's predictions.
    """
    parts = [_bins(estimator, profile, found) for profile, found in usable]
    error, std, columns = np.empty((0, 2)), np.empty((0, 2)), before.columns
    if parts:
        bins = joined(parts)
        expected, std = before.model.forecast(columns, bins)
        error, columns = bins.velocity - expected, before.model.step(columns, bins)
    means, outcome = before.means, None
    for profile in dive.profiles:
        means = with_profile(means, profile)
    if dive.mean is not None:
        means, outcomes = forecast_mean(means, dive.mean, _of_mean(estimator, state, dive.mean))
        outcome = outcomes[0] if outcomes else None
    return replace(before, columns=columns, means=means), DiveForecasts(error, std, outcome)


def _bins(estimator: EvolvingEstimator, profile: Observation, found: Expected) -> Bins:
    projection = estimator.basis.grid.projection
    velocity = np.column_stack(
        rotate_to_local(
            projection, profile.longitude, profile.latitude, *profile.velocity[found.used].T
        )
    )
    return Bins(profile.depth[found.used], velocity, (velocity - found.error)[None])


def _of_mean(estimator: EvolvingEstimator, state: EvolvingState, mean: PathMean) -> Array:
    """Return what the ensemble alone and the filter say of a mean current, shape (2, 2) [m/s], true east and north."""
    errors = [estimator.innovation(each, mean) for each in (estimator.initial(), state)]
    return backgrounds_of(mean, local_mean(mean, estimator.basis.grid.projection)[0], errors)


#: Baselines of a dive's profile, in the order of the tables.
PROFILE_BASELINES = ("last_dive", "last_leg", "last_dac", "mean_so_far", "zero")


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """A current by depth.

    Attributes:
        depth: shape (k,) [m], increasing.
        velocity: shape (k, 2) [m/s], true east and north.
    """

    depth: Array
    velocity: Array

    def at(self, depth: Array) -> Array:
        """Return the current at depths, shape (n, 2): linear between those known, the nearest beyond."""
        return np.column_stack(
            [np.interp(depth, self.depth, component) for component in self.velocity.T]
        )


def column(profiles: Sequence[Observation]) -> Column | None:
    """Return the mean of profiles at each depth, in cells as thick as the profiles' bins are apart; None without a usable bin."""
    bins = [usable(profile.flags) for profile in profiles]
    if not any(used.any() for used in bins):
        return None
    depth = np.concatenate(
        [profile.depth[used] for profile, used in zip(profiles, bins, strict=True)]
    )
    velocity = np.concatenate(
        [profile.velocity[used] for profile, used in zip(profiles, bins, strict=True)]
    )
    apart = np.concatenate([np.diff(np.sort(profile.depth)) for profile in profiles])
    width = float(np.median(apart[apart > 0.0])) if np.any(apart > 0.0) else 1.0
    cell = np.round((depth - depth.min()) / width).astype(np.int64)
    _, of_bin, count = np.unique(cell, return_inverse=True, return_counts=True)
    sums = [np.bincount(of_bin, weights=values) / count for values in (depth, *velocity.T)]
    return Column(sums[0], np.column_stack(sums[1:]))


def baseline_profiles(before: Sequence[Dive], depth: Array) -> dict[str, Array]:
    """Return what each baseline predicts of a profile, shape (n, 2) [m/s], true east and north; without those that lack data.

    ``last_dive`` is the mean at each depth of the last dive's profiles, ``last_leg`` that of its last leg, ``last_dac`` its
    depth-averaged current, ``mean_so_far`` the mean at each depth of all profiles.

    Args:
        before: The dives before, at least one.
        depth: shape (n,) [m].
    """
    last, zero = before[-1], np.zeros((depth.size, 2))
    profiles = {
        "last_dive": last.profiles,
        "last_leg": last.legs[1] or last.legs[0],
        "mean_so_far": [profile for dive in before for profile in dive.profiles],
    }
    columns = {name: column(given) for name, given in profiles.items()}
    predicted = {name: known.at(depth) for name, known in columns.items() if known is not None}
    means = {
        name: zero + mean for name, mean in baseline_means(before).items() if name != "mean_so_far"
    }
    return {
        name: (means | predicted)[name] for name in PROFILE_BASELINES if name in means | predicted
    }


def baseline_means(before: Sequence[Dive]) -> dict[str, Array]:
    """Return what each baseline predicts of a depth-averaged current, shape (1, 2) [m/s]; without those that lack data."""
    known = [np.array([dive.mean.velocity]) for dive in before if dive.mean is not None]
    predicted = {} if before[-1].mean is None else {"last_dac": known[-1]}
    if known:
        predicted["mean_so_far"] = np.mean(known, axis=0)
    return predicted | {"zero": np.zeros((1, 2))}
