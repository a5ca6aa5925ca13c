"""Two measurements a and b of one vector, compared: what explains a by b much better than equality, how large is it, and since when?

Vectors are complex, east + i north. An alternative says a = g b, with |g| a scale and arg g a turn, or a = g b* of a mirror, or a = b + x c
of an offset (x = 1) or a drift (x the time since it began). Errors of a and b are Gaussian, of one variance that is not known (a conjugate
prior of ``floor`` with two degrees of freedom), and pairs share a bias. An alternative leaves

    r = (a - g b) n,    n = 1,    but 1 / |g| of vectors three times as fast and more, whose errors are in their unit, too,

so that with K the sum of the weights, Q the sum of the squares of the pairs before it began (a - b) and since (r), less their regression
on the bias and on x, and rare(m) the probability of a common bias m,

    gain = (K + 1) ln[(Q(equal) + floor) / (Q + floor)] + K_since ln n^2 + ln[rare(m) / rare(m of equal)]

is its log-likelihood ratio to equality; an offset or a drift pays, besides, for its size, which is not known before. All Q follow from six
sums since each pair, so that all scales, turns and beginnings are compared at once: a scale is free, on a grid of 2 %, and has a spread.

References:
    Bernardo and Smith (1994), Bayesian Theory, section 5.4 (conjugate linear regression); Willsky and Jones (1976), IEEE Trans. Automat. Contr. 21 (a likelihood ratio over the time of a change).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array

Complex = NDArray[np.complex128]
#: Log-likelihood ratio from which a contradiction is named: odds of 8,000 to one.
LEAST_GAIN = 9.0
#: Causes, by what the first vectors are.
CAUSES = {
    "turn": "wrong directions",
    "mirror": "wrong directions",
    "scale": "a wrong scale",
    "unit": "a wrong scale",
    "offset": "a constant offset",
    "drift": "a drift",
}
#: Kinds of alternatives that are no part of others; those of directions; and relative to the vehicle, where small scales and offsets are
#: also those of its way.
KINDS, TURNED = ("turn", "mirror", "scale", "offset", "drift"), ("turn", "mirror")
RELATIVE = (*TURNED, "unit")
# Probability of each cause before any pair, given that something is wrong.
_OF_CAUSE = {
    "wrong directions": 0.4,
    "a wrong scale": 0.4,
    "a constant offset": 0.15,
    "a drift": 0.05,
}
# How many times as fast vectors in a unit are.
UNITS = {
    "knots": 1.943844,
    "ft/s": 1.0 / 0.3048,
    "km/h": 3.6,
    "cm/s": 100.0,
    "mm/s": 1000.0,
}
# Share of a cause's probability that its usual slips have: of axes, signs and units. Mirrors about an odd bearing need two faults at once.
_SLIPS, _ODD_MIRRORS = 0.5, 0.05
# Logarithms of scales that are tried; a smaller one than the second is a calibration, and no fault; their spread before any pair.
_SCALES, _LEAST_SCALE, _SCALE_SPREAD = np.linspace(-7.2, 7.2, 721), math.log(1.15), math.log(3.0)
# The least logarithm of a ``unit``: of scales that no error of a vehicle's own speed makes.
_LEAST_UNIT = math.log(3.0)
# degrees; smaller turns are biases of a compass, which the estimator can estimate
_LEAST_TURN, _STEP = 20, 5
# m/s, m/s an hour: of a bias that all pairs share, of an offset, of a drift before any pair; share of the logs with a bias of any size
_BIAS, _ADDED, _ODD_BIAS = 0.03, {"offset": 0.3, "drift": 0.03}, 0.02
# m/s; a smaller offset, or a drift that comes to less, is a bias that sound sources have: of a flight model, of a compass
_LEAST_OFFSET = 0.12
# Share of the pairs that must agree with an explanation, and by what factor it reduces the squares of the differences.
_MAJORITY, _LEAST_RATIO = 2.0 / 3.0, 4.0
# Alternatives whose gains differ by less explain the pairs as well.
_ALIKE = 3.0
# Names of slips, by kind and degrees.
_SIGNS = {
    ("turn", 180): "turned by +180 degrees clockwise, both signs wrong",
    ("mirror", 0): "the sign of north is wrong",
    ("mirror", 90): "east and north are exchanged",
    ("mirror", 180): "the sign of east is wrong",
}


class Family(NamedTuple):
    """Alternatives a = g b, or a = g b* of a mirror.

    Attributes:
        factor: shape (h,), g.
        prior: shape (h,), logarithm of the probability of each, given that something is wrong.
        slip: shape (h,), name of each that is a slip of axes, signs or units; empty for any other.
    """

    factor: Complex
    prior: Array
    slip: tuple[str, ...]

    @property
    def narrowed(self) -> Array:
        """What residuals are multiplied by, n, shape (h,)."""
        return _narrowed(self.factor)


def _narrowed(factor: Complex) -> Array:
    """Return n of factors, shape (h,)."""
    size = np.abs(factor)
    return np.where(np.log(size) < _LEAST_UNIT, 1.0, 1.0 / size)


@cache
def family(kind: str) -> Family:
    """Return the alternatives of a kind: ``turn``, ``mirror``, ``scale``, or ``unit`` of the scales that are no vehicle's error."""
    if kind in ("scale", "unit"):
        # either source may be in a unit; between units any scale is likelier the nearer it is to 1
        odd = _SCALES[np.abs(_SCALES) >= _LEAST_SCALE]
        shares = np.exp(-0.5 * (odd / _SCALE_SPREAD) ** 2)
        units = np.log(np.array([*UNITS.values()]))
        logs = np.concatenate([odd, units, -units])
        names = (*[""] * len(odd), *UNITS, *UNITS)
        of_units = np.full(2 * len(units), 0.5 * _SLIPS / len(units))
        shares = np.concatenate([(1.0 - _SLIPS) * shares / shares.sum(), of_units])
        used = np.flatnonzero((kind == "scale") | (logs > _LEAST_UNIT))
        return Family(
            np.exp(logs[used]) + 0j,
            np.log(_OF_CAUSE[CAUSES[kind]] * shares[used]),
            tuple(names[k] for k in used),
        )
    first = _LEAST_TURN if kind == "turn" else 0
    degrees = np.arange(first, 361 - max(first, _STEP), _STEP)
    names = tuple(_SIGNS.get((kind, angle), "") for angle in degrees.tolist())
    slips = np.array([bool(name) for name in names])
    odd_share = _ODD_MIRRORS if kind == "mirror" else 1.0 - _SLIPS - _ODD_MIRRORS
    shares = np.where(slips, _SLIPS / len(_SIGNS), odd_share / (~slips).sum())
    # what was turned clockwise; a mirror's axis is at half of its angle from east to north
    factor = np.exp(np.radians(degrees) * (1j if kind == "mirror" else -1j))
    return Family(factor, np.log(_OF_CAUSE[CAUSES[kind]] * shares), names)


