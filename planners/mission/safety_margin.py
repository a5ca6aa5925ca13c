"""How far from its predicted path a mission may lead in samples of the current, place by place: the margins that this asks for."""

from dataclasses import dataclass

import numpy as np
from scipy.special import nctdtrit, ndtri

from replay_kit.core.arrays import Array

# How sure it is that a margin made of few samples holds the share that it is made for.
_SURE = 0.99
# A larger share than this is not told from all.
_MOST = 0.999


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Deviations of K flights from the predicted one.

    Attributes:
        deviations: shape (K, n, 2) [m], at places evenly numbered along the mission, the start not counted.
        share: Of all flights that has to keep clear.
        more: Margin beside what this share deviates by [m].
    """

    deviations: Array
    share: float
    more: float

    def margins(self, normals: Array) -> Array:
        """Return how much farther away each place has to be kept, shape (n, P) [m], for normals of half-planes, shape (n, P, 2).

        The places may be more or fewer than those of the flights.
        """
        numbers = np.linspace(0.0, 1.0, self.deviations.shape[1] + 1)[1:]
        at = np.linspace(0.0, 1.0, len(normals) + 1)[1:]
        moved = np.array([[np.interp(at, numbers, flight[:, i]) for i in (0, 1)] for flight in self.deviations])
        towards = np.einsum("kcn,npc->knp", moved, normals)
        spread = np.std(towards, axis=0, ddof=1) if len(towards) > 1 else 0.0
        held = np.linalg.norm(normals, axis=2) > 0.0
        needed = np.mean(towards, axis=0) + tolerance_factor(len(towards), self.share) * spread
        return np.asarray(np.where(held, np.maximum(needed, 0.0) + self.more, 0.0))


def tolerance_factor(count: int, share: float) -> float:
    """Return how many of its standard deviations above its mean a normal sample's share lies, with 99 chances in 100 at least.

    The one-sided tolerance factor: both moments are those of so many values, and few of them may lie closely by chance.

    Args:
        count: Number of values.
        share: To be held.
    """
    share = min(share, _MOST)
    if count < 2:
        return float(ndtri(share))
    return float(nctdtrit(count - 1, ndtri(share) * np.sqrt(count), _SURE) / np.sqrt(count))
