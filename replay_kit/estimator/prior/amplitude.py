"""The amplitudes of the prior: of its covariance, fitted to innovations, and of the ensemble mean, averaged over.

**Covariance.** Where members were not made as an ensemble (lagged forecasts, fields of other times, several models), how much they differ
says little of how much they err. With rows y = H w + noise of unit variance, the prior covariance P times an amplitude a, and d = y - H m,
the innovations have the covariance a H P H' + 1. With the eigenvalues s of H P H' and the components c of d along its eigenvectors, minus
twice the logarithm of the likelihood is, up to a constant,

    sum log(a s + 1) + c^2 / (a s + 1)

(Dee 1995, Mon. Wea. Rev. 123, 1128-1145, for one parameter). A mean of c^2 / s alone would weigh directions in which the prior has hardly
any variance as much as the others. The first profiles of a log have few independent directions: a normal prior of log a, centred on what is
expected, with a standard deviation of log 2, adds (log(a / expected) / log 2)^2 (maximum a posteriori).

**Ensemble mean.** Its variance is averaged over by its marginal likelihood as a log begins. The weights are w = w0 + a m with m the
ensemble mean and w0 of the members' prior. The likelihood of a given profiles is Gaussian: with their innovations e about w0, of covariance
S, and their rows H,

    J = (H m)' S^-1 H m,    b = (H m)' S^-1 e,

its likelihood is proportional to exp(b a - J a^2 / 2). Under a prior N(0, k) of a its posterior has the variance v = 1 / (1 / k + J)
and the mean v b, and k has the marginal likelihood (1 + k J)^-1/2 exp(v b^2 / 2). Whether they agree on a mean that is wrong as a whole,
members cannot say, so k is averaged over a few values, of which half of the weight is on none: where the mean is right an estimate
hardly loses, and where it is wrong the first profiles show it. A Gaussian N(shift, variance) of a that has the same posterior mean and
variance stands for that mixture, so an estimate remains one Gaussian.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from replay_kit.core.arrays import Array
from replay_kit.core.evidence import normalised_square
from replay_kit.core.flow.covariance import HybridCovariance, Reduction, symmetric
from replay_kit.estimator.prior.hybrid import HybridPrior, Prior, PriorSettings

#: The variances that are averaged over, and their weights before the log.
VARIANCES = np.array([0.0, 0.03, 0.1, 0.3])
WEIGHTS = np.array([0.5, 0.5 / 3, 0.5 / 3, 0.5 / 3])
# Least variance of the Gaussian that stands for the mixture.
_LEAST = 1e-6
# Numbers of profiles, or of groups of them, after which the average is taken again; later the amplitude is known.
_COUNTS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28)


@dataclass(frozen=True, slots=True)
class MeanAmplitude:
    """The Gaussian, before the log, of how far the amplitude of the ensemble mean is from 1, that stands for the mixture after it.

    Attributes:
        shift: Its mean.
        variance: Its variance.
        profiles: Number of profiles that it was averaged with; None after the last.
        shares: Of each member's anomaly by which the prior's centre is moved (``centre.py``); empty before the first profile.
        kernels: Probabilities of the kernels that it is moved by.
    """

    shift: float
    variance: float
    profiles: int | None = 0
    shares: tuple[float, ...] = ()
    kernels: tuple[float, ...] = ()

    def is_due(self, profiles: int) -> bool:
        """Return whether the average is taken after so many profiles."""
        return self.profiles is not None and profiles > self.profiles and profiles in _COUNTS

    def until_due(self, profiles: int) -> int | None:
        """Return how many profiles there are from so many until the average is taken again; None for never."""
        later = [count for count in _COUNTS if count > profiles]
        return later[0] - profiles if later and self.profiles is not None else None

    def averaged(self, information: float, score: float, profiles: int) -> "MeanAmplitude":
        """Return the average after profiles.

        Args:
            information: (H m)' S^-1 H m, with S the covariance of the profiles' innovations under this Gaussian.
            score: (H m)' S^-1 e, with e their innovations under it.
            profiles: Their number.
        """
        # of the likelihood alone, this Gaussian taken out
        variance = self.variance - self.variance**2 * information
        precision = information / (1.0 - self.variance * information)
        total = (self.shift + self.variance * score) / variance - self.shift / self.variance
        mean, spread = mixture(precision, total)
        # a mixture of two peaks may be wider than any of its Gaussians: its mean is kept, its variance is that of the widest
        own = 1.0 / np.clip(1.0 / spread - precision, 1.0 / VARIANCES[-1], 1.0 / _LEAST)
        shift = own * (mean * (1.0 / own + precision) - total)
        last = profiles if profiles < _COUNTS[-1] else None
        return replace(self, shift=float(shift), variance=float(own), profiles=last)

    def moved(self, anomalies: Array) -> Array:
        """Return by how much the prior's centre is moved, shape (Z r,), of the members' anomalies, shape (E, Z, r)."""
        if not self.shares:
            return np.zeros(anomalies.shape[1] * anomalies.shape[2])
        return np.tensordot(np.array(self.shares), anomalies, axes=1).ravel()

    def ended(self) -> "MeanAmplitude":
        """Return the same, never to be averaged again."""
        return replace(self, profiles=None)


def before_the_log(kernels: tuple[float, ...] = ()) -> MeanAmplitude:
    """Return the average over variances before any profile, with the probabilities of the kernels that move the centre."""
    return MeanAmplitude(0.0, float(WEIGHTS @ VARIANCES), kernels=kernels)


def mixture(precision: float, total: float) -> tuple[float, float]:
    """Return mean and variance of the amplitude's deviation from 1 under the mixture, given its likelihood.

    Args:
        precision: J.
        total: b.
    """
    variances = VARIANCES / (1.0 + VARIANCES * precision)
    means = variances * total
    log_weights = np.log(WEIGHTS) - 0.5 * np.log1p(VARIANCES * precision) + 0.5 * means * total
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    mean = float(weights @ means)
    return mean, float(weights @ (variances + (means - mean) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class AmplitudePrior(HybridPrior):
    """A hybrid prior with another Gaussian of the ensemble mean's amplitude; its parts follow from what it is made of.

    Attributes:
        base: The prior; the last row of its factor is along the mean.
        mean_weights: shape (Z, r), the ensemble mean.
        amplitude: The Gaussian.
        moved: shape (Z r,), by how much its centre is moved (``centre.py``).
    """

    mean: Array = field(init=False)
    factor: Array = field(init=False)
    vertical: Array = field(init=False)
    horizontal: Array = field(init=False)
    settings: PriorSettings | None = field(init=False)
    base: HybridPrior
    mean_weights: Array
    amplitude: MeanAmplitude
    moved: Array

    def __post_init__(self) -> None:
        """Put the parts together."""
        base, row = self.base, np.sqrt(self.amplitude.variance) * self.mean_weights[None]
        parts = {
            "mean": base.mean + self.moved + self.amplitude.shift * self.mean_weights.ravel(),
            "factor": np.concatenate([base.factor[:-1], row]),
            "vertical": base.vertical,
            "horizontal": base.horizontal,
            "settings": base.settings,
        }
        for name, part in parts.items():
            object.__setattr__(self, name, part)

    def __reduce__(self) -> tuple[type["AmplitudePrior"], tuple[object, ...]]:
        """Pickle the parts alone: the base is in no checkpoint."""
        return type(self), (self.base, self.mean_weights, self.amplitude, self.moved)


#: Least and largest amplitude that a fit gives.
AMPLITUDES = (0.05, 20.0)
_STEPS = 61
# Shares of the variance at which bands of modes end, and how exactly their amplitudes are searched.
_BAND_ENDS, _TOLERANCE, _EVALUATIONS = (0.5, 0.85), 0.05, 80
# Of the logarithm of an amplitude, about the one expected.
_EXPECTED_STD = np.log(2.0)


def fit_amplitude(
    innovation: Array, prior_cov: Array, expected: float | None = None, noise: float = 0.0
) -> float:
    """Return the factor on the prior's part of the innovation covariance that is most probable, within ``AMPLITUDES``.

    Args:
        innovation: shape (m,), measured minus predicted by the prior, in units of the measurement's error.
        prior_cov: shape (m, m), the prior's part of its covariance, in the same units.
        expected: The amplitude expected before; None for maximum likelihood.
        noise: Variance of the measurement's noise that the innovation lacks, and over which the likelihood's logarithm is averaged.
    """
    values, vectors = np.linalg.eigh(prior_cov)
    variance, square = np.maximum(values, 0.0), np.square(vectors.T @ innovation) + noise

    def deviance(log_amplitude: float) -> float:
        total = np.exp(log_amplitude) * variance + 1.0
        doubt = 0.0 if expected is None else (log_amplitude - np.log(expected)) / _EXPECTED_STD
        return float(np.sum(np.log(total) + square / total) + doubt**2)

    # the likelihood may have several maxima; the bracket about the best of a grid has the highest
    grid = np.log(np.geomspace(AMPLITUDES[0], AMPLITUDES[1], _STEPS))
    best = int(np.argmin([deviance(point) for point in grid]))
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, _STEPS - 1)]
    found = minimize_scalar(deviance, bounds=bounds, method="bounded", options={"xatol": 1e-6})
    return float(np.exp(found.x))


def fit_by_scale(
    innovation: Array, prior_covs: Array, expected: float
) -> tuple[float, tuple[float, ...]]:
    """Return the amplitude that is most probable, and how many times as large it is in each band of modes, their geometric mean 1.

    The logarithms of the bands' amplitudes are normal about their mean with a standard deviation of log 2, as that mean is about the one
    expected: few innovations leave the bands alike.

    Args:
        innovation: shape (m,), as of ``fit_amplitude``.
        prior_covs: shape (b, b, m, m), the prior's part of its covariance that two bands cause together.
        expected: The amplitude expected before.
    """
    n_bands = len(prior_covs)

    def deviance(logs: Array) -> float:
        root = np.exp(0.5 * logs)
        total = np.einsum("b,c,bcmn->mn", root, root, prior_covs, optimize=True)
        total[np.diag_indices_from(total)] += 1.0
        square, half_log_determinant = normalised_square(innovation, total)
        about = np.append(logs - logs.mean(), logs.mean() - np.log(expected)) / _EXPECTED_STD
        return 2.0 * half_log_determinant + square + float(about @ about)

    begin = np.full(n_bands, np.log(expected))
    options: dict[str, Any] = {"xatol": _TOLERANCE, "fatol": _TOLERANCE, "maxfev": _EVALUATIONS}
    options["initial_simplex"] = np.vstack([begin, begin + _EXPECTED_STD * np.eye(n_bands)])
    logs = minimize(deviance, begin, method="Nelder-Mead", options=options).x
    low, high = np.log(AMPLITUDES)
    mean = float(np.clip(logs.mean(), low, high))
    return float(np.exp(mean)), tuple(np.exp(logs - logs.mean()).tolist())


def bands_of(prior: Prior) -> NDArray[np.intp]:
    """Return the band of each mode, shape (r,): the leading ones that carry half of the variance, to 85 %, and the others.

    Modes are in the order of their variance, and currents of large scales have the most.
    """
    variance = prior.mode_std() ** 2
    before = np.cumsum(variance) - variance
    return np.digitize(before, np.array(_BAND_ENDS) * variance.sum())


@dataclass(frozen=True, slots=True, eq=False)
class ScaledPrior:
    """A prior whose covariance is multiplied by an amplitude, and by another one in each band of modes.

    Attributes:
        unscaled: The prior.
        amplitude: Factor on its covariance.
        tilt: Further factor on the variance of each band's modes; empty for none.
        root: shape (r,), or (1,) without a tilt, of the factor on each mode's variance.
    """

    unscaled: Prior
    amplitude: float
    tilt: tuple[float, ...] = ()
    root: Array = field(init=False)

    def __post_init__(self) -> None:
        """Give each mode the factor of its band."""
        tilt = np.array(self.tilt)[bands_of(self.unscaled)] if self.tilt else np.ones(1)
        object.__setattr__(self, "root", np.sqrt(self.amplitude * tilt))

    @property
    def settings(self) -> PriorSettings | None:
        """The settings of the unscaled prior."""
        return self.unscaled.settings

    @property
    def mean(self) -> Array:
        """Mean, shape (Z r,)."""
        return self.unscaled.mean

    def matvec(self, weights: Array) -> Array:
        """Return the covariance times each weight vector, shape (m, Z, r), in the same shape."""
        return self.root * self.unscaled.matvec(self.root * weights)

    def matvec_modes(self, basis: Array, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights with ``basis``, shape (c, r), at each level: shape (Z, c, L, r)."""
        return self.root * self.unscaled.matvec_modes(self.root * basis, levels)

    def mode_std(self) -> Array:
        """Return the standard deviation of each mode's weight, root mean square over levels, shape (r,)."""
        return np.asarray(self.root * self.unscaled.mode_std())

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        return self.scaled(self.unscaled.covariance(levels))

    def of_sum(self, levels: tuple[int, ...]) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        return self.scaled(self.unscaled.of_sum(levels))

    def reduction(self, directions: Array, matrix: Array) -> Reduction:
        """Return what rows in ``directions``, shape (s, r), with ``matrix``, shape (Z s, Z s), take from sums of levels."""
        unscaled = self.unscaled.reduction(self.root * directions, matrix)
        return lambda levels: self.scaled(unscaled(levels))

    def scaled(self, matrix: Array) -> Array:
        """Return covariances of the unscaled weights, shape (..., n r, n r), as those of these."""
        root = np.tile(self.root, matrix.shape[-1] // self.root.size)
        return np.asarray(root[:, None] * matrix * root)


def scaled_prior(prior: Prior, spread: str | float | None) -> Prior:
    """Return a prior with the factor on its covariance that is configured; as it is where that is no number."""
    return ScaledPrior(prior, spread) if isinstance(spread, float) else prior


def hybrid_parts(prior: Prior) -> HybridCovariance | None:
    """Return the parts of a hybrid prior's covariance, an amplitude included; None of another prior."""
    if isinstance(prior, ScaledPrior):
        parts = hybrid_parts(prior.unscaled)
        if parts is None:
            return None
        return HybridCovariance(
            prior.root * parts.factor,
            parts.vertical,
            prior.scaled(parts.horizontal),
        )
    if not isinstance(prior, HybridPrior):
        return None
    n_modes = prior.factor.shape[2]
    horizontal = np.array([symmetric(each) for each in prior.horizontal]).reshape(
        -1, n_modes, n_modes
    )
    return HybridCovariance(prior.factor, prior.vertical, horizontal)