@dataclass(frozen=True, slots=True)
class Explanation:
    """What explains pairs best, and by how much.

    Attributes:
        kind: Of the alternative.
        value: g, or what is added, east + i north [m/s; m/s an hour of a drift].
        name: What the first vectors are.
        slip: The slip of axes, signs or units that it is; empty for any other.
        alike: Other slips that explain the pairs as well.
        spread: Standard deviation of the logarithm of a scale.
        gain: Log-likelihood ratio to equality.
        favoured: Share of the pairs since it began that favour it.
        pairs: Number of pairs since it began.
        since: Number of the first of them, of all.
    """

    kind: str
    value: complex
    name: str
    slip: str
    alike: tuple[str, ...]
    spread: float
    gain: float
    favoured: float
    pairs: int
    since: int

    @property
    def names(self) -> str:
        """What the first vectors are, and what else explains the pairs as well."""
        return ", or ".join(dict.fromkeys((self.name, *self.alike)))

    @property
    def strength(self) -> str:
        """How strongly the pairs say so."""
        agree = 100.0 * self.favoured
        return f"likelihood ratio e^{self.gain:.0f}, {agree:.0f} % of {self.pairs} pairs agree"

    @property
    def is_unit(self) -> bool:
        """Whether it is a unit in which vectors are three times as fast and more: no vehicle's error makes that."""
        return abs(math.log(abs(self.value))) > _LEAST_UNIT and bool(self.slip)


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Pairs, and what all alternatives need of them.

    Attributes:
        a: shape (K,), east + i north [m/s].
        b: Alike.
        weight: shape (K,).
        hours: shape (K,), since the first pair.
        floor: Twice the variance of a component of a - b that is expected [m^2/s^2].
        misfit: shape (K,), sum of the squared differences since each pair.
        precision: Of a bias that all share: the weights, and what is known of it before.
        equal: The squares that equality leaves, and the square of the bias then.
    """

    a: Complex
    b: Complex
    weight: Array
    hours: Array
    floor: float
    misfit: Array
    precision: float
    equal: tuple[float, float]

    @staticmethod
    def of(pairs: Array, floor: float) -> "Sums":
        """Return it of pairs, shape (K, 6): east and north of a and b, weight, hours."""
        a, b = pairs[:, 0] + 1j * pairs[:, 1], pairs[:, 2] + 1j * pairs[:, 3]
        weight, misfit = pairs[:, 4], _since(pairs[:, 4] * np.abs(a - b) ** 2)
        precision = float(weight.sum()) + floor / (2.0 * _BIAS**2)
        common = abs(complex(weight @ (a - b))) ** 2
        equal = float(misfit[0]) - common / precision, common / precision**2
        return Sums(a, b, weight, pairs[:, 5] - pairs[0, 5], floor, misfit, precision, equal)

    def most(self, kind: str) -> float:
        """Return what no gain of a family exceeds: that of a factor, and of biases before and since it began, all free."""
        c = self.b.conj() if kind == "mirror" else self.b
        w, since = self.weight, _centred(self.weight, self.a, c)
        left = since[0] - np.abs(since[2]) ** 2 / np.maximum(since[1], 1e-30)
        before = np.zeros(len(w))
        before[1:] = _centred(w[::-1], (self.a - self.b)[::-1], c[::-1])[0][::-1][:-1]
        ratio = (self.equal[0] + self.floor) / (np.maximum(left + before, 0.0) + self.floor)
        return float((w.sum() + 1.0) * np.log(ratio.max()) - math.log(_ODD_BIAS))

    def gains(self, kind: str) -> Array:
        """Return the gain of each alternative of a family begun with each pair, shape (K, h)."""
        of, w, a = family(kind), self.weight, self.a
        g, n2 = of.factor, of.narrowed**2
        c = self.b.conj() if kind == "mirror" else self.b
        s_aa, s_cc, s_ac, s_a, s_c = (
            _since(w * each)[:, None]
            for each in (np.abs(a) ** 2, np.abs(c) ** 2, a * c.conj(), a, c)
        )
        squares = n2 * (s_aa + np.abs(g) ** 2 * s_cc - 2.0 * (g.conj() * s_ac).real)
        differences = _since(w * (a - self.b))
        common = (differences[0] - differences)[:, None] + np.sqrt(n2) * (s_a - g * s_c)
        before = (self.misfit[0] - self.misfit)[:, None]
        bias, precision = np.abs(common) ** 2, self.precision
        gain = self._gain(before + squares - bias / precision, bias / precision**2)
        return _begun(gain + _since(w)[:, None] * np.log(n2))

    def _gain(self, left: Array, bias: Array) -> Array:
        """Return the gain of what leaves some squares, and some square of the bias that pairs share."""
        of_equal, bias_of_equal = self.equal
        ratio = np.log((of_equal + self.floor) / (np.maximum(left, 0.0) + self.floor))
        rare = np.log(_rare(bias) / _rare(np.array(bias_of_equal)))
        return np.asarray((self.weight.sum() + 1.0) * ratio + rare)

    def added(self, kind: str) -> tuple[Array, Complex, Array]:
        """Return the gain of an offset or a drift begun with each pair, its size, and what an unknown size costs: shapes (K,)."""
        w, d, x, precision = self.weight, self.a - self.b, self.basis(kind), self.precision
        v = 2.0 * _ADDED[kind] ** 2 / self.floor
        # the regression on the bias and on x: its normal matrix, and its right side
        both, squares, total, moments = x @ w, x**2 @ w + 1.0 / v, complex(w @ d), (x * w) @ d
        det = precision * squares - both**2
        c = (precision * moments - both * total) / det
        bias = (squares * total - both * moments) / det
        left = self.misfit[0] - (bias.conj() * total + c.conj() * moments).real
        cost: Array = np.log(v * det / precision)
        gain = self._gain(left, np.abs(bias) ** 2) - cost - np.abs(c / _ADDED[kind]) ** 2 / 2.0
        return _begun(gain), np.asarray(c, np.complex128), cost

    def cost(self, kind: str) -> Array:
        """Return by how much less an alternative begun with each pair fits in its gain than by what it leaves, shape (K, h)."""
        if kind in _ADDED:
            return self.added(kind)[2][:, None]
        after_first = np.maximum(_since(self.weight) - 1.0, 0.0)[:, None]
        return -2.0 * after_first * np.log(family(kind).narrowed)

    def basis(self, kind: str) -> Array:
        """Return x of what begins with each pair, at each pair: shape (K, K)."""
        if kind == "offset":
            return np.triu(np.ones((len(self.hours),) * 2))
        # a drift began with the pair before the first that it moved
        step = self.hours[min(1, len(self.hours) - 1)]
        began = np.concatenate([[-step], self.hours[:-1]])
        return np.triu(self.hours[None, :] - began[:, None])

    def left(self, kind: str, value: complex, since: int) -> Complex:
        """Return what an alternative leaves of the pairs since one."""
        if kind in _ADDED:
            return (self.a - self.b)[since:] - value * self.basis(kind)[since, since:]
        c = self.b.conj() if kind == "mirror" else self.b
        return (self.a - value * c)[since:] * _narrowed(np.array([value]))


def _since(values: NDArray[Any]) -> NDArray[Any]:
    """Return sums over the pairs from each one on."""
    return np.cumsum(values[::-1], axis=0)[::-1]


def _centred(weight: Array, a: Complex, c: Complex) -> tuple[Array, Array, Complex]:
    """Return the squares of a and of c and their product about their means, of the pairs from each one on."""
    w, s_a, s_c = _since(weight), _since(weight * a), _since(weight * c)
    return (
        _since(weight * np.abs(a) ** 2) - np.abs(s_a) ** 2 / w,
        _since(weight * np.abs(c) ** 2) - np.abs(s_c) ** 2 / w,
        _since(weight * a * c.conj()) - s_a * s_c.conj() / w,
    )


def _begun(gain: Array) -> Array:
    """Return gains, shape (K, ...), of which each beginning within the log is as likely before."""
    gain[1:] -= math.log(len(gain))
    return gain


def _rare(squared_bias: Array) -> Array:
    """Return how likely biases are, by their squares [m^2/s^2], over the likeliest."""
    return (1.0 - _ODD_BIAS) * np.exp(-squared_bias / (2.0 * _BIAS**2)) + _ODD_BIAS


def causes(
    pairs: Array, floor: float, kinds: Sequence[str], least_pairs: int, by_fit: bool = False
) -> dict[str, float]:
    """Return the logarithm of the odds of each cause of some kinds, all its alternatives together, to equality; none without pairs.

    Args:
        pairs: shape (K, 6), as of ``Sums``.
        floor: Twice the variance of a component of a - b that is expected [m^2/s^2].
        kinds: Of alternatives.
        least_pairs: Number of pairs that what began during the log must explain.
        by_fit: Whether it costs nothing that the size of an offset is not known before, and that in one current, pair after pair, vectors
            are several times as fast: an offset and a scale are then told apart by what they leave alone.
    """
    found = dict[str, float]()
    if not len(pairs):
        return found
    sums, last = Sums.of(pairs, floor), max(1, len(pairs) - least_pairs + 1)
    for kind in kinds:
        logs = (_posterior(sums, kind) + (sums.cost(kind) if by_fit else 0.0))[:last]
        odds = float(np.logaddexp.reduce(logs, axis=None))
        found[CAUSES[kind]] = float(np.logaddexp(found.get(CAUSES[kind], -math.inf), odds))
    return found


def _posterior(sums: Sums, kind: str) -> Array:
    """Return the gain of each alternative of a kind begun with each pair, with the logarithm of its probability before any pair."""
    if kind in _ADDED:
        return sums.added(kind)[0][:, None] + math.log(_OF_CAUSE[CAUSES[kind]])
    return sums.gains(kind) + family(kind).prior


def explanation(
    pairs: Array,
    floor: float,
    kinds: Sequence[str],
    least_pairs: int,
    least_gain: float = LEAST_GAIN,
) -> Explanation | None:
    """Return what explains pairs best, when that is much better than equality; else None.

    Args:
        pairs: As of ``causes``.
        floor: Alike.
        kinds: Alike.
        least_pairs: Number of pairs before which nothing is said.
        least_gain: Log-likelihood ratio below which nothing is said.
    """
    if len(pairs) < least_pairs:
        return None
    sums = Sums.of(pairs, floor)
    tried = (kind for kind in kinds if kind in _ADDED or sums.most(kind) >= least_gain)
    found = [each for kind in tried if (each := _best(sums, kind, least_pairs))]
    most, best = max(found, key=lambda each: each[0], default=(0.0, None))
    if best is None or best.gain < least_gain:
        return None
    # slips of the other kind of the same cause: beside a way due east a mirror is a turn
    alike = dict.fromkeys(
        name
        for logs, each in found
        if logs > most - _ALIKE and CAUSES[each.kind] == CAUSES[best.kind]
        for name in (each.slip, *each.alike)
        if name and name != best.slip
    )
    return replace(best, alike=tuple(alike))


def _best(sums: Sums, kind: str, least_pairs: int) -> tuple[float, Explanation] | None:
    """Return the likeliest alternative of a kind with the logarithm of its odds; None where it explains too few pairs, or too little."""
    last, logs = len(sums.a) - least_pairs + 1, _posterior(sums, kind)
    k, h = np.unravel_index(int(np.argmax(logs[:last])), logs[:last].shape)
    since, column, alike, spread = int(k), int(h), tuple[str, ...](), 0.0
    if kind in _ADDED:
        value, slip = complex(sums.added(kind)[1][since]), ""
        if abs(value) * (1.0 if kind == "offset" else float(sums.hours[-1])) < _LEAST_OFFSET:
            return None
        gain = float(logs[since, column]) - math.log(_OF_CAUSE[CAUSES[kind]])
    else:
        of = family(kind)
        value, slip = complex(of.factor[column]), of.slip[column]
        near = logs[since] > logs[since, column] - _ALIKE
        alike = tuple(
            name for name, use in zip(of.slip, near, strict=True) if name and use and name != slip
        )
        gain = float(logs[since, column] - of.prior[column])
        if kind in ("scale", "unit"):
            shares = np.exp(logs[since] - logs[since, column])
            size = np.log(np.abs(of.factor)) - math.log(abs(value))
            spread = math.sqrt(float(shares @ size**2 / shares.sum()))
    weight, left = sums.weight[since:], np.abs(sums.left(kind, value, since)) ** 2
    equal = np.abs((sums.a - sums.b)[since:]) ** 2
    favoured = float(weight @ (left < equal) / weight.sum())
    ratio = (float(weight @ equal) + sums.floor) / (float(weight @ left) + sums.floor)
    if favoured < _MAJORITY or ratio < _LEAST_RATIO:
        return None
    name = _name(kind, value, slip)
    return float(logs[since, column]), Explanation(
        kind, value, name, slip, alike, spread, gain, favoured, len(weight), since
    )


def _name(kind: str, value: complex, slip: str) -> str:
    """Return what the first vectors are."""
    degrees = math.degrees(math.atan2(value.imag, value.real))
    if kind == "turn":
        return slip or f"turned by {-degrees:+.0f} degrees clockwise"
    if kind == "mirror":
        return slip or f"mirrored about the bearing {(90.0 - 0.5 * degrees) % 180.0:g} degrees"
    if kind not in ("scale", "unit"):
        return f"off by {CAUSES[kind]}"
    of_other = ", of the other source" if abs(value) < 1.0 else ""
    return f"in {slip}{of_other}" if slip else f"{abs(value):.3g} times as fast"


def odds(causes: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return the probability of each of some causes, the likeliest first, by the logarithms of their posterior odds to none."""
    if not causes:
        return []
    ranked = sorted(causes.items(), key=lambda each: -each[1])
    shares = np.exp(np.array([gain - ranked[0][1] for _, gain in ranked]))
    return [
        (name, float(share / shares.sum())) for (name, _), share in zip(ranked, shares, strict=True)
    ]


def tell_directions(pairs: Array, floor: float, least_pairs: int) -> bool:
    """Return whether pairs that agree would contradict each other if the first vectors were turned by a right angle.

    Args:
        pairs: As of ``causes``.
        floor: Alike.
        least_pairs: Number of pairs before which nothing would be said.
    """
    if len(pairs) < least_pairs:
        return False
    squares, weight = float(pairs[:, 4] @ np.sum(pairs[:, :4] ** 2, axis=1)), pairs[:, 4].sum()
    ratio = (squares + floor) / (float(Sums.of(pairs, floor).misfit[0]) + floor)
    return bool(ratio >= _LEAST_RATIO and (weight + 1.0) * math.log(ratio) >= LEAST_GAIN)
