"""Oscillations that an estimate knows beside its slow current: near-inertial and tidal ones, uniform over the region."""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Oscillation:
    """Currents v(s) = sum_q exp(-s / tau) [C_q cos(omega_q s) + S_q sin(omega_q s)], s seconds after a time.

    Attributes:
        omega: shape (q,) [rad/s].
        cosine: shape (q, 2, Z) [m/s], C: local east and north at the levels.
        sine: shape (q, 2, Z) [m/s], S.
        scale: tau, the time over which the phase is forgotten [s].
        time_ns: When s is zero [ns, UTC].
    """

    omega: Array
    cosine: Array
    sine: Array
    scale: float
    time_ns: int

    def velocity(self, time_ns: int) -> Array:
        """Return the velocity of all oscillations at a time [ns, UTC], shape (2, Z) [m/s]; before their own time as they were then."""
        seconds = (time_ns - self.time_ns) / 1e9
        phase = self.omega * seconds
        turned = np.tensordot(np.cos(phase), self.cosine, 1) + np.tensordot(
            np.sin(phase), self.sine, 1
        )
        return np.asarray(np.exp(-max(seconds, 0.0) / self.scale) * turned)

    @property
    def shortest_period(self) -> float:
        """Period of the quickest one [s]."""
        return 2.0 * np.pi / float(np.max(np.abs(self.omega)))
