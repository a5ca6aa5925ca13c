"""Two measurements of one vector, compared: which hypothesis explains one by the other much better than equality, and since when?

Pairs (a, b) of horizontal vectors should be equal. Each of ``usual_faults.hypotheses`` says what a may be instead: M a = b + e for a
turn, a mirror or a scale, a = b + x c + e for an offset (x = 1) or a drift (x the time since it began). With Gaussian errors e whose
common variance is not known (a conjugate prior of ``floor`` with two degrees of freedom), that share a bias of v0 times that variance, and
a c of which each component has v times that variance, the density of the a with all of them integrated out gives the log-likelihood ratio
of a hypothesis to equality,

    (K + 1) ln[(Q(a - b) + floor) / (Q(r) + floor)] + K ln |det M / s^2| - ln(v det G / (K + 1 / v0)),

r what a hypothesis leaves, (M a - b) / s or a - b, s how many times as large as those of b its errors are, Q the sum of its squares
less its regression on the bias and on x, and G the normal matrix of that regression (without x the last term is zero). A fault that began
during the log explains the pairs since then; those before are equal. All beginnings are compared, each as likely before. As outliers
could carry a ratio, at least two thirds of the pairs must agree with the hypothesis better than with equality, each alone; and as pairs
of poor data are explained by nothing, it must halve their RMS difference.

References:
    Bernardo and Smith (1994), Bayesian Theory, section 5.4 (conjugate linear regression); Willsky and Jones (1976), IEEE Trans. Automat.
    Contr. 21 (a generalised likelihood ratio over the time of a change).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.measurements.consistency.usual_faults import KINDS, Hypothesis, hypotheses

#: Log-likelihood ratio from which a contradiction is named: odds of 8,000 to one.
LEAST_GAIN = 9.0
# Share of the pairs that must favour a hypothesis by themselves.
_MAJORITY = 2.0 / 3.0
# Factor by which a hypothesis must reduce the sum of squared differences.
_LEAST_RATIO = 4.0
# Hypotheses whose gains differ by less are equally likely: a slip of axes or signs, or a turn, is then the likelier cause.
_ALIKE = 3.0
# Log-likelihood ratio to a hypothesis from which equality excludes it.
_EXCLUDED = 1.0
# Pairs remembered: what is correlated over a long log is not more evidence without end.
_MOST_PAIRS = 128
# Of pairs that come with pings, after how many all of them are judged again: of the first ones, of later ones.
_JUDGED_FIRST, _JUDGED_EACH = 4, 16
# m/s, and m/s an hour: how large an offset and a drift are before any pair
_OFFSET_STD, _DRIFT_STD = 0.3, 0.03
# m/s; of a bias that all pairs share: of a flight model, of water that is not quite the same
_BIAS_STD = 0.03
# Share of the logs that have one of any size.
_ODD_BIAS = 0.02
# m/s; a smaller offset, or a drift that comes to less, is a bias that sound sources have: of a flight model, of a compass
_LEAST_OFFSET = 0.12
_HOUR_NS = 3.6e12
#: Kinds of hypotheses by which the first vectors are faster or slower than the second ones.
SCALES = ("unit", "scale")


class Pair(NamedTuple):
    """Two measurements a and b of one vector, east and north [m/s], the share of a pair that they count for, and their time [ns, UTC]."""

    a_east: float
    a_north: float
    b_east: float
    b_north: float
    weight: float = 1.0
    time_ns: int = 0


@dataclass(frozen=True, slots=True)
class Explanation:
    """The hypothesis that explains pairs best, and by how much.

    Pairs of nearly one direction cannot tell a turn from a mirror: of hypotheses that explain them equally well the likelier is named.

    Attributes:
        fault: What the first vectors of the pairs are.
        alike: Other slips, or other scales of a scale, that explain the pairs as well, and what explains them still better.
        gain: Log-likelihood ratio to equality.
        favoured: Share of the pairs since it began that favour it.
        pairs: Number of pairs since it began.
        since_ns: Time of the first of them [ns, UTC]; 0 where all are.
        amount: Of an offset [m/s] or a drift [m/s an hour], east and north; zero for any other.
    """

    fault: Hypothesis
    alike: tuple[Hypothesis, ...]
    gain: float
    favoured: float
    pairs: int
    since_ns: int = 0
    amount: tuple[float, float] = (0.0, 0.0)


class _Fits(NamedTuple):
    """How well each hypothesis, begun with each pair, explains pairs: arrays of shape (K, h), a row for each beginning.

    Attributes:
        gain: Log-likelihood ratio to equality.
        ratio: Factor by which the sum of squared differences since the beginning is reduced.
        favoured: Share of the pairs since then that favour it.
        amount: shape (K, h, 2), of what is added.
        of_fit: The gain, but for what it costs that the size of an offset or a drift is not known before.
    """

    gain: Array
    ratio: Array
    favoured: Array
    amount: Array
    of_fit: Array


@cache
def _table(
    kinds: tuple[str, ...],
) -> tuple[tuple[Hypothesis, ...], Array, Array, NDArray[np.str_]]:
    """Return the hypotheses of some kinds, their matrices, factors of errors s, and kinds."""
    table = tuple(each for each in hypotheses() if each.kind in kinds)
    return (
        table,
        np.array([each.matrix for each in table]),
        np.array([each.errors for each in table]),
        np.array([each.kind for each in table]),
    )


@cache
def _stretch(kinds: tuple[str, ...]) -> Array:
    """Return by how much the hypotheses of some kinds stretch the first vectors in units of errors: 1 / (det M)^(1/2) s."""
    return np.array([each.scale * each.errors for each in _table(kinds)[0]])


def _since(values: Array) -> Array:
    """Return sums over the pairs from each one on."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])


