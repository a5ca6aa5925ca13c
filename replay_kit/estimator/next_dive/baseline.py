"""The baseline of predicted surfacings: the same mean current as in the last dive, as uncertain as such predictions were before."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Persistence:
    """The last dive's mean current and the changes from dive to dive so far.

    With a flat prior of the logarithm of their variance the next change has Student's t distribution, with as many degrees of freedom as
    changes have components.

    Attributes:
        velocity: shape (2,) [m/s], of the last dive; None before the first.
        squares: Sum of the squared lengths of the changes [m^2/s^2].
        changes: Their number.
    """

    velocity: Array | None = None
    squares: float = 0.0
    changes: int = 0

    def after(self, velocity: Array) -> "Persistence":
        """Return the baseline after a dive of some mean current, shape (2,) [m/s]."""
        if self.velocity is None:
            return Persistence(velocity)
        return Persistence(
            velocity,
            self.squares + float(np.sum((velocity - self.velocity) ** 2)),
            self.changes + 1,
        )

    def radius(self, share: float) -> float:
        """Return the radius of the circle that should hold a share of the next mean currents [m/s]; NaN before the first change.

        Two components of Student's t with n degrees of freedom and the scale s lie within r with 1 - (1 + r^2 / (n s^2))^(-n / 2).
        """
        if not self.changes:
            return math.nan
        return math.sqrt(self.squares * ((1.0 - share) ** (-1.0 / self.changes) - 1.0))

    def log_density(self, velocity: Array) -> float:
        """Return the logarithm of the density of the next mean current, shape (2,) [m/s]; NaN before the first change."""
        if self.velocity is None or not self.changes or self.squares == 0.0:
            return math.nan
        half = float(self.changes)
        square = float(np.sum((velocity - self.velocity) ** 2)) / self.squares
        return float(
            gammaln(half + 1.0)
            - gammaln(half)
            - math.log(math.pi * self.squares)
            - (half + 1.0) * math.log1p(square)
        )
