"""The current by depth in the next dive, from the profiles of the dives before it: structure finer than the forecast's levels.

A dive's profiles see c(z) + d(z) + e: a part c that stays from dive to dive, a part d that the dive's profiles share and that is another
one in each dive, and an error e of each bin; east and north alike, and independent. Both parts are Gaussian processes of the same length in
depth, c with a part that is the same at all depths. As in ``filter.py``, settings are averaged by the evidence of the dives before.

With b = H' R^-1 y and A = H' R^-1 H of all bins of a dive, H their hat functions of the knots and P the covariance of c, S that of d,

    m <- m + P (I + A (P + S))^-1 (b - A m),    P <- P - P (I + A (P + S))^-1 A P.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.special import logsumexp

from replay_kit.core.arrays import Array
from replay_kit.core.flow.functions import DepthFunctions, depth_weights

# m/s and m, factors of 2 apart: what stays, what a dive shares, their length in depth, the error of a bin
_STAYING = (0.05, 0.1, 0.2)
_SHARED = (0.05, 0.1, 0.2)
_LENGTHS = (20.0, 40.0, 80.0)
_WHITES = (0.03, 0.06)
# m/s; of the part of what stays that is the same at all depths
_UNIFORM = 0.05
# Knots in the shortest length; their number is at most some hundreds.
_KNOT_SPACING = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """Bins of profiles.

    Attributes:
        depth: shape (n,) [m].
        velocity: shape (n, 2) [m/s].
        backgrounds: shape (k, n, 2) [m/s], background currents, in the order of the model.
    """

    depth: Array
    velocity: Array
    backgrounds: Array


@dataclass(frozen=True, slots=True, eq=False)
class ColumnState:
    """What is known after some dives.

    Attributes:
        mean: shape (h, K, 2) [m/s], of what stays, at the knots under each combination of settings.
        cov: shape (h, K, K), of each component.
        log_weights: shape (h,), of the combinations; the weights sum to one.
    """

    mean: Array
    cov: Array
    log_weights: Array


@dataclass(frozen=True, slots=True, eq=False)
class ColumnModel:
    """The model of the current by depth.

    Attributes:
        knots: shape (K,) [m].
        staying: shape (h, K, K), covariance of what stays before the first dive.
        shared: shape (h, K, K), covariance of what a dive's profiles share.
        white: shape (h,) [m/s], error of a bin.
        background: shape (h,), which background the current is measured about; 0 for none.
    """

    knots: Array
    staying: Array
    shared: Array
    white: Array
    background: Array

    @classmethod
    def default(cls, deepest: float, n_backgrounds: int = 0) -> "ColumnModel":
        """Return the model of all combinations.

        Args:
            deepest: Greatest depth of any bin [m].
            n_backgrounds: Number of currents beside zero that the current may be measured about.
        """
        knots = np.linspace(
            0.0,
            max(deepest, _KNOT_SPACING),
            1 + int(np.ceil(max(deepest, _KNOT_SPACING) / _KNOT_SPACING)),
        )
        settings = np.array(
            list(product(_STAYING, _SHARED, _LENGTHS, _WHITES, range(n_backgrounds + 1))),
            dtype=np.float64,
        )
        staying, shared, length, white, background = settings.T
        apart = (knots[:, None] - knots) / length[:, None, None]
        correlation = np.exp(-0.5 * apart**2) + 1e-9 * np.eye(knots.size)
        return cls(
            knots,
            staying[:, None, None] ** 2 * correlation + _UNIFORM**2,
            shared[:, None, None] ** 2 * correlation,
            white,
            background.astype(np.intp),
        )

    def initial(self) -> ColumnState:
        """Return the state before the first dive."""
        size = self.white.size
        return ColumnState(
            np.zeros((size, self.knots.size, 2)), self.staying, np.full(size, -np.log(size))
        )

    def forecast(self, state: ColumnState, bins: Bins) -> tuple[Array, Array]:
        """Return mean and standard deviation of the next dive's bins, with their error, shape (n, 2) each [m/s]; no velocity is used."""
        hats = self._hats(bins.depth)
        about = np.concatenate([np.zeros((1, *bins.velocity.shape)), bins.backgrounds])[
            self.background
        ]
        expected = about + hats @ state.mean
        variance = (
            np.einsum("nk,hkl,nl->hn", hats, state.cov + self.shared, hats, optimize=True)
            + self.white[:, None] ** 2
        )
        weights = np.exp(state.log_weights)
        mean = np.tensordot(weights, expected, axes=1)
        spread = np.tensordot(weights, variance[:, :, None] + (expected - mean) ** 2, axes=1)
        return np.asarray(mean), np.sqrt(spread)

    def step(self, state: ColumnState, bins: Bins) -> ColumnState:
        """Return the state after a dive, given all its bins; unchanged without any."""
        if not bins.depth.size:
            return state
        hats, inverse = self._hats(bins.depth), self.white**-2.0
        known = np.concatenate([np.zeros((1, *bins.velocity.shape)), bins.backgrounds])
        about = (bins.velocity - known)[self.background]  # (h, n, 2)
        information = inverse[:, None, None] * (hats.T @ hats)
        vector = inverse[:, None, None] * (hats.T @ about) - information @ state.mean
        whole = np.eye(self.knots.size) + information @ (state.cov + self.shared)
        solved = np.linalg.solve(whole, np.concatenate([vector, information @ state.cov], axis=2))
        mean = state.mean + state.cov @ solved[:, :, :2]
        cov = state.cov - state.cov @ solved[:, :, 2:]
        residual = about - hats @ state.mean
        square = inverse * np.sum(residual**2, axis=(1, 2)) - np.sum(
            vector * ((state.cov + self.shared) @ solved[:, :, :2]), axis=(1, 2)
        )
        # of both components
        log_det = np.linalg.slogdet(whole)[1] - bins.depth.size * np.log(inverse)
        log_weights = state.log_weights - 0.5 * square - log_det
        return ColumnState(
            mean, 0.5 * (cov + cov.transpose(0, 2, 1)), log_weights - logsumexp(log_weights)
        )

    def _hats(self, depth: Array) -> Array:
        return depth_weights(DepthFunctions("hat", 1.0), depth, self.knots)


def joined(parts: Sequence[Bins]) -> Bins:
    """Return the bins of several profiles, one at least, together."""
    return Bins(
        np.concatenate([part.depth for part in parts]),
        np.concatenate([part.velocity for part in parts]),
        np.concatenate([part.backgrounds for part in parts], axis=1),
    )
