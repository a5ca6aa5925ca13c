"""Predictions of coming observations by the filter, and of bins withheld from a profile whose other bins are given."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Flag, Innovation, Measurement, Observation
from replay_kit.estimator.evolving import EvolvingEstimator, EvolvingState
from replay_kit.estimator.evolving.observation_operator import LinearObservation

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
