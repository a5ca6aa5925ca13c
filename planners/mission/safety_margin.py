"""Safety margins from samples of the current: how far each place of a mission deviates from its predicted path."""

from dataclasses import dataclass

import numpy as np
from scipy.special import nctdtrit, ndtri

from replay_kit.core.arrays import Array

# Confidence that a margin from few samples covers the share it is made for.
_CONFIDENCE = 0.99
# A larger share than this cannot be told from all.
_MOST = 0.999


@dataclass(frozen=True, slots=True, eq=False)
class SafetyMargin:
    """Margins from the deviations of K flights from the predicted one.

    Attributes:
        deviations: shape (K, n, 2) [m], at places evenly numbered along the mission, the start not counted.
        share: Share of all flights that must keep clear.
        extra: Margin in addition to the deviation of this share [m].
    """

    deviations: Array
    share: float
    extra: float

    def margins(self, normals: Array) -> Array:
        """Return the additional distance kept at each place, shape (n, P) [m], for normals of half-planes, shape (n, P, 2).

        The places may be more or fewer than those of the flights.
        """
        numbers = np.linspace(0.0, 1.0, self.deviations.shape[1] + 1)[1:]
        at = np.linspace(0.0, 1.0, len(normals) + 1)[1:]
        moved = np.array(
            [[np.interp(at, numbers, flight[:, i]) for i in (0, 1)] for flight in self.deviations]
        )
        towards = np.einsum("kcn,npc->knp", moved, normals)
        deviation_std = np.std(towards, axis=0, ddof=1) if len(towards) > 1 else 0.0
        limits = np.linalg.norm(normals, axis=2) > 0.0
        needed = (
            np.mean(towards, axis=0) + tolerance_factor(len(towards), self.share) * deviation_std
        )
        return np.asarray(np.where(limits, np.maximum(needed, 0.0) + self.extra, 0.0))


def tolerance_factor(count: int, share: float) -> float:
    """Return the one-sided tolerance factor of a normal sample at a confidence of 99 %.

    The mean of the sample plus so many of its standard deviations is above the quantile ``share`` of the population with that
    confidence: mean and standard deviation are themselves estimated from few values.

    Args:
        count: Number of values.
        share: Of the population, to be covered.
    """
    share = min(share, _MOST)
    if count < 2:
        return float(ndtri(share))
    return float(nctdtrit(count - 1, ndtri(share) * np.sqrt(count), _CONFIDENCE) / np.sqrt(count))
