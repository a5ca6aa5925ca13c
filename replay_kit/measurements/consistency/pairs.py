"""Two measurements of one vector, compared: does a rotation, a mirror or a unit explain one by the other much better than equality?

Pairs (a, b) of horizontal vectors should be equal. With independent Gaussian errors whose common variance is not known (a conjugate prior
of ``floor`` with two degrees of freedom) the density of the a with M a = b, the variance integrated out, gives the log-likelihood ratio of
a matrix M to equality,

    (K + 1) ln[(sum |a - b|^2 + floor) / (sum |M a - b|^2 + floor)] + K ln |det M|,

which depends on the pairs by their number K and a few sums of products. As outliers could carry it, at least two thirds of the pairs must
agree with M better than with equality, each alone; and as pairs of poor data are explained by nothing, M must halve their RMS difference.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import Array

#: Log-likelihood ratio from which a contradiction is named: odds of 8,000 to one.
LEAST_GAIN = 9.0
# Share of the pairs that must favour M by themselves.
_MAJORITY = 2.0 / 3.0
# Factor by which M must reduce the sum of squared differences.
_LEAST_RATIO = 4.0
# Maps whose gains differ by less are equally likely: a slip of axes or signs, or a turn, is then the likelier cause.
_ALIKE = 3.0
# Pairs remembered: what is correlated over a long log is not more evidence without end.
_MOST_PAIRS = 128
# degrees; smaller turns are biases of a compass, which the estimator can estimate, and not faults
_LEAST_TURN, _STEP = 20, 10
KNOTS = 1.943844
# Ten stands for any factor between those of units.
_SCALES = ((KNOTS, "knots"), (10.0, ""), (100.0, "cm/s"), (1000.0, "mm/s"))
_MIRRORS = {
    0: "the sign of north is wrong",
    90: "east and north are exchanged",
    180: "the sign of east is wrong",
}


@dataclass(frozen=True, slots=True)
class LinearMap:
    """A matrix M that may explain one vector by another, true = M logged.

    Attributes:
        name: What the logged vectors are.
        kind: ``turn``, ``mirror`` or ``unit``.
        angle: A turn's, clockwise [degrees]; a mirror's, twice that of its axis from east to north; 0 for a unit.
        scale: How many times too large the logged vectors are; 1 but for a unit.
        unit: Its name; empty for a turn, a mirror or a scale that is no unit's.
    """

    name: str
    kind: str
    angle: int = 0
    scale: float = 1.0
    unit: str = ""

    @property
    def is_slip(self) -> bool:
        """Whether it is an exchange of axes or of signs."""
        return self.angle == 180 or (self.kind == "mirror" and self.angle in _MIRRORS)


@cache
def linear_maps() -> tuple[tuple[LinearMap, ...], Array]:
    """Return the maps examined, and their matrices, shape (m, 2, 2)."""
    turns = [
        LinearMap(_turn_name(angle), "turn", angle)
        for angle in range(_LEAST_TURN, 361 - _LEAST_TURN, _STEP)
    ]
    mirrors = [LinearMap(_mirror_name(angle), "mirror", angle) for angle in range(0, 360, _STEP)]
    units = [
        LinearMap(
            f"in {unit}" if unit else "several times too fast", "unit", scale=scale, unit=unit
        )
        for scale, unit in _SCALES
    ]
    maps = (*turns, *mirrors, *units)
    return maps, np.array([_matrix(each) for each in maps])


def _matrix(each: LinearMap) -> Array:
    cosine, sine = math.cos(math.radians(each.angle)), math.sin(math.radians(each.angle))
    if each.kind == "mirror":
        return np.array([[cosine, sine], [sine, -cosine]])
    # what was turned clockwise is turned back counter-clockwise
    return np.array([[cosine, -sine], [sine, cosine]]) / each.scale


def _turn_name(angle: int) -> str:
    return f"turned by {angle if angle <= 180 else angle - 360:+d} degrees clockwise" + (
        ", both signs wrong" if angle == 180 else ""
    )


def _mirror_name(angle: int) -> str:
    return (
        _MIRRORS.get(angle)
        or f"mirrored about the bearing {(90.0 - 0.5 * angle) % 180.0:g} degrees"
    )


@dataclass(frozen=True, slots=True)
class Explanation:
    """The map that explains pairs best, and by how much.

    Pairs of nearly one direction cannot tell a turn from a mirror: of maps that explain them equally well the likelier cause is named.

    Attributes:
        map: What the first vectors of the pairs are.
        alike: Slips that explain the pairs as well.
        gain: Log-likelihood ratio to equality.
        favoured: Share of the pairs that favour it.
        pairs: Number of pairs.
    """

    map: LinearMap
    alike: tuple[LinearMap, ...]
    gain: float
    favoured: float
    pairs: int


class Pair(NamedTuple):
    """Two measurements a and b of one vector, east and north [m/s], and the share of a pair that they count for."""

    a_east: float
    a_north: float
    b_east: float
    b_north: float
    weight: float = 1.0

    def products(self) -> "_Sums":
        """Return the weighted products on which the likelihood ratio depends."""
        a, n, b, m, w = self
        return _Sums(
            w,
            w * (a * a + n * n),
            w * (b * b + m * m),
            w * (a * b + n * m),
            w * (a * m - n * b),
            w * (a * b - n * m),
            w * (n * b + a * m),
        )


class _Sums(NamedTuple):
    """Sums over pairs: weights, a'a, b'b; of b'M a the parts with cosine and sine, for turns and for mirrors."""

    weight: float
    first: float
    second: float
    turn_cosine: float
    turn_sine: float
    mirror_cosine: float
    mirror_sine: float


