"""Errors that an instrument makes again and again: how they look in a profile, and whether the log speaks of one.

An error that no state stands for is absorbed by the current where it can be, but a vehicle that turns shows the same error along another
direction. Each profile's innovation e, with covariance S, is held against what an error b of one unit would have left in it:

    s = sum b' S^-1 e,    I = sum b' S^-1 b,    estimate s / I, with standard deviation I^-1/2.

What the current has absorbed of b is followed beside the estimate and taken off; so this is what a state with a flat prior would say
(Friedland 1969, IEEE TAC 14: bias by a filter of its own).

A prior of the current that is not quite right leaves innovations that are alike for hours, and a long log would accuse a sound instrument
of them. So the log is cut into parts, and an estimate is only as sure as the parts' own estimates agree (White 1982, Econometrica 50).

A scale error is special, because b is made of what was measured: with z = (1 + s)(v - p) the density of what is logged has a factor
(1 + s)^-1 for each component of the mean, less what the error of the platform's velocity p has in it; see ``stretch``.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Observation, PathMean
from replay_kit.estimator.update.kalman import Bins

NAMES = ("heading", "scale", "shear")
# Estimates below so many standard deviations are chance, as each log is asked for three.
_SIGNIFICANT = 3.5
# rad, a share, 1/s: smaller ones do no harm
_HARMLESS = (np.deg2rad(2.0), 0.01, 2e-5)


@dataclass(frozen=True, slots=True, eq=False)
class BiasBins:
    """What one of each bias does to a profile.

    Attributes:
        depth: shape (n, 2), functions of depth that both components share: one, and the distance from the first bin; none without biases.
        factor: For each component, shape (2, biases).
    """

    depth: Array
    factor: tuple[Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """Errors that the instrument makes again and again, by name.

    ``heading``: the compass reads too much [rad]; what is measured relative to the platform is turned clockwise. ``scale``: it is
    too long, by a share. ``shear``: it is off along the way through water, by so much for each metre of distance (Todd et al. 2017,
    JTECH 34). They go with the profile's mean relative velocity: with each bin's own its noise would look like a scale error.

    Attributes:
        names: Of the biases.
        std: shape (b,), prior standard deviations: rad, 1, 1/s.
    """

    names: tuple[str, ...]
    std: Array

    @property
    def size(self) -> int:
        """Number of biases."""
        return len(self.names)

    def bins(self, depth: Array, relative: Array | None, misfit: Array | None = None) -> BiasBins:
        """Return what one prior standard deviation of each bias does to a profile.

        Args:
            depth: shape (n,) [m].
            relative: shape (n, 2) [m/s], velocity relative to the platform, local axes; None when the log does not say.
            misfit: shape (n, 2) [m/s], measured minus expected; the way through water is then that through the water expected. In
                what was measured the water's own shear turns the way along itself, and looks like an error along it.
        """
        if not self.names:
            return BiasBins(np.empty((depth.size, 0)), (np.empty((0, 0)), np.empty((0, 0))))
        functions = np.column_stack([np.ones(depth.size), np.abs(depth - depth[0])])
        east, north = (0.0, 0.0) if relative is None else relative.mean(axis=0)
        way = np.array([east, north]) - (0.0 if misfit is None else misfit.mean(axis=0))
        speed = float(np.hypot(*way))
        factors = []
        for component, (along, across) in enumerate(((east, north), (north, -east))):
            columns = {
                "heading": (across, 0.0),
                "scale": (along, 0.0),
                # the water moves backwards relative to the platform
                "shear": (0.0, -float(way[component]) / speed if speed > 0.0 else 0.0),
            }
            factors.append(np.column_stack([columns[name] for name in self.names]) * self.std)
        return BiasBins(functions, (factors[0], factors[1]))

    def columns(self, depth: Array, relative: Array, misfit: Array | None = None) -> Array:
        """Return what one prior standard deviation of each bias does to the bins, shape (biases, n, 2) [m/s]; see ``bins``."""
        bins = self.bins(depth, relative, misfit)
        return np.stack([bins.depth @ factor for factor in bins.factor], axis=-1).transpose(1, 0, 2)


def relative_velocity(observation: Observation, used: NDArray[np.intp], projection: Projection) -> Array | None:
    """Return the bins' velocity relative to the platform, shape (n, 2) [m/s], local axes; None when the log does not say."""
    velocity = observation.velocity[used]
    if observation.platform_velocity is not None:
        velocity = velocity - np.array(observation.platform_velocity)
    elif np.isfinite(observation.common_std):
        return None
    return np.column_stack(rotate_to_local(projection, observation.longitude, observation.latitude, *velocity.T))


