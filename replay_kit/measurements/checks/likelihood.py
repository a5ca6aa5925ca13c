"""Likelihood comparison of two measurements a and b of one vector: the best explanation of a by b, its size and its start.

Vectors are complex, east + i north. An alternative is a = g b, with |g| a scale and arg g a rotation, or a = g b* for a mirror, or a = b +
x c for an offset (x = 1) or a drift (x the time since its start). Errors of a and b are Gaussian with one unknown variance (a conjugate
prior of ``floor`` with two degrees of freedom) and a common bias. The residual is

    r = (a - g b) n,    n = 1,    but 1 / |g| for vectors at least three times as fast, whose errors are in the same unit,

so that with K the sum of the weights, Q the sum of squares of the pairs before the start (a - b) and since (r), less their regression on
the bias and on x, and rare(m) the probability of a common bias m,

    gain = (K + 1) ln[(Q(equal) + floor) / (Q + floor)] + K_since ln n^2 + ln[rare(m) / rare(m of equal)]

is its log-likelihood ratio to equality; an offset or a drift is penalised for its unknown size. All Q follow from six sums since each pair,
so that all scales, rotations and starts are compared at once: scales are on a grid of 2 % and have a spread.

References:
    Bernardo and Smith (1994), Bayesian Theory, section 5.4 (conjugate linear regression); Willsky and Jones (1976), IEEE Trans. Automat.
    Contr. 21 (a likelihood ratio over the time of a change).
"""

