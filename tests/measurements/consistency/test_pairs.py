"""Pairs of measurements of one vector: which map explains one by the other, and when nothing is said."""

import numpy as np
import pytest

from replay_kit.measurements.consistency.pairs import LEAST_GAIN, Pair, PairStatistics
from replay_kit.measurements.consistency.usual_faults import KNOTS, hypotheses

FLOOR = 2.0 * 0.05**2
ADDED_OR_SCALED = ("unit", "scale", "offset", "drift")
ALL, ADDED = ("turn", "mirror", "unit", "scale"), ("offset", "drift")


def statistics(a, b, weight=1.0):
    found = PairStatistics(FLOOR)
    for first, second in zip(a, b, strict=True):
        found = found.with_pair(Pair(*first, *second, weight))
    return found


def of_whole_log(found):
    """Gains of the hypotheses that add nothing, begun with the first pair."""
    return found.fits().gain[0, [each.kind not in ADDED for each in hypotheses()]]


def currents(n=12, seed=0):
    return 0.3 * np.random.default_rng(seed).standard_normal((n, 2))


BIAS = 2.0 * 0.03**2 / FLOOR


def cost_and_squares(left, covariance):
    """Return what a bias of differences that share one costs by its size, and their squares, of which a density is made."""
    inverse = np.linalg.inv(covariance)
    squares = float(np.trace(left.T @ inverse @ left)) + FLOOR
    bias = BIAS * inverse.sum(axis=0) @ left
    return float(np.log(0.98 * np.exp(-(bias @ bias) / (2.0 * 0.03**2)) + 0.02)), squares


def slow_gains(a, b, weight):
    """Return the gains by their definition: Student densities of all differences at once, with a bias that they share."""
    k = len(a)
    covariance = np.eye(k) / weight + BIAS
    equal, squares = cost_and_squares(a - b, covariance)
    gains = []
    for each in hypotheses():
        if each.kind not in ADDED:
            far, left = cost_and_squares((a @ each.matrix.T - b) / each.errors, covariance)
            stretched = weight * k * np.log(abs(np.linalg.det(each.matrix / each.errors)))
            gains.append((weight * k + 1.0) * np.log(squares / left) + stretched + far - equal)
    return np.array(gains)


def slow_gain_of_added(a, b, hours, std, begin):
    """Return the gain of an offset or a drift of some basis by the densities of all differences at once."""
    k, v = len(a), 2.0 * std**2 / FLOOR
    equal = np.eye(k) + BIAS
    moved = equal + v * np.outer(hours, hours)
    (far_equal, of_equal), (far_moved, of_moved) = (
        cost_and_squares(a - b, equal),
        cost_and_squares(a - b, moved),
    )
    c = v * hours @ np.linalg.inv(moved) @ (a - b)
    far = far_moved - far_equal - float(np.sum(c**2)) / (2.0 * std**2)
    shapes = np.linalg.slogdet(moved)[1] - np.linalg.slogdet(equal)[1]
    gain = (k + 1.0) * np.log(of_equal / of_moved) - shapes + far
    return gain - (np.log(k) if begin else 0.0)


@pytest.mark.parametrize("begin", [0, 3])
@pytest.mark.parametrize(("kind", "std"), [("offset", 0.3), ("drift", 0.03)])
def test_the_gain_of_what_is_added_is_that_of_the_definition(kind, std, begin):
    a, b, hours = currents(8), currents(8, seed=1), 2.5 * np.arange(8.0)
    found = PairStatistics(FLOOR)
    for one, other, hour in zip(a, b, hours, strict=True):
        found = found.with_pair(Pair(*one, *other, 1.0, int(hour * 3.6e12)))
    since = hours - hours[begin] + 2.5 if kind == "drift" else np.ones(8)
    basis = np.where(np.arange(8) >= begin, since, 0.0)
    at = [each.kind for each in hypotheses()].index(kind)
    expected = slow_gain_of_added(a, b, basis, std, begin)
    assert found.fits().gain[begin, at] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("weight", [1.0, 0.5])
def test_the_gains_are_those_of_the_definition(weight):
    a, b = currents(7), currents(7, seed=1)
    assert of_whole_log(statistics(a, b, weight)) == pytest.approx(
        slow_gains(a, b, weight), rel=1e-9, abs=1e-9
    )


def test_the_maps_undo_what_their_names_say():
    maps = hypotheses()
    names = {each.name: each.matrix for each in maps}
    # north, logged as east, was turned clockwise by 90 degrees
    assert names["turned by +90 degrees clockwise"] @ [1.0, 0.0] == pytest.approx([0.0, 1.0])
    assert names["turned by -20 degrees clockwise"] @ [
        -np.sin(np.radians(20)),
        np.cos(np.radians(20)),
    ] == pytest.approx([0.0, 1.0])
    assert names["turned by +180 degrees clockwise, both signs wrong"] @ [
        1.0,
        2.0,
    ] == pytest.approx([-1.0, -2.0])
    assert names["east and north are exchanged"] @ [1.0, 2.0] == pytest.approx([2.0, 1.0])
    assert names["the sign of east is wrong"] @ [1.0, 2.0] == pytest.approx([-1.0, 2.0])
    assert names["the sign of north is wrong"] @ [1.0, 2.0] == pytest.approx([1.0, -2.0])
    # an axis at 30 degrees from east to north has the bearing 60
    along = np.array([np.cos(np.radians(30)), np.sin(np.radians(30))])
    assert names["mirrored about the bearing 60 degrees"] @ along == pytest.approx(along)
    assert names["in cm/s"] @ [100.0, -200.0] == pytest.approx([1.0, -2.0])
    assert names["in knots"] @ [1.943844, 0.0] == pytest.approx([1.0, 0.0])
    assert sum(each.kind == "turn" for each in maps) == 33
    assert sum(each.kind == "mirror" for each in maps) == 36