# Parts of a log that are kept apart: at most so many, at least half as many in a long one, and too few to tell how they agree.
_PARTS, _FEW = 32, 8


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What profiles so far say of errors of the instrument, in parts of the log of as many profiles each, of which the last grows.

    Attributes:
        scores: shape (parts, 3), s of each.
        informations: shape (parts, 3, 3), I of each.
        length: Number of profiles in a part.
        last: Number of profiles in the last part.
    """

    scores: Array = field(default_factory=lambda: np.zeros((1, len(NAMES))))
    informations: Array = field(default_factory=lambda: np.zeros((1, len(NAMES), len(NAMES))))
    length: int = 1
    last: int = 0

    @property
    def score(self) -> Array:
        """s, shape (3,)."""
        return np.asarray(self.scores.sum(axis=0))

    @property
    def information(self) -> Array:
        """I, shape (3, 3)."""
        return np.asarray(self.informations.sum(axis=0))

    def after(self, columns: Array, innovation: Array, cov: Array, stretched: float) -> "Evidence":
        """Return the evidence after a profile.

        Args:
            columns: shape (m, 3), what an error of one unit leaves in the innovation.
            innovation: shape (m,), of the rows.
            cov: shape (m, m), its covariance.
            stretched: Of the profile; see ``stretch``.
        """
        told = np.linalg.solve(cov, np.column_stack([innovation, columns]))
        score, information = columns.T @ told[:, 0], columns.T @ told[:, 1:]
        score[NAMES.index("scale")] -= stretched
        if self.last < self.length:
            scores, informations = self.scores.copy(), self.informations.copy()
            scores[-1] += score
            informations[-1] += information
            return Evidence(scores, informations, self.length, self.last + 1)
        if len(self.scores) < _PARTS:
            return Evidence(np.vstack([self.scores, score]), np.concatenate([self.informations, information[None]]), self.length, 1)
        halved = (values.reshape(_PARTS // 2, 2, *values.shape[1:]).sum(axis=1) for values in (self.scores, self.informations))
        scores, informations = halved
        return Evidence(np.vstack([scores, score]), np.concatenate([informations, information[None]]), 2 * self.length, 1)

    def suspected(self) -> dict[str, tuple[float, float]]:
        """Return the errors that the log speaks of, all estimated together: estimate and standard deviation; rad, 1, 1/s.

        Together, because a scale error alone looks a little like a shear error: both go along the way through water.
        """
        if not np.diag(self.information).all():
            return {}
        cov = np.linalg.pinv(self.information, hermitian=True)
        estimates, stds = cov @ self.score, np.sqrt(np.diag(cov))
        if len(self.scores) >= _FEW:
            # what each part's score is off what the estimate makes of it
            left = (self.scores - self.informations @ estimates) @ cov
            stds = np.maximum(stds, np.sqrt(len(left) / (len(left) - len(NAMES)) * np.sum(left**2, axis=0)))
        return {
            name: (float(estimate), float(std))
            for name, estimate, std, harmless in zip(NAMES, estimates, stds, _HARMLESS, strict=True)
            if abs(estimate) > max(_SIGNIFICANT * std, harmless)
        }


_UNITS = Biases(NAMES, np.ones(len(NAMES)))


def unit_columns(
    observation: Observation | PathMean, used: NDArray[np.intp], projection: Projection, bins: Bins, misfit: Array
) -> Array | None:
    """Return what an error of one unit does to an observation's rows, shape (m, 3); None where the log does not say how its platform moved.

    Args:
        observation: A mean along a path says nothing of the instrument.
        used: Positions of its usable bins.
        projection: Of the local axes.
        bins: Their rows.
        misfit: shape (n, 2) [m/s], of the usable bins, measured minus expected.
    """
    relative = None if isinstance(observation, PathMean) else relative_velocity(observation, used, projection)
    if relative is None:
        return None
    assert isinstance(observation, Observation)
    return np.stack([bins.compress(column)[0] for column in _UNITS.columns(observation.depth[used], relative, misfit)], axis=1)


def stretch(observation: Observation | PathMean, n_bins: int, bins: Bins, innovation: Array, cov: Array) -> float:
    """Return the slope in a scale error of the logarithm of the measure's own stretching, at none: to be taken off its score.

    What the regressor holds of the innovation is, on the average of sound statements of error, one a component, less the part of the
    platform's velocity, which is in the innovation alone. It is scaled by the innovation's own normalised square, as errors are
    often overstated.

    Args:
        observation: The profile.
        n_bins: Number of its usable bins.
        bins: Their rows.
        innovation: shape (m,), of the rows.
        cov: shape (m, m), covariance of the rows' innovation.
    """
    if isinstance(observation, PathMean) or observation.platform_velocity is None or not np.isfinite(observation.common_std):
        return 0.0
    total = 0.0
    for component in range(2):
        ones = np.zeros((n_bins, 2))
        ones[:, component] = 1.0
        rows, _ = bins.compress(ones)
        total += 1.0 - observation.common_std**2 * float(rows @ np.linalg.solve(cov, rows))
    return total * float(innovation @ np.linalg.solve(cov, innovation)) / innovation.size


def in_words(name: str, estimate: float, std: float) -> str:
    """Return a bias as a person reads it."""
    if name == "heading":
        return f"heading {np.rad2deg(estimate):+.1f} +- {np.rad2deg(std):.1f} degrees"
    if name == "scale":
        return f"scale {1e2 * estimate:+.1f} +- {1e2 * std:.1f} %"
    return f"shear {1e3 * estimate:+.2f} +- {1e3 * std:.2f} mm/s a metre"