@dataclass(frozen=True, slots=True)
class PairStatistics:
    """The latest pairs.

    Attributes:
        floor: Twice the variance of a component that is expected of a - b [m^2/s^2].
        pairs: Latest pairs, oldest first.
        misfit: Sum of their squared differences [m^2/s^2].
        number: Number of pairs so far, with those that are forgotten.
    """

    floor: float
    pairs: tuple[Pair, ...] = ()
    misfit: float = 0.0
    number: int = 0

    def with_pair(self, pair: Pair) -> "PairStatistics":
        """Return the statistics with one more pair; the oldest is forgotten when there are many."""
        pairs, misfit = (*self.pairs, pair), self.misfit + _squared(pair)
        if len(pairs) > _MOST_PAIRS:
            misfit, pairs = max(misfit - _squared(pairs[0]), 0.0), pairs[1:]
        return PairStatistics(self.floor, pairs, misfit, self.number + 1)

    @property
    def is_due(self) -> bool:
        """Whether the pairs are to be judged: now and then, as it takes a millisecond."""
        each = _JUDGED_FIRST if self.number <= 2 * _JUDGED_EACH else _JUDGED_EACH
        return self.number % each == 0

    def fits(self, kinds: tuple[str, ...] = KINDS) -> _Fits:
        """Return how well each hypothesis of some kinds explains the pairs."""
        (_, matrices, errors, kind), values = _table(kinds), np.array(self.pairs, np.float64)
        first, second, weight = values[:, :2], values[:, 2:4], values[:, 4]
        hours, count = (values[:, 5] - values[0, 5]) / _HOUR_NS, _since(weight)[:, None]
        difference, bias = first - second, 2.0 * _BIAS_STD**2 / self.floor
        logged = np.sum(difference**2, axis=1)
        of_pairs, of_differences = count[0, 0], _since(weight[:, None] * difference)
        mapped = (first @ matrices.swapaxes(1, 2) - second) / errors[:, None, None]
        mapped = np.moveaxis(mapped, 0, 1)
        left = np.sum(mapped**2, axis=2)
        since = _since(weight[:, None] * left)
        favoured = _since(weight[:, None] * (left < logged[:, None]))
        as_logged = _since(weight * logged)[:, None]
        # the sums of what a hypothesis leaves, of which the common bias takes its share
        sums = of_differences[0] + _since(weight[:, None, None] * (mapped - difference[:, None]))
        precision = of_pairs + 1.0 / bias
        squares_of_sums = np.sum(sums**2, axis=2)
        misfit = as_logged[0] - as_logged + since - squares_of_sums / precision
        of_equal = float(np.sum(of_differences[0] ** 2))
        equal = float(as_logged[0, 0] - of_equal / precision)
        penalty, amount = 2.0 * count * np.log(_stretch(kinds)), np.zeros((*left.shape, 2))
        unknown = np.zeros_like(left)
        common, none = squares_of_sums / precision**2, of_equal / precision**2
        for name, std, power in (("offset", _OFFSET_STD, 0), ("drift", _DRIFT_STD, 1)):
            if name not in kinds:
                continue
            at, v = int(np.flatnonzero(kind == name)[0]), 2.0 * std**2 / self.floor
            # a drift began with the pair before the first that it moved
            began = np.concatenate([[2.0 * hours[0] - hours[min(1, len(hours) - 1)]], hours[:-1]])
            x = np.triu((hours[None, :] - began[:, None]) ** power)
            # the regression on the bias and on x: its normal matrix, and its right side
            both, squares, moments = x @ weight, x**2 @ weight + 1.0 / v, (x * weight) @ difference
            det = precision * squares - both**2
            c = (precision * moments - both[:, None] * of_differences[0]) / det[:, None]
            b = (squares[:, None] * of_differences[0] - both[:, None] * moments) / det[:, None]
            amount[:, at] = c
            misfit[:, at] = as_logged[0, 0] - np.sum(b * of_differences[0] + c * moments, axis=1)
            mine = weight * np.sum((difference - c[:, None] * x[..., None]) ** 2, axis=2)
            since[:, at] = np.triu(mine).sum(axis=1)
            favoured[:, at] = np.triu(weight * (mine < weight * logged)).sum(axis=1)
            far = np.sum(c**2, axis=1) / (2.0 * std**2)
            unknown[:, at] = np.log(bias * v * det / (1.0 + bias * of_pairs))
            penalty[:, at] = unknown[:, at] + far
            common[:, at] = np.sum(b**2, axis=1)
        misfit = np.maximum(misfit, 0.0) + self.floor
        gain = (of_pairs + 1.0) * np.log((equal + self.floor) / misfit) - penalty
        # conjugate priors grow with the errors; a bias of decimetres per second is rare, however large these are
        gain += np.log(_rare(common) / _rare(np.array(none)))
        # of all beginnings within the log each is as likely before
        gain[1:] -= math.log(len(gain))
        ratio = (as_logged + self.floor) / (np.maximum(since, 0.0) + self.floor)
        return _Fits(gain, ratio, favoured / count, amount, gain + unknown)

    def _in_one_current(self, kinds: tuple[str, ...]) -> Array:
        """Return the gains where all vectors are of one current: that it is several times as fast is then no surprise at each anew."""
        weight = np.array([pair.weight for pair in self.pairs])
        known = np.maximum(_since(weight) - 1.0, 0.0)[:, None]
        return self.fits(kinds).gain + 2.0 * known * np.log(np.maximum(_stretch(kinds), 1.0))

    def added_by_fit(self, least_pairs: int) -> dict[str, float]:
        """Return ``causes`` of an offset and a drift by ``of_fit``: elsewhere a scale that fits as well is likelier."""
        kinds = ("offset", "drift")
        return _of_causes(self.fits(kinds).of_fit, kinds, least_pairs) if self.pairs else {}

    def causes(
        self, kinds: tuple[str, ...], least_pairs: int, of_one_current: bool = False
    ) -> dict[str, float]:
        """Return the logarithm of the odds of each cause of some kinds, all its hypotheses together, to equality; none without pairs.

        Args:
            kinds: Of hypotheses.
            least_pairs: Number of pairs that a fault which began during the log must explain.
            of_one_current: Whether all vectors are of one current, in which a scale is hardly told from an offset.
        """
        if not self.pairs:
            return {}
        gains = self._in_one_current(kinds) if of_one_current else self.fits(kinds).gain
        return _of_causes(gains, kinds, least_pairs)

    def undecided(self) -> dict[str, float]:
        """Return what all pairs neither establish nor exclude, causes and slips, with their log-likelihood ratios to equality."""
        found: dict[str, float] = {}
        gains = self._in_one_current(KINDS)[0].tolist()
        for each, gain in zip(hypotheses(), gains, strict=True):
            if each.is_slip or each.kind not in ("turn", "mirror"):
                name = f"{each.cause} ({each.name})" if each.is_slip else each.cause
                found[name] = max(gain, found.get(name, -math.inf))
        return {name: gain for name, gain in found.items() if gain > -_EXCLUDED}

    def tell_directions(self, least_pairs: int) -> bool:
        """Return whether these pairs, which agree, would contradict each other if the first vectors were turned by a right angle.

        Args:
            least_pairs: Number of pairs before which nothing would be said.
        """
        if len(self.pairs) < least_pairs:
            return False
        values = np.array(self.pairs, np.float64)
        squares = float(values[:, 4] @ np.sum(values[:, :4] ** 2, axis=1))
        ratio = (squares + self.floor) / (self.misfit + self.floor)
        weight = float(values[:, 4].sum())
        return ratio >= _LEAST_RATIO and (weight + 1.0) * math.log(ratio) >= LEAST_GAIN

    def explanation(
        self, kinds: tuple[str, ...], least_pairs: int, least_gain: float = LEAST_GAIN
    ) -> Explanation | None:
        """Return the best hypothesis of some kinds, when it explains the pairs much better than equality; else None.

        Args:
            kinds: Of hypotheses, the likelier first.
            least_pairs: Number of pairs before which nothing is said.
            least_gain: Log-likelihood ratio below which nothing is said.
        """
        weight = len(self.pairs) + 1.0
        # a bias that is rare may add to the bound; pairs that agree are the rule
        bound = weight * math.log1p(self.misfit / self.floor) - math.log(_ODD_BIAS)
        if len(self.pairs) < least_pairs or bound < least_gain:
            return None
        fits, (table, _, _, kind) = self.fits(kinds), _table(kinds)
        allowed = (fits.favoured >= _MAJORITY) & (fits.ratio >= _LEAST_RATIO)
        allowed[len(self.pairs) - least_pairs + 1 :] = False
        size = np.hypot(*np.moveaxis(fits.amount, 2, 0))
        hours = (self.pairs[-1].time_ns - self.pairs[0].time_ns) / _HOUR_NS
        allowed &= (kind != "offset") | (size >= _LEAST_OFFSET)
        allowed &= (kind != "drift") | (size * hours >= _LEAST_OFFSET)
        gain = np.where(allowed, fits.gain, -np.inf)
        best, since = float(gain.max()), gain.argmax(axis=0)
        if best < least_gain:
            return None
        gains = gain.max(axis=0)
        near = np.flatnonzero(gains > best - _ALIKE).tolist()

        def likeliest(k: int) -> tuple[bool, int, float]:
            # turns before mirrors in the order of kinds asked for, and slips before any other
            return not table[k].is_slip, kinds.index(table[k].kind), -gains[k]

        chosen, *alike = sorted(near, key=likeliest)
        scaled = table[chosen].kind in SCALES
        others = tuple(
            table[k]
            for k in alike
            if gains[k] == best or (table[k].kind in SCALES if scaled else table[k].is_slip)
        )
        j = int(since[chosen])
        east, north = fits.amount[j, chosen].tolist()
        return Explanation(
            table[chosen],
            others,
            float(gains[chosen]),
            float(fits.favoured[j, chosen]),
            len(self.pairs) - j,
            self.pairs[j].time_ns if j else 0,
            (east, north),
        )


