"""Pairs of vectors: which alternative explains them, how large it is, since when, and when nothing is said."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replay_kit.measurements.checks.likelihood import (
    KINDS,
    LEAST_GAIN,
    UNITS,
    Source,
    alternatives,
    explanation,
    family,
)

FLOOR, BIAS = 2.0 * 0.03**2, 0.03
SOURCE = Source(FLOOR, 3)


def pairs(a, b, weight=1.0, hours=None):
    hours = np.arange(len(a)) if hours is None else hours
    return np.column_stack([a.real, a.imag, b.real, b.imag, np.full(len(a), weight), hours])


def currents(n=15, seed=0, size=0.15):
    draws = np.random.default_rng(seed).standard_normal((2, n))
    return size * (draws[0] + 1j * draws[1])


def noise(n, seed=1, size=0.02):
    return currents(n, seed, size)


def slow_gain(rows, g, mirrored, begin):
    """The gain by its definition: densities of all differences at once, which share a bias."""
    a, b, w = rows[:, 0] + 1j * rows[:, 1], rows[:, 2] + 1j * rows[:, 3], rows[:, 4]
    c, size = (b.conj() if mirrored else b), (1.0 if abs(g) < 3.0 else abs(g))
    covariance = np.diag(1.0 / w) + 2.0 * BIAS**2 / FLOOR

    def of(left):
        inverse = np.linalg.inv(covariance)
        bias = 2.0 * BIAS**2 / FLOOR * inverse.sum(axis=0) @ left
        rare = 0.98 * np.exp(-(abs(bias) ** 2) / (2.0 * BIAS**2)) + 0.02
        return float((left.conj() @ inverse @ left).real) + FLOOR, np.log(rare)

    left = a - b
    left[begin:] = (a - g * c)[begin:] / size
    (equal, rare_equal), (other, rare) = of(a - b), of(left)
    stretched = -2.0 * w[begin:].sum() * np.log(size)
    beginnings = np.log(len(a)) if begin else 0.0
    return (w.sum() + 1.0) * np.log(equal / other) + stretched + rare - rare_equal - beginnings


@pytest.mark.parametrize("kind", ["turn", "mirror", "scale"])
@pytest.mark.parametrize("begin", [0, 4])
@pytest.mark.parametrize("weight", [1.0, 0.5])
def test_the_gains_are_those_of_the_definition(kind, begin, weight):
    rows = pairs(currents(9), currents(9, seed=3), weight)
    gains = alternatives(rows, FLOOR, kind).gain[begin]
    for k in range(0, len(gains), 7):
        slow = slow_gain(rows, family(kind).factor[k], kind == "mirror", begin)
        assert gains[k] == pytest.approx(slow, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("made", "kind", "name"),
    [
        (lambda u: -u, "turn", "turned by +180 degrees clockwise, both signs wrong"),
        (lambda u: u * np.exp(-1j * np.radians(60.0)), "turn", "turned by +60 degrees clockwise"),
        (lambda u: u.conj(), "mirror", "the sign of north is wrong"),
        (lambda u: -u.conj(), "mirror", "the sign of east is wrong"),
        *((lambda u, f=factor: f * u, "scale", f"in {unit}") for unit, factor in UNITS.items()),
        (lambda u: u / UNITS["knots"], "scale", "in knots, of the other source"),
        (lambda u: u + 0.3, "offset", "off by a constant offset"),
        (lambda u: u + 0.04 * np.arange(len(u)), "drift", "off by a drift"),
    ],
)
def test_what_was_done_is_named(made, kind, name):
    truth = currents()
    found = explanation(pairs(made(truth + noise(15)), truth + noise(15, 2)), SOURCE, KINDS)
    assert (found.kind, found.name) == (kind, name)
    assert found.gain >= LEAST_GAIN


@pytest.mark.parametrize("begin", [0, 5])
def test_what_begins_during_the_log_explains_the_pairs_since_then(begin):
    truth = currents(16)
    a = truth + noise(16)
    a[begin:] = 1j * a[begin:].conj()
    found = explanation(pairs(a, truth), SOURCE, KINDS)
    assert (found.name, found.since, found.pairs) == (
        "east and north are exchanged",
        begin,
        16 - begin,
    )


@given(st.integers(0, 2**32 - 1), st.integers(3, 40), st.floats(0.05, 0.5))
def test_pairs_that_agree_are_explained_by_nothing(seed, n, size):
    truth = currents(n, seed, size)
    rows = pairs(truth + noise(n, seed + 1, 0.01), truth + noise(n, seed + 2, 0.01))
    assert explanation(rows, SOURCE, KINDS) is None