_NO_SUMS = _Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class PairStatistics:
    """The latest pairs, and their sums of products.

    Attributes:
        floor: Twice the variance of a component that is expected of a - b [m^2/s^2].
        pairs: Latest pairs, oldest first.
        sums: Of their products.
    """

    floor: float
    pairs: tuple[Pair, ...] = ()
    sums: _Sums = _NO_SUMS

    def with_pair(self, pair: Pair) -> "PairStatistics":
        """Return the statistics with one more pair; the oldest is forgotten when there are many."""
        pairs, sums = (
            (*self.pairs, pair),
            _Sums(*map(sum, zip(self.sums, pair.products(), strict=True))),
        )
        if len(pairs) > _MOST_PAIRS:
            sums = _Sums(
                *(total - part for total, part in zip(sums, pairs[0].products(), strict=True))
            )
            pairs = pairs[1:]
        return PairStatistics(self.floor, pairs, sums)

    def ratios(self) -> Array:
        """Return the factor by which each map reduces the sum of squared differences, shape (m,)."""
        sums, (maps, matrices) = self.sums, linear_maps()
        mirror, scale = np.array([(each.kind == "mirror", each.scale) for each in maps]).T
        # b'M a: the first column of M holds cosine and sine over the scale
        product = np.where(mirror > 0.0, sums.mirror_cosine, sums.turn_cosine) * matrices[:, 0, 0]
        product += np.where(mirror > 0.0, sums.mirror_sine, sums.turn_sine) * matrices[:, 1, 0]
        mapped = sums.first / scale**2 + sums.second - 2.0 * product
        return np.asarray(self._as_logged / (np.maximum(mapped, 0.0) + self.floor))

    def gains(self) -> Array:
        """Return the log-likelihood ratio of each map to equality, shape (m,)."""
        scale = np.array([each.scale for each in linear_maps()[0]])
        return np.asarray(
            (self.sums.weight + 1.0) * np.log(self.ratios())
            - 2.0 * self.sums.weight * np.log(scale)
        )

    def tell_directions(self, least_pairs: int) -> bool:
        """Return whether these pairs, which agree, would contradict each other if the first vectors were turned by a right angle.

        Args:
            least_pairs: Number of pairs before which nothing would be said.
        """
        ratio = (self.sums.first + self.sums.second + self.floor) / self._as_logged
        return (
            len(self.pairs) >= least_pairs
            and ratio >= _LEAST_RATIO
            and (self.sums.weight + 1.0) * math.log(ratio) >= LEAST_GAIN
        )

    def best_gain(self) -> float:
        """Return the largest gain of any map, as if there were as many units as turns and mirrors: of many maps one fits by chance."""
        gains, units = self.gains(), np.array([each.kind == "unit" for each in linear_maps()[0]])
        return float(
            max(gains[~units].max(), gains[units].max() + math.log((~units).sum() / units.sum()))
        )

    @property
    def _as_logged(self) -> float:
        return (
            max(self.sums.first + self.sums.second - 2.0 * self.sums.turn_cosine, 0.0) + self.floor
        )

    def _may_be_explained(self, kinds: tuple[str, ...]) -> bool:
        """Return whether any map may halve the RMS difference: whether the best turn, mirror or scale does, which costs little to know."""
        sums = self.sums
        best = max(
            math.hypot(sums.turn_cosine, sums.turn_sine),
            math.hypot(sums.mirror_cosine, sums.mirror_sine),
        )
        least = sums.first - 2.0 * best + sums.second
        if "unit" in kinds and sums.first > 0.0:
            least = min(least, sums.second - sums.turn_cosine**2 / sums.first)
        return self._as_logged >= _LEAST_RATIO * (max(least, 0.0) + self.floor)

    def explanation(
        self, kinds: tuple[str, ...], least_pairs: int, least_gain: float = LEAST_GAIN
    ) -> Explanation | None:
        """Return the best map of some kinds, when it explains the pairs much better than equality; else None.

        Args:
            kinds: Of maps, the likelier first.
            least_pairs: Number of pairs before which nothing is said.
            least_gain: Log-likelihood ratio below which nothing is said.
        """
        if len(self.pairs) < least_pairs or not self._may_be_explained(kinds):
            return None
        (maps, matrices), gains = linear_maps(), self.gains()
        values = np.array(self.pairs)
        first, second, weight = values[:, :2], values[:, 2:4], values[:, 4]
        misfit = np.sum((first @ matrices.swapaxes(1, 2) - second) ** 2, axis=2)
        favoured = (misfit < np.sum((first - second) ** 2, axis=1)) @ weight / weight.sum()
        allowed = (
            np.array([each.kind in kinds for each in maps])
            & (favoured >= _MAJORITY)
            & (self.ratios() >= _LEAST_RATIO)
        )
        best = float(np.max(gains, initial=-np.inf, where=allowed))
        if best < least_gain:
            return None
        alike = [k for k in np.flatnonzero(allowed) if gains[k] > best - _ALIKE]
        # turns before mirrors in the order of kinds asked for, and slips before any other
        chosen = min(
            alike, key=lambda k: (not maps[k].is_slip, kinds.index(maps[k].kind), -gains[k])
        )
        others = tuple(maps[k] for k in alike if k != chosen and maps[k].is_slip)
        return Explanation(
            maps[chosen], others, float(gains[chosen]), float(favoured[chosen]), len(self.pairs)
        )
