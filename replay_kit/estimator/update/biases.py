"""Systematic errors of an instrument: their effect on a profile.

A shear error is along the predicted motion through water: in the measured one the water's own shear changes the apparent motion. As a
part of the state it is along the measured one, and biased by some 2e-5 1/s.

A scale error is special, because its effect is made of the measurement: with z = (1 + s)(v - p) the density of the logged values has a
factor (1 + s)^-1 for each component of the mean, less the share of the platform velocity's error; see ``scale_jacobian``.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.observation import LinearMeasurement
from replay_kit.estimator.update.gate import Gates

NAMES = ("heading", "scale", "shear")


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """Systematic errors of the instrument, by name.

    ``heading``: the compass reads too high [rad], which turns the velocity relative to the platform clockwise. ``scale``: the relative
    velocity is too large, by a share. ``shear``: an error along the motion through water that grows with the distance from the
    instrument (Todd et al. 2017, JTECH 34). They are proportional to the profile's mean relative velocity: with each bin's own velocity
    its noise would look like a scale error.

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

    def functions(self, depth: Array) -> Array:
        """Return the functions of depth that both components share, shape (n, 2): one, and the distance from the first bin; or none."""
        functions = np.column_stack([np.ones(depth.size), np.abs(depth - depth[0])])
        return functions if self.names else functions[:, :0]

    def factor(self, relative: Array | None) -> Array:
        """Return the effect of one prior standard deviation of each bias on these, shape (2, 2, b): component by component.

        Args:
            relative: shape (2,) [m/s], mean velocity relative to the platform, local axes; None when the log does not state it.
        """
        east, north = motion = np.zeros(2) if relative is None else relative
        speed = float(np.hypot(*motion))
        # the water moves backwards relative to the platform
        along = -motion / speed if speed > 0.0 else np.zeros(2)
        columns = {
            "heading": [[north, 0.0], [-east, 0.0]],
            "scale": [[east, 0.0], [north, 0.0]],
            "shear": [[0.0, along[0]], [0.0, along[1]]],
        }
        if not self.names:
            return np.empty((2, 0, 0))
        return np.stack([columns[name] for name in self.names], axis=-1) * self.std


def bias_rows(ones: Array, growing: Array, relative: Array, innovation: Array) -> Array:
    """Return the effect of an error of one unit on the rows of profiles, shape (n, 2, q, 3).

    Args:
        ones: shape (n, q), the rows of a velocity of one in all bins.
        growing: shape (n, q), the rows of each bin's distance from the first one.
        relative: shape (n, 2) [m/s], mean velocity relative to the platform.
        innovation: shape (n, 2) [m/s], mean of measured minus predicted; the motion through water is then that through the predicted
            current. In the measurement the water's own shear changes the apparent motion and looks like a shear error.
    """
    motion = relative - innovation
    speed = np.hypot(*motion.T)[:, None]
    # the water moves backwards relative to the platform
    along = -np.divide(motion, speed, out=np.zeros_like(motion), where=speed > 0.0)
    across = np.stack([relative[:, 1], -relative[:, 0]], axis=1)
    parts = ((across, ones), (relative, ones), (along, growing))
    return np.stack([factor[..., None] * rows[:, None] for factor, rows in parts], axis=-1)


def scale_error_std(profile: LinearMeasurement) -> float | None:
    """Return the error of the platform's velocity [m/s] in a profile that a scale error changes; None for one that it does not."""
    stated = profile.platform_velocity is not None and profile.reference == "absolute"
    return profile.common_std if stated else None


def scale_jacobian(
    gates: Gates, error_factor: Array, ones: Array, common_std: Array | None
) -> Array:
    """Return the derivative of the log-densities' Jacobian with respect to a scale error, at zero: to be subtracted from its score; (n,).

    With sound error statements the regressor contains, on average, one unit of the innovation for each component, less the share of the
    platform velocity's error, which is in the innovation alone. The result is scaled by the innovation's own normalised square, because
    errors are often overstated.

    Args:
        gates: Of the profiles.
        error_factor: shape (n,), factor on the error variance.
        ones: shape (n, q), the rows of a velocity of one in all bins.
        common_std: shape (n,), see ``scale_error_std``; None where there is none.
    """
    if common_std is None:
        return np.zeros(len(gates.along))
    q, over = ones.shape[1], 1.0 / (gates.variance + error_factor[:, None])
    turned = [
        np.matmul(gates.vectors.swapaxes(1, 2)[:, :, c * q : (c + 1) * q], ones[..., None])[..., 0]
        for c in range(2)
    ]
    shared = common_std**2 * sum(np.sum(part**2 * over, axis=1) for part in turned)
    return np.asarray((2.0 - shared) * np.sum(gates.along**2 * over, axis=1) / gates.dof)


def in_words(name: str, estimate: float, std: float) -> str:
    """Return a bias as text for people."""
    if name == "heading":
        return f"heading {np.rad2deg(estimate):+.1f} +- {np.rad2deg(std):.1f} degrees"
    if name == "scale":
        return f"scale {1e2 * estimate:+.1f} +- {1e2 * std:.1f} %"
    return f"shear {1e3 * estimate:+.2f} +- {1e3 * std:.2f} mm/s a metre"


def notes_of(biases: dict[str, tuple[float, float]]) -> str:
    """Return biases, each with its standard deviation, as text for people."""
    return ", ".join(in_words(name, *value) for name, value in biases.items())
