"""The state of the static estimator, and the amplitudes of the prior that a log teaches it.

**Covariance.** The first fit is to members left out. Measurements of the log follow, profiles and mean currents: after 8, 16 and 32 of them
that lie apart, and then a few times up to 128, the amplitude is fitted to their innovations from the prior alone, centred on the first fit,
and all measurements so far are assimilated again under it. An estimate is thus never made with an amplitude that later measurements had a
part in. Measurements within half a cell, in which no grid has structure, repeat one innovation of the prior, so they count once.

One factor cannot be right at all scales: fields of other times differ by more at large scales than a forecast errs there, and by less at
small ones. So three bands of modes have amplitudes of their own, which the first fits find; later ones keep their shares.

**Ensemble mean** (``prior/amplitude.py``). The posterior in observation space has the rows H and the Cholesky factor L of their covariance.
Another Gaussian of the amplitude changes that covariance by one outer product, and the innovations by a multiple of H m: nothing is
assimilated again.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array, replace
from replay_kit.core.observation import Measurement
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.prior.amplitude import (
    AmplitudePrior,
    MeanAmplitude,
    ScaledPrior,
    bands_of,
    fit_amplitude,
    fit_by_scale,
)
from replay_kit.estimator.prior.centre import member_shares
from replay_kit.estimator.prior.hybrid import HybridPrior, Prior
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.observation_space import ObservationSpacePosterior
from replay_kit.estimator.update.posterior import Posterior
from replay_kit.estimator.update.rows import Assimilation, Rows

# Numbers of measurements at which the amplitude is fitted.
_COUNTS = (8, 16, 32, 48, 64, 96, 128)
# Measurements that are kept for the next fit at most: a vehicle may stay at one place.
_MOST_KEPT = 1024
# Innovations that bands of modes are fitted to at most: later the bands keep their shares.
_MOST_BY_SCALE = 512
# Innovations that are fitted at most: the cost goes with the cube of their number, some seconds for so many.
_MOST_INNOVATIONS = 4096


@dataclass(frozen=True, slots=True, eq=False)
class SpreadFit:
    """The amplitude of the prior's covariance in a state.

    Attributes:
        amplitude: Factor on the covariance.
        expected: That of members left out.
        fitted_to: Number of measurements that it was fitted to; 0 for members left out.
        spacing: Least distance between measurements that count [m].
        apart: Those that count so far, with their places; of a group of profiles those accepted. None after the last fit.
        past: All measurements so far; None after the last fit.
        tilt: How many times as large the amplitude is in each band of modes, from large scales to small; empty before the first fit.
    """

    amplitude: float
    expected: float
    fitted_to: int
    spacing: float
    apart: tuple[tuple[Measurement | ProfileGroup, Array], ...] = ()
    past: tuple[Measurement | ProfileGroup, ...] | None = ()
    tilt: tuple[float, ...] = ()

    @property
    def is_due(self) -> bool:
        """Whether the amplitude is to be fitted now."""
        return len(self.apart) in _COUNTS and len(self.apart) > self.fitted_to

    def after(
        self,
        measurement: Measurement | ProfileGroup,
        place: Array | None,
        used: Measurement | ProfileGroup | None = None,
    ) -> "SpreadFit":
        """Return the same after a measurement.

        Args:
            measurement: The measurement, or a group of profiles.
            used: What of it was accepted; None for all.
            place: shape (2,) [m], local east and north, the middle of a path; None of what was not accepted.
        """
        if self.past is None:
            return self
        if len(self.past) == _MOST_KEPT:
            return self._ended()
        counts = place is not None and all(
            np.hypot(*(place - other)) >= self.spacing for _, other in self.apart
        )
        apart = (
            (*self.apart, (used or measurement, place))
            if counts and place is not None
            else self.apart
        )
        return replace(self, apart=apart, past=(*self.past, measurement))

    def fitted(self, prior: Prior, mean: Array, rows: Sequence[Rows]) -> "SpreadFit":
        """Return the same with the amplitude of the measurements that count; after the last fit nothing is kept.

        Args:
            prior: With an amplitude of one.
            mean: Its mean, shape (Z, r).
            rows: Of the measurements that count.
        """
        innovation = np.concatenate([each.y - each.matvec(mean) for each in rows])
        if innovation.size > _MOST_INNOVATIONS:
            return self._ended()
        design = np.concatenate([each.design() for each in rows]).reshape(-1, *mean.shape)
        if innovation.size <= _MOST_BY_SCALE:
            covariances = _by_band(prior, design)
            amplitude, tilt = fit_by_scale(innovation, covariances, self.expected)
        else:
            tilt, scaled = self.tilt, ScaledPrior(prior, 1.0, self.tilt)
            rows_of = design.reshape(len(design), -1)
            covariance = rows_of @ scaled.matvec(design).reshape(rows_of.shape).T
            amplitude = fit_amplitude(innovation, 0.5 * (covariance + covariance.T), self.expected)
        done = replace(self, amplitude=amplitude, tilt=tilt, fitted_to=len(self.apart))
        return done._ended() if done.fitted_to == _COUNTS[-1] else done

    def scale(self, prior: Prior) -> Prior:
        """Return a prior with the amplitudes."""
        return ScaledPrior(prior, self.amplitude, self.tilt)

    def _ended(self) -> "SpreadFit":
        return replace(self, apart=(), past=None)

    def __str__(self) -> str:
        """Return the amplitude and what it rests on."""
        rests_on = (
            f"{self.fitted_to} measurements of the log"
            if self.fitted_to
            else "members left out, no measurement of the log"
        )
        bands = ", ".join(f"{self.amplitude * each:.2f}" for each in self.tilt)
        by_scale = f" ({bands} from large scales to small)" if bands else ""
        return f"variance of the prior multiplied by {self.amplitude:.2f}{by_scale}, fitted to {rests_on}"


def _by_band(prior: Prior, design: Array) -> Array:
    """Return the covariance of rows, shape (m, Z, r), that the modes of two bands cause together, shape (b, b, m, m)."""
    band, n_rows = bands_of(prior), len(design)
    parts = [np.where(band == each, design, 0.0) for each in range(band.max() + 1)]
    crosses = [prior.matvec(part).reshape(n_rows, -1) for part in parts]
    covariances = np.array(
        [[part.reshape(n_rows, -1) @ cross.T for cross in crosses] for part in parts]
    )
    return np.asarray(0.5 * (covariances + covariances.transpose(1, 0, 3, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class FilterState(Assimilation):
    """The estimate of the weights at one time.

    Attributes:
        posterior: Of the weights, in the representation that is cheaper at the time.
        spread: Amplitude of the prior's covariance; None as it is given.
        mean_amplitude: Gaussian of the ensemble mean's amplitude, while it is averaged and after; None where its variance is given.
    """

    posterior: Posterior
    spread: SpreadFit | None = None
    mean_amplitude: MeanAmplitude | None = None

    @property
    def is_fitting(self) -> bool:
        """Whether the amplitude of the prior's covariance is still fitted to the log."""
        return self.spread is not None and self.spread.past is not None

    @property
    def mean(self) -> Array:
        """Mean of the weights, shape (Z r,), level after level; computed when first asked for."""
        return self.posterior.mean


