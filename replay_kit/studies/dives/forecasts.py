"""Predictions of the next dive: by the filter, by the models of ``estimator/next_dive`` as in a replay, and by baselines."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_local
from replay_kit.core.observation import Flag, Innovation, Measurement, Observation, PathMean, usable
from replay_kit.core.surfacing import DiveOutcome
from replay_kit.estimator.evolving import EvolvingEstimator, EvolvingState
from replay_kit.estimator.evolving.observation_operator import LinearObservation
from replay_kit.estimator.next_dive.profiles import Bins, ColumnModel, ColumnState, joined
from replay_kit.estimator.update.screening import local_mean
from replay_kit.studies.dives.read import Dive
from replay_kit.workflows.replay.surfacings.forecasts import (
    ForecastState,
    backgrounds_of,
    forecast_mean,
    with_profile,
)

_EVERY = 4


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Measured values against predicted ones, usable bins only.

    Attributes:
        used: shape (n,), positions of the bins in the observation.
        error: shape (n, 2) [m/s], measured minus expected; local axes.
        std: shape (n, 2) [m/s], of that: of the estimate, the bin's own error, and what the basis cannot show.
        cov: shape (2 n, 2 n), covariance of all, east before north.
        nis: Normalised square of the error.
        dof: Its degrees of freedom.
    """

    used: NDArray[np.intp]
    error: Array
    std: Array
    cov: Array
    nis: float
    dof: int


def expect(
    estimator: EvolvingEstimator, state: EvolvingState, observation: Measurement
) -> Expected | None:
    """Return an observation against a state's prediction of it; None where none of its bins can be used."""
    # without gate and inflation the prediction is compared as it is
    candidate = replace(estimator, gating=None).candidate(state, observation)
    if isinstance(candidate, Innovation):
        return None
    seen, predicted = candidate.rows, candidate.evaluated.predicted
    rows, residual = seen.compress(seen.values)
    error = seen.residual(predicted.mean)
    cov = bin_covariance(seen, predicted.cov)
    std = np.sqrt(np.diag(cov)).reshape(2, -1).T
    return Expected(
        candidate.screened.used,
        error,
        std,
        cov,
        predicted.normalised_square(rows - predicted.mean)[0] + residual,
        seen.dof,
    )


def bin_covariance(seen: LinearObservation, cov: Array) -> Array:
    """Return the covariance of bins with their errors, shape (2 n, 2 n), east before north, from that of their rows without."""
    bins = np.kron(np.eye(2), seen.noise.unwhiten @ seen.q)
    own = np.kron(np.eye(2), seen.noise.unwhiten @ seen.noise.unwhiten.T)
    return np.asarray(bins @ cov @ bins.T + own)


def conditional(error: Array, cov: Array, known: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the other errors less their expectation given some that are known, and the standard deviation of the rest.

    Args:
        error: shape (m,).
        cov: shape (m, m).
        known: shape (m,).
    """
    factor = scipy.linalg.cho_factor(cov[np.ix_(known, known)], lower=True)
    cross = cov[np.ix_(~known, known)]
    variance = np.diag(cov)[~known] - np.einsum(
        "ij,ji->i", cross, scipy.linalg.cho_solve(factor, cross.T)
    )
    return error[~known] - cross @ scipy.linalg.cho_solve(factor, error[known]), np.sqrt(variance)


def withheld(
    estimator: EvolvingEstimator, state: EvolvingState, profiles: Sequence[Observation]
) -> Iterator[tuple[Array, Array]]:
    """Yield, for each profile of a dive, error and standard deviation of every fourth bin, from its other bins and the profiles before.

    The bins' own errors and what the basis cannot show are in both: a bin's error may go with its neighbours'.

    Args:
        estimator: Makes the prediction.
        state: At the dive's beginning.
        profiles: Of the dive, absolute; of each only the bins that are not withheld count.
    """
    for profile in profiles:
        expected = expect(estimator, state, profile)
        if expected is None or expected.used.size <= _EVERY:
            continue
        kept = np.arange(expected.used.size) % _EVERY != _EVERY - 1
        yield conditional(expected.error.T.ravel(), expected.cov, np.tile(kept, 2))
        flags = profile.flags.copy()
        flags[expected.used[~kept]] = Flag.NOT_EVALUATED
        state, _ = estimator.step(state, replace(profile, flags=flags))


#: Profiles with a bin that the filter can use, and its predictions of them.
Usable = Sequence[tuple[Observation, Expected]]


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
    usable: Usable,
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
    """Return what the prior forecast and the filter say of a mean current, shape (2, 2) [m/s], true east and north."""
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
