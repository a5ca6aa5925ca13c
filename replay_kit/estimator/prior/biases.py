"""Systematic errors of an instrument as further unknowns of the estimate.

An error that is not part of the state is absorbed by the current where possible, but a turning vehicle shows the same error along another
direction. Each is proportional to a profile's mean velocity relative to the platform.

A scale error is special, because its effect is made of the measurement: with z = (1 + s)(v - p) the density of the logged values has a
factor (1 + s)^-1 for each component of the mean, less the share of the platform velocity's error: that moves the estimate by -P g after
each profile, with g the gradient of the factor's logarithm.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.config.estimation import TimeConfig
from replay_kit.core.arrays import Array

# Share of a bias's prior standard deviation above which the log has no information on it.
_UNOBSERVED = 0.95


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


def biases(config: TimeConfig) -> Biases:
    """Return the configured biases."""
    std = {
        "heading": np.deg2rad(config.heading_bias_std),
        "scale": config.scale_bias_std,
        "shear": config.shear_bias_std,
    }
    return Biases(tuple(config.biases), np.array([std[name] for name in config.biases], np.float64))


def bias_remarks(biases: Biases, mean: Array, std: Array) -> list[str]:
    """Return notes on the estimated errors, and on those of which the log says nothing.

    Args:
        biases: Those that are estimated.
        mean: shape (b,), of their unknowns.
        std: shape (b,), of these.
    """
    observed = std < _UNOBSERVED
    found = [
        in_words(name, value, error)
        for name, value, error, seen in zip(
            biases.names, biases.std * mean, biases.std * std, observed, strict=True
        )
        if seen
    ]
    notes = [f"systematic errors of the instrument, estimated: {', '.join(found)}"] if found else []
    if missing := [name for name, seen in zip(biases.names, observed, strict=True) if not seen]:
        notes.append(
            f"the log has no information on errors in {', '.join(missing)}: too few profiles state the platform's motion"
        )
    return notes


def in_words(name: str, estimate: float, std: float) -> str:
    """Return a bias as text for people."""
    if name == "heading":
        return f"heading {np.rad2deg(estimate):+.1f} +- {np.rad2deg(std):.1f} degrees"
    if name == "scale":
        return f"scale {1e2 * estimate:+.1f} +- {1e2 * std:.1f} %"
    return f"shear {1e3 * estimate:+.2f} +- {1e3 * std:.2f} mm/s a metre"
