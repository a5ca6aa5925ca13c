"""Horizontally uniform currents that oscillate, as further unknowns of the estimate.

Each unknown is the amplitude at one reference time: its current at another is turned by omega dt, and its phase is forgotten over a
decorrelation time, as an Ornstein-Uhlenbeck process of the turned amplitude.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.config.estimation import TimeConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.flow.local import Oscillation

# rad/s; the Earth's rotation, and the tides of Doodson (1921) as the IHO's list of constituents gives them, degrees an hour
EARTH_ROTATION = 7.292115e-5
_TIDES = {"M2": 28.9841042, "S2": 30.0, "K1": 15.0410686, "O1": 13.9430356}
# Knots of an oscillation in each of its depth lengths.
_KNOTS_A_LENGTH = 2


@dataclass(frozen=True, slots=True, eq=False)
class Oscillations:
    """Horizontally uniform currents that oscillate at a known frequency, each with a depth structure of its own.

    A near-inertial one rotates as a vector, clockwise in the north: one pair, (east, north). A tide has an ellipse: a pair for each
    component, of which the first is the current now and the second its value a quarter period later. A
    steady one is (east, north) that does not rotate: structure between the forecast's levels.

    Attributes:
        knots: shape (K,) [m], depths between which an oscillation is linear; empty without oscillations.
        root: shape (K, K) [m/s], maps independent unknowns to the knots.
        omega: shape (q,), of each pair [rad/s].
        inertial: shape (q,), whether the pair is (east, north) of a rotating one.
        component: shape (q,), of a tide's pair: 0 east, 1 north.
        scale: Time over which the phase is forgotten [s].
    """

    knots: Array
    root: Array
    omega: Array
    inertial: Sequence[bool]
    component: Sequence[int]
    scale: float

    @property
    def size(self) -> int:
        """Number of unknowns: two for each pair and knot."""
        return 2 * self.omega.size * self.knots.size

    def weights(self, depth: Array) -> Array:
        """Return hat functions of the knots at depths, shape (n, K)."""
        if self.knots.size == 0:
            return np.empty((depth.size, 0))
        return depth_weights(DepthFunctions("hat", 1.0), depth, self.knots)

    def factor(self, component: int) -> Array:
        """Return the effect of one unit of each unknown on a component at the knots, shape (K, size) [m/s]; pair after pair."""
        nothing = np.zeros_like(self.root)
        blocks: list[Array] = []
        for inertial, of_pair in zip(self.inertial, self.component, strict=True):
            if inertial:
                blocks += [self.root, nothing] if component == 0 else [nothing, self.root]
            else:
                blocks += [self.root if component == of_pair else nothing, nothing]
        return np.hstack(blocks) if blocks else np.empty((self.knots.size, 0))

    def known(
        self, unknowns: Array, levels: Array, seconds: float, time_ns: int
    ) -> Oscillation | None:
        """Return what oscillates as later times need it; None where nothing does. Steady currents are no part of it.

        Args:
            unknowns: shape (size,), their means.
            levels: shape (Z,) [m].
            seconds: Since the reference time.
            time_ns: When that is [ns, UTC].
        """
        turning = np.flatnonzero(self.omega)
        if turning.size == 0 or self.knots.size == 0:
            return None
        amplitude = unknowns.reshape(self.omega.size, 2, self.knots.size)
        angle = (self.omega * seconds)[:, None]
        first, second = amplitude[:, 0], amplitude[:, 1]
        now = np.stack(
            [
                np.cos(angle) * first + np.sin(angle) * second,
                np.cos(angle) * second - np.sin(angle) * first,
            ],
            axis=1,
        )
        quarter_later = np.stack([now[:, 1], -now[:, 0]], axis=1)
        at_levels, factors = (
            self.weights(levels),
            [self.factor(c).reshape(self.knots.size, self.omega.size, 2, -1) for c in (0, 1)],
        )
        cosine, sine = (
            np.stack(
                [np.einsum("zk,kqpj,qpj->qz", at_levels, factor, each) for factor in factors],
                axis=1,
            )
            for each in (now, quarter_later)
        )
        return Oscillation(self.omega[turning], cosine[turning], sine[turning], self.scale, time_ns)

    def at(self, rows: Array, seconds: Array) -> Array:
        """Return rows, shape (P, size), of currents some seconds after the reference time, shape (P,), for its unknowns."""
        pairs = rows.reshape(len(rows), self.omega.size, 2, self.knots.size)
        angle = np.multiply.outer(np.broadcast_to(seconds, len(rows)), self.omega)[..., None]
        cosine, sine = np.cos(angle), np.sin(angle)
        # x(t + s) = R(s) x(t), so h x(t + s) = (R(s)' h) x(t)
        first, second = pairs[:, :, 0], pairs[:, :, 1]
        turned = [cosine * first - sine * second, sine * first + cosine * second]
        return np.stack(turned, axis=2).reshape(rows.shape)


def oscillations(config: TimeConfig, latitude: float, deepest: float) -> Oscillations:
    """Return the configured oscillations.

    Args:
        config: Names, standard deviations and correlation lengths in depth.
        latitude: Of the region's centre [degrees north], for the inertial frequency.
        deepest: [m].
    """
    omega: list[float] = []
    inertial: list[bool] = []
    component: list[int] = []
    for name in config.oscillators:
        if name == "inertial":
            omega.append(2.0 * EARTH_ROTATION * np.sin(np.deg2rad(latitude)))
            inertial.append(True)
            component.append(0)
        else:
            omega += [np.deg2rad(_TIDES[name]) / 3600.0] * 2
            inertial += [False, False]
            component += [0, 1]
    length = config.oscillator_depth_length
    n_knots = max(2, int(np.ceil(_KNOTS_A_LENGTH * deepest / length)) + 1) if omega else 0
    knots = np.linspace(0.0, deepest, n_knots)
    correlation = np.exp(-0.5 * ((knots[:, None] - knots) / length) ** 2) + 1e-9 * np.eye(n_knots)
    root = np.asarray(config.oscillator_std * np.linalg.cholesky(correlation), dtype=np.float64)
    return Oscillations(knots, root, np.array(omega), inertial, component, config.oscillator_scale)
