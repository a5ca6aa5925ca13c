"""Errors that an instrument makes again and again: how they look in a profile, and whether the log speaks of one.

An error that no state stands for is absorbed by the current where it can be, but a vehicle that turns shows the same error along another
direction. Each profile's innovation e, with covariance S, is held against what an error b of one unit would have done to it (a score test):

    s = sum b' S^-1 e,    I = sum b' S^-1 b,    estimate s / I, with standard deviation I^-1/2.

What the current absorbed is missing in e, so the estimate is rather too small than too large.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from replay_kit.estimator.kalman import Bins
from replay_kit.geodesy import rotate_to_local
from replay_kit.types import Array, Observation, PathMean, Projection

NAMES = ("heading", "scale", "shear")
# Estimates below so many standard deviations are chance, as each log is asked for three.
_SIGNIFICANT = 3.5
# rad, a share, 1/s: smaller ones do no harm
_HARMLESS = (np.deg2rad(1.0), 0.005, 2e-5)


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

    def bins(self, depth: Array, relative: Array | None) -> BiasBins:
        """Return what one prior standard deviation of each bias does to a profile.

        Args:
            depth: shape (n,) [m].
            relative: shape (n, 2) [m/s], velocity relative to the platform, local axes; None when the log does not say.
        """
        if not self.names:
            return BiasBins(np.empty((depth.size, 0)), (np.empty((0, 0)), np.empty((0, 0))))
        functions = np.column_stack([np.ones(depth.size), np.abs(depth - depth[0])])
        east, north = (0.0, 0.0) if relative is None else relative.mean(axis=0)
        speed = float(np.hypot(east, north))
        factors = []
        for along, across in ((east, north), (north, -east)):
            columns = {
                "heading": (across, 0.0),
                "scale": (along, 0.0),
                # the water moves backwards relative to the platform
                "shear": (0.0, -along / speed if speed > 0.0 else 0.0),
            }
            factors.append(np.column_stack([columns[name] for name in self.names]) * self.std)
        return BiasBins(functions, (factors[0], factors[1]))

    def columns(self, depth: Array, relative: Array) -> Array:
        """Return what one prior standard deviation of each bias does to the bins, shape (biases, n, 2) [m/s]; see ``bins``."""
        bins = self.bins(depth, relative)
        return np.stack([bins.depth @ factor for factor in bins.factor], axis=-1).transpose(1, 0, 2)


def relative_velocity(observation: Observation, used: NDArray[np.intp], projection: Projection) -> Array | None:
    """Return the bins' velocity relative to the platform, shape (n, 2) [m/s], local axes; None when the log does not say."""
    velocity = observation.velocity[used]
    if observation.platform_velocity is not None:
        velocity = velocity - np.array(observation.platform_velocity)
    elif np.isfinite(observation.common_std):
        return None
    return np.column_stack(rotate_to_local(projection, observation.longitude, observation.latitude, *velocity.T))


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What profiles so far say of errors of the instrument.

    Attributes:
        score: shape (3,), s.
        information: shape (3, 3), I.
    """

    score: Array = field(default_factory=lambda: np.zeros(len(NAMES)))
    information: Array = field(default_factory=lambda: np.zeros((len(NAMES), len(NAMES))))

    def after(
        self, observation: Observation | PathMean, used: NDArray[np.intp], projection: Projection, bins: Bins, innovation: Array, cov: Array
    ) -> "Evidence":
        """Return the evidence after a profile.

        Args:
            observation: The profile; a mean along a path says nothing.
            used: Positions of its usable bins.
            projection: Of the local axes.
            bins: Their rows.
            innovation: shape (m,), of the rows.
            cov: shape (m, m), its covariance.
        """
        relative = None if isinstance(observation, PathMean) else relative_velocity(observation, used, projection)
        if relative is None:
            return self
        assert isinstance(observation, Observation)
        columns = _UNITS.columns(observation.depth[used], relative)
        rows = np.stack([bins.compress(column)[0] for column in columns])
        told = np.linalg.solve(cov, np.column_stack([innovation, rows.T]))
        return Evidence(self.score + rows @ told[:, 0], self.information + rows @ told[:, 1:])

    def suspected(self) -> dict[str, tuple[float, float]]:
        """Return the errors that the log speaks of, each alone: estimate and standard deviation; rad, 1, 1/s."""
        found = {}
        for name, score, information, harmless in zip(NAMES, self.score, np.diag(self.information), _HARMLESS, strict=True):
            if information > 0.0:
                estimate, std = float(score / information), float(1.0 / np.sqrt(information))
                if abs(estimate) > max(_SIGNIFICANT * std, harmless):
                    found[name] = (estimate, std)
        return found


_UNITS = Biases(NAMES, np.ones(len(NAMES)))


def in_words(name: str, estimate: float, std: float) -> str:
    """Return a bias as a person reads it."""
    if name == "heading":
        return f"heading {np.rad2deg(estimate):+.1f} +- {np.rad2deg(std):.1f} degrees"
    if name == "scale":
        return f"scale {1e2 * estimate:+.1f} +- {1e2 * std:.1f} %"
    return f"shear {1e3 * estimate:+.2f} +- {1e3 * std:.2f} mm/s a metre"