def _rare(squared_bias: Array) -> Array:
    """Return how likely biases are, by their squares [m^2/s^2], over the likeliest."""
    return (1.0 - _ODD_BIAS) * np.exp(-squared_bias / (2.0 * _BIAS_STD**2)) + _ODD_BIAS


def _squared(pair: Pair) -> float:
    return pair.weight * ((pair.a_east - pair.b_east) ** 2 + (pair.a_north - pair.b_north) ** 2)


def _of_causes(gains: Array, kinds: tuple[str, ...], least_pairs: int) -> dict[str, float]:
    """Return the logarithm of the odds of each cause, all its hypotheses together, by gains since each pair, shape (pairs, n)."""
    found = dict[str, float]()
    of_each = np.logaddexp.reduce(gains[: max(1, len(gains) - least_pairs + 1)], axis=0)
    for each, gain in zip(_table(kinds)[0], of_each.tolist(), strict=True):
        more = gain + math.log(each.prior)
        found[each.cause] = float(np.logaddexp(found.get(each.cause, -math.inf), more))
    return found


def odds(causes: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return the probability of each of some causes, the likeliest first, by the logarithms of their posterior odds to none."""
    if not causes:
        return []
    ranked = sorted(causes.items(), key=lambda each: -each[1])
    shares = np.exp(np.array([gain - ranked[0][1] for _, gain in ranked]))
    total = float(shares.sum())
    return [(name, share / total) for (name, _), share in zip(ranked, shares.tolist(), strict=True)]