@pytest.mark.parametrize(
    "name",
    [
        each.name
        for each in hypotheses()
        if each.kind not in ADDED and each.name != "turned by +20 degrees clockwise"
    ],
)
def test_each_map_is_named_when_it_is_what_happened(name):
    maps = hypotheses()
    number = next(k for k, each in enumerate(maps) if each.name == name)
    b = currents(60)
    found = statistics(b @ np.linalg.inv(maps[number].matrix).T, b).explanation(ALL, 3)
    assert found is not None
    assert found.gain >= LEAST_GAIN
    assert found.favoured == 1.0
    assert found.pairs == 60
    assert found.fault.kind == maps[number].kind
    step = abs(found.fault.angle - maps[number].angle)
    assert min(step, 360 - step) <= 10
    assert found.fault.scale == maps[number].scale


def test_equal_sources_with_noise_are_never_explained_by_anything():
    rng = np.random.default_rng(3)
    for strength in (0.02, 0.1, 0.5):
        b = strength * rng.standard_normal((100, 2))
        found = PairStatistics(FLOOR)
        for first, second in zip(b + 0.05 * rng.standard_normal(b.shape), b, strict=True):
            found = found.with_pair(Pair(*first, *second))
            assert found.explanation(ALL, 1) is None


@pytest.mark.parametrize(
    ("speed", "factor", "left"),
    [(0.08, 1.0, set()), (0.3, 1.0, set()), (0.06, 2.0, {"a wrong scale"})],
)
def test_what_a_weak_steady_current_neither_shows_nor_excludes_is_undecided(speed, factor, left):
    noise = 0.012 * np.random.default_rng(0).standard_normal((15, 2))
    angle = np.linspace(2.0, 3.0, 15)
    b = speed * np.column_stack([np.cos(angle), np.sin(angle)]) / factor
    found = PairStatistics(2.0 * 0.035**2)
    for k, (one, other) in enumerate(zip(factor * b + noise, b, strict=True)):
        found = found.with_pair(Pair(*one, *other, 1.0, int(k * 9e12)))
    assert {name for name in found.undecided() if "directions" not in name} == left
    assert found.explanation(ADDED_OR_SCALED, 3) is None


@pytest.mark.parametrize(("factor", "named"), [(2.0, True), (KNOTS, True), (1.5, False)])
def test_a_slow_source_is_as_wrong_as_a_fast_one(factor, named):
    b = 0.09 * currents(15) / 0.3
    noise = 0.012 * np.random.default_rng(1).standard_normal(b.shape)
    found = statistics(b + noise, b / factor).explanation(("unit", "scale"), 3)
    assert (found is not None) == named
    assert not named or found.fault.scale == pytest.approx(factor, rel=0.03)


def test_nothing_is_said_before_the_least_number_of_pairs():
    b = currents(3)
    assert statistics(-b, b).explanation(ALL, 3).fault.angle == 180
    assert statistics(-b, b).explanation(ALL, 4) is None
    assert statistics(-b, b).explanation(("unit",), 3) is None


def test_a_few_outliers_do_not_outvote_the_others():
    b = np.full((9, 2), 0.1)
    outliers = np.array([[5.0, 0.0]] * 4)
    # the outliers alone are turned; of the thirteen pairs they are less than two thirds
    mixed = np.random.default_rng(0).permutation(13)
    found = statistics(np.vstack([b, -outliers])[mixed], np.vstack([b, outliers])[mixed])
    assert of_whole_log(found).max() > LEAST_GAIN
    assert found.explanation(ALL, 3) is None


def test_pairs_that_no_map_halves_are_not_explained():
    rng = np.random.default_rng(1)
    b = rng.standard_normal((100, 2))
    turned = b @ np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    # the turn explains much, and leaves more than a quarter of the squared differences
    poor = statistics(turned + 0.6 * rng.standard_normal(b.shape), b)
    assert of_whole_log(poor).max() > LEAST_GAIN
    assert poor.explanation(ALL, 3) is None
    assert (
        statistics(turned + 0.1 * rng.standard_normal(b.shape), b).explanation(ALL, 3).fault.angle
        == 40
    )


def test_pairs_of_one_direction_name_the_slip_and_turns_before_mirrors():
    b = np.array([[0.0, 0.3], [0.01, 0.3], [-0.01, 0.28], [0.0, 0.31]])
    found = statistics(-b, b).explanation(("turn", "mirror"), 3)
    assert found.fault.name == "turned by +180 degrees clockwise, both signs wrong"
    assert [each.name for each in found.alike] == ["the sign of north is wrong"]


def test_old_pairs_are_forgotten():
    b = currents(300)
    found = statistics(np.vstack([b, -b]), np.vstack([b, b]))
    fresh = statistics(-b[-128:], b[-128:])
    assert len(found.pairs) == 128
    assert of_whole_log(found) == pytest.approx(of_whole_log(fresh), rel=1e-9)