import math
from collections.abc import Mapping, Sequence
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
UNITS = {"knots": 1.943844, "ft/s": 1.0 / 0.3048, "km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0}
# Logarithms of scales that are tried; a smaller one than the second is a calibration, and no fault; their spread before any pair.
_SCALES, _LEAST_SCALE, _SCALE_SPREAD = np.linspace(-7.2, 7.2, 721), math.log(1.15), math.log(3.0)
# The least logarithm of a ``unit``: of scales that no error of a vehicle's own speed makes.
_LEAST_UNIT = math.log(3.0)
#: Slips of axes and signs: kind and degrees of the alternative, name, M, with true = M logged, and what to check.
SIGNS = (
    (
        "turn",
        180.0,
        "turned by +180 degrees clockwise, both signs wrong",
        (-1, 0, 0, -1),
        "check whether directions are where the current comes from, or velocities are the vehicle's through the water",
    ),
    (
        "mirror",
        0.0,
        "the sign of north is wrong",
        (1, 0, 0, -1),
        "check whether the second component grows to the south",
    ),
    (
        "mirror",
        90.0,
        "east and north are exchanged",
        (0, 1, 1, 0),
        "check which component comes first",
    ),
    (
        "mirror",
        180.0,
        "the sign of east is wrong",
        (-1, 0, 0, 1),
        "check whether the first component grows to the west",
    ),
)


def _named_signs(kind: str) -> dict[float, str]:
    return {degrees: name for sign_kind, degrees, name, *_ in SIGNS if sign_kind == kind}


# Alternatives, degrees or logarithms, and names of those that are usual slips: of axes, signs, and units of either source. Smaller
# turns are biases of a compass, which the estimator can estimate.
_GRIDS: Mapping[str, tuple[Array, Mapping[float, str]]] = {
    "turn": (np.arange(20.0, 341.0, 5.0), _named_signs("turn")),
    "mirror": (np.arange(0.0, 360.0, 5.0), _named_signs("mirror")),
    "scale": (
        _SCALES[np.abs(_SCALES) >= _LEAST_SCALE],
        {sign * math.log(factor): name for sign in (1, -1) for name, factor in UNITS.items()},
    ),
}
# Share of a cause's probability that all odd alternatives have, and each slip: mirrors about an odd bearing need two faults at once.
_SHARES = {"turn": (0.45, 0.125), "mirror": (0.05, 0.125), "scale": (0.5, 0.05)}
# m/s, m/s an hour: of a bias that all pairs share, of an offset, of a drift before any pair; share of the logs with a bias of any size
_BIAS, _ADDED, _ODD_BIAS = 0.03, {"offset": 0.3, "drift": 0.03}, 0.02
# m/s; a smaller offset, or a drift that comes to less, is a bias that sound sources have: of a flight model, of a compass
_LEAST_OFFSET = 0.12
# Share of the pairs that must agree with an explanation, and by what factor it reduces the squares of the differences.
_MAJORITY, _LEAST_RATIO = 2.0 / 3.0, 4.0
# Alternatives whose gains differ by less explain the pairs as well.
_ALIKE = 3.0


class Source(NamedTuple):
    """Properties of the pairs of one kind.

    Attributes:
        floor: Twice the expected variance of a component of a - b [m^2/s^2].
        least: Least number of pairs for a result, also since a start within the log.
    """

    floor: float
    least: int


class Family(NamedTuple):
    """Alternatives a = g b, or a = g b* for a mirror.

    Attributes:
        factor: shape (h,), g.
        prior: shape (h,), log probability of each, given a fault.
        slip: shape (h,), name if it is an error of axes, signs or units; else empty.
    """

    factor: Complex
    prior: Array
    slip: tuple[str, ...]

    @property
    def narrowed(self) -> Array:
        """Factors n of the residuals, shape (h,)."""
        return _narrowed(self.factor)


def _narrowed(factor: Complex) -> Array:
    """Return n of factors, shape (h,)."""
    size = np.abs(factor)
    return np.where(np.log(size) < _LEAST_UNIT, 1.0, 1.0 / size)


@cache
def family(kind: str) -> Family:
    """Return the alternatives of a kind: ``turn``, ``mirror``, ``scale``, or ``unit`` for scales beyond any vehicle's error."""
    if kind == "unit":
        every = family("scale")
        used = np.flatnonzero(np.log(every.factor.real) > _LEAST_UNIT)
        names = tuple(every.slip[k] for k in used)
        return Family(every.factor[used], every.prior[used], names)
    (odd_share, share), (grid, slips) = _SHARES[kind], _GRIDS[kind]
    odd = np.setdiff1d(grid, [*slips])
    each, likely = np.append(odd, [*slips]), np.ones(len(odd))
    if kind == "scale":
        # between units any scale is likelier the nearer it is to 1
        factor, likely = np.exp(each + 0j), np.exp(-0.5 * (odd / _SCALE_SPREAD) ** 2)
    else:
        # a mirror's axis is at half of its angle from east to north
        factor = np.exp(np.radians(each) * (1j if kind == "mirror" else -1j))
    shares = np.append(odd_share * likely / likely.sum(), np.full(len(slips), share))
    names = (*[""] * len(odd), *slips.values())
    return Family(factor, np.log(_OF_CAUSE[CAUSES[kind]] * shares), names)


class Explanation(NamedTuple):
    """Best explanation of pairs.

    Attributes:
        kind: Kind of the alternative.
        value: g, or the offset, east + i north [m/s; m/s per hour for a drift].
        slips: Its error of axes, signs or units, else empty; and others that explain the pairs equally well.
        spread: Standard deviation of the logarithm of a scale.
        gain: Log-likelihood ratio to equality.
        favoured: Fraction of the pairs since its start that favour it.
        pairs: Number of pairs since its start.
        since: Time of the first of them [h since 1970]; 0 if it explains all.
    """

    kind: str
    value: complex
    slips: tuple[str, ...]
    spread: float
    gain: float
    favoured: float
    pairs: int
    since: float

    @property
    def name(self) -> str:
        """Description of the first vectors."""
        slip, degrees = self.slips[0], math.degrees(math.atan2(self.value.imag, self.value.real))
        if self.kind in ("scale", "unit"):
            of_other = ", of the other source" if abs(self.value) < 1.0 else ""
            return f"in {slip}{of_other}" if slip else f"{abs(self.value):.3g} times as fast"
        return slip or {
            "turn": f"turned by {-degrees:+.0f} degrees clockwise",
            "mirror": f"mirrored about the bearing {(90.0 - 0.5 * degrees) % 180.0:g} degrees",
        }.get(self.kind, f"off by {CAUSES[self.kind]}")

    @property
    def names(self) -> str:
        """Description of the first vectors, with other equally good explanations."""
        return ", or ".join(dict.fromkeys((self.name, *self.slips[1:])))

    @property
    def is_unit(self) -> bool:
        """Whether it is a unit with vectors at least three times as fast, beyond any vehicle's error."""
        return abs(math.log(abs(self.value))) > _LEAST_UNIT and bool(self.slips[0])


class Alternatives(NamedTuple):
    """Alternatives of a kind for starts at each of K pairs.

    Attributes:
        gain: shape (K, h), log-likelihood ratios to equality, for equally likely starts.
        value: shape (K, h), g, or the offset.
        prior: shape (h,), as in ``Family``.
        slip: As in ``Family``.
        cost: shape (K, h), penalty of each in its gain beyond the residuals.
    """

    gain: Array
    value: Complex
    prior: Array
    slip: tuple[str, ...]
    cost: Array


def alternatives(pairs: Array, floor: float, kind: str) -> Alternatives:
    """Return all alternatives of a kind.

    Args:
        pairs: shape (K, 6): east and north of a and b [m/s], weight, hours.
        floor: Twice the expected variance of a component of a - b [m^2/s^2].
        kind: Kind of the alternatives.
    """
    a, b, w = _vectors(pairs)
    precision = w.sum() + floor / (2.0 * _BIAS**2)
    misfit, common, weight = (_since(each) for each in (w * np.abs(a - b) ** 2, w * (a - b), w))

    def density(left: Array, bias: Complex) -> Array:
        """Return the log density of residuals with a common bias."""
        rare = (1.0 - _ODD_BIAS) * np.exp(-(np.abs(bias) ** 2) / (2.0 * _BIAS**2)) + _ODD_BIAS
        return np.asarray(np.log(rare) - (weight[0] + 1.0) * np.log(np.maximum(left, 0.0) + floor))

    if kind in _ADDED:
        x, v = _basis(kind, pairs), 2.0 * _ADDED[kind] ** 2 / floor
        # the regression on the bias and on x: its normal matrix, and its right side
        both, squares, moments = x @ w, x**2 @ w + 1.0 / v, x @ (w * (a - b))
        det = precision * squares - both**2
        added = (precision * moments - both * common[0]) / det
        bias = (squares * common[0] - both * moments) / det
        left = misfit[0] - (bias.conj() * common[0] + added.conj() * moments).real
        cost, value = np.log(v * det / precision)[:, None], added[:, None]
        gain = density(left, bias)[:, None] - cost - np.abs(value / _ADDED[kind]) ** 2 / 2.0
        family_of_kind = Family(value[0], np.log([_OF_CAUSE[CAUSES[kind]]]), ("",))
    else:
        family_of_kind = family(kind)
        g, n, value = family_of_kind.factor, family_of_kind.narrowed, family_of_kind.factor
        c = b.conj() if kind == "mirror" else b
        aa, cc, ac, s_a, s_c = (
            _since(w * each)[:, None]
            for each in (np.abs(a) ** 2, np.abs(c) ** 2, a * c.conj(), a, c)
        )
        squares = n**2 * (aa + np.abs(g) ** 2 * cc - 2.0 * (g.conj() * ac).real)
        squares += (misfit[0] - misfit)[:, None]
        shared = (common[0] - common)[:, None] + n * (s_a - g * s_c)
        gain = density(squares - np.abs(shared) ** 2 / precision, shared / precision)
        gain += 2.0 * weight[:, None] * np.log(n)
        cost = -2.0 * np.maximum(weight - 1.0, 0.0)[:, None] * np.log(n)
    gain -= density(misfit[0] - np.abs(common[0]) ** 2 / precision, common[0] / precision)
    gain[1:] -= math.log(len(gain))
    return Alternatives(
        gain, np.broadcast_to(value, gain.shape), family_of_kind.prior, family_of_kind.slip, cost
    )


def _vectors(pairs: Array) -> tuple[Complex, Complex, Array]:
    """Return a and b of pairs, and their weights, shapes (K,)."""
    return pairs[:, 0] + 1j * pairs[:, 1], pairs[:, 2] + 1j * pairs[:, 3], pairs[:, 4]


def _basis(kind: str, pairs: Array) -> Array:
    """Return x of an offset or drift for starts at each pair, at each pair, shape (K, K)."""
    hours = pairs[:, 5] - pairs[0, 5]
    if kind == "offset":
        return np.triu(np.ones((len(hours),) * 2))
    # a drift began with the pair before the first that it moved
    began = np.append(-hours[:2][-1:], hours[:-1])
    return np.triu(hours[None, :] - began[:, None])


def _since(values: NDArray[Any]) -> NDArray[Any]:
    """Return sums over the pairs from each one to the last."""
    return np.cumsum(values[::-1], axis=0)[::-1]


def causes(
    pairs: Array, source: Source, kinds: Sequence[str], by_fit: bool = False
) -> dict[str, float]:
    """Return the log odds of each kind of cause, over all its alternatives, against equality; empty without pairs.

    Args:
        pairs: See ``alternatives``.
        source: Properties of the pairs.
        kinds: Kinds of alternatives.
        by_fit: Whether penalties for the unknown size of an offset and for large scales are dropped, so that residuals alone distinguish an
            offset from a scale.
    """
    found = dict[str, float]()
    for kind in kinds if len(pairs) else ():
        each = alternatives(pairs, source.floor, kind)
        logs = each.gain + each.prior + each.cost * by_fit
        odds = np.logaddexp.reduce(logs[: max(1, len(pairs) - source.least + 1)], axis=None)
        found[CAUSES[kind]] = float(np.logaddexp(found.get(CAUSES[kind], -math.inf), odds))
    return found


def explanation(
    pairs: Array, source: Source, kinds: Sequence[str], least_gain: float = LEAST_GAIN
) -> Explanation | None:
    """Return the best explanation of pairs; None if it is not much better than equality.

    Args:
        pairs: See ``alternatives``.
        source: Properties of the pairs.
        kinds: Kinds of alternatives.
        least_gain: Least log-likelihood ratio.
    """
    floor, found = source.floor, list[tuple[float, Explanation]]()
    for kind in kinds if len(pairs) >= source.least else ():
        causes_of_kind, spread = alternatives(pairs, floor, kind), 0.0
        logs = causes_of_kind.gain + causes_of_kind.prior
        last = logs[: len(pairs) - source.least + 1]
        k, h = (int(one) for one in np.unravel_index(np.argmax(last), last.shape))
        value = complex(causes_of_kind.value[k, h])
        (a, b, w) = (each[k:] for each in _vectors(pairs))
        expected = value * (b.conj() if kind == "mirror" else b)
        if kind in _ADDED:
            expected = b + value * _basis(kind, pairs)[k, k:]
            hours = 1.0 if kind == "offset" else pairs[-1, 5] - pairs[0, 5]
            if abs(value) * hours < _LEAST_OFFSET:
                continue
        left, equal = np.abs(a - expected) * _narrowed(np.array(value)), np.abs(a - b)
        favoured = float(w @ (left < equal) / w.sum())
        ratio = (w @ equal**2 + floor) / (w @ left**2 + floor)
        if favoured < _MAJORITY or ratio < _LEAST_RATIO:
            continue
        if kind in ("scale", "unit"):
            shares = np.exp(logs[k] - logs[k, h])
            size = np.log(np.abs(causes_of_kind.value[k] / value))
            spread = math.sqrt(float(shares @ size**2 / shares.sum()))
        near = (causes_of_kind.slip[one] for one in np.flatnonzero(logs[k] > logs[k, h] - _ALIKE))
        slips = (
            causes_of_kind.slip[h],
            *(slip for slip in near if slip and slip != causes_of_kind.slip[h]),
        )
        gain, since = float(causes_of_kind.gain[k, h]), float(pairs[k, 5]) if k else 0.0
        of_kind = Explanation(kind, value, slips, spread, gain, favoured, len(w), since)
        found.append((logs[k, h], of_kind))
    most, best = max(found, key=lambda each: each[0], default=(0.0, None))
    if best is None or best.gain < least_gain:
        return None
    # slips of the other kind of the same cause: beside a way due east a mirror is a turn
    alike = (
        slip
        for logs, each in found
        if logs > most - _ALIKE and CAUSES[each.kind] == CAUSES[best.kind]
        for slip in each.slips
        if slip
    )
    return best._replace(slips=tuple(dict.fromkeys((*best.slips, *alike))))


def odds(causes: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return the probabilities of causes in descending order, from their log odds."""
    every = np.logaddexp.reduce([*causes.values()])
    ranked = sorted(causes.items(), key=lambda each: -each[1])
    return [(name, math.exp(gain - every)) for name, gain in ranked]


def tell_directions(pairs: Array, source: Source) -> bool:
    """Return whether pairs that agree would disagree after a rotation of the first vectors by 90 degrees.

    Args:
        pairs: See ``alternatives``.
        source: Properties of the pairs.
    """
    a, b, w = _vectors(pairs)
    squares, misfit = w @ (np.abs(a) ** 2 + np.abs(b) ** 2), w @ np.abs(a - b) ** 2
    ratio = (squares + source.floor) / (misfit + source.floor)
    tells = ratio >= _LEAST_RATIO and (w.sum() + 1.0) * math.log(ratio) >= LEAST_GAIN
    return bool(tells and len(pairs) >= source.least)