def with_mean_averaged(state: FilterState, basis: Basis) -> FilterState:
    """Return the state after the average over the amplitude's variance, about a centre that is moved first, if it is time.

    Once the posterior is in another form, after a mean along a path or where the basis is small, the Gaussian stays as it is.

    Args:
        state: After a profile or a group of them.
        basis: Has the ensemble mean, unless its amplitude is certain, and the members.
    """
    before, posterior, mean_weights = state.mean_amplitude, state.posterior, basis.mean_weights
    if (
        before is None
        or mean_weights is None
        or not isinstance(posterior, ObservationSpacePosterior)
        or not before.is_due(posterior.n)
    ):
        return state
    prior = posterior.prior
    base = prior.base if isinstance(prior, AmplitudePrior) else prior
    if not isinstance(base, HybridPrior):
        return replace(state, mean_amplitude=before.ended())
    rows, members = posterior.rows_times(mean_weights), basis.member_anomalies
    shares = before.shares
    if len(members):
        posterior, shares = _about_members(posterior, base, rows, before, members)
    whitened = posterior.factor.solve(posterior.n, rows[:, None])[:, 0]
    after = before.averaged(
        float(whitened @ whitened), float(whitened @ posterior.forward[:, 0]), posterior.n
    )
    after = replace(after, shares=shares)
    prior = AmplitudePrior(base, mean_weights, after, after.moved(members))
    return replace(state, posterior=_under(posterior, prior, rows, before), mean_amplitude=after)


def _about_members(
    posterior: ObservationSpacePosterior,
    base: HybridPrior,
    mean_rows: Array,
    amplitude: MeanAmplitude,
    members: Array,
) -> tuple[ObservationSpacePosterior, tuple[float, ...]]:
    """Return a posterior about the centre that its profiles give, and the share of each member's anomaly by which that is moved.

    Args:
        posterior: About any centre.
        base: The prior before the log.
        mean_rows: shape (K,), H m.
        amplitude: The Gaussian of the mean's amplitude that the posterior has.
        members: shape (E, Z, r), the members' anomalies.
    """
    lower = posterior.factor.dense(posterior.n)
    innovation, of_members = lower @ posterior.forward, posterior.rows_of(members)
    about = of_members @ np.array(amplitude.shares or np.zeros(len(members)))
    rows = of_members, posterior.rows_of(base.factor[:-1]), mean_rows
    total = lower @ lower.T - amplitude.variance * np.outer(mean_rows, mean_rows)
    from_start = innovation[:, 0] + about + amplitude.shift * mean_rows
    shares = member_shares(rows, total, from_start, amplitude, posterior.n)
    innovation[:, 0] += about - of_members @ shares
    forward = solve_triangular(lower, innovation, lower=True, check_finite=False)
    factor = posterior.factor.refactored(posterior.n, lower, forward)
    return replace(posterior, factor=factor), tuple(shares.tolist())


def _under(
    posterior: ObservationSpacePosterior, prior: AmplitudePrior, rows: Array, before: MeanAmplitude
) -> Posterior:
    """Return a posterior under another Gaussian of the amplitude.

    Args:
        posterior: Under the Gaussian ``before``.
        prior: Has the other one.
        rows: shape (K,), H m.
        before: The Gaussian until now.
    """
    lower = posterior.factor.dense(posterior.n)
    innovation = lower @ posterior.forward
    innovation[:, 0] -= (prior.amplitude.shift - before.shift) * rows
    covariance = lower @ lower.T + (prior.amplitude.variance - before.variance) * np.outer(
        rows, rows
    )
    changed = np.linalg.cholesky(covariance)
    forward = solve_triangular(changed, innovation, lower=True, check_finite=False)
    return replace(
        posterior,
        prior=prior,
        factor=posterior.factor.refactored(posterior.n, np.asarray(changed), forward),
    )
