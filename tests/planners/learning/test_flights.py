"""Stretches flown by dead reckoning, loops, and the closed loop: against slow twins and as physics asks."""

from dataclasses import replace

import numpy as np
import pytest

from planners.learning.closed_loop import Flown, Stretch, drawn_sea, fly_after, fly_survey, slices
from planners.learning.loops import (
    SCOUTING,
    WAITING,
    Aim,
    allowed_errors,
    clear,
    refine,
    search,
    shapes,
    timed,
)
from planners.learning.rows import rows_at
from planners.learning.transit import (
    _solved,
    end_and_derivative,
    end_sensitivity,
    fly,
    fly_transit,
    path_of,
    plan_transit,
)
from planners.route.hazards import Ring
from tests.planners.learning.scenes import HOUR, NOON, SPEED, known, mean, places, static
from tests.reference import learning as slow

GOAL = np.array([18e3 + 6e3j])
STRETCH = Stretch(0j, GOAL, 0.0, 24.0 * HOUR, 20.0 * HOUR, SPEED, 0.02)


def test_splines_are_the_flow_itself_and_their_gradient_its_derivative():
    points = places(30, 4)
    at = (points[:, 0] + 1j * points[:, 1])[None]
    exact = static().horizontal.velocity(points, known().latent(NOON))[:, :, 0]
    np.testing.assert_allclose(
        mean().at(at, 0.0)[0], exact[0] + 1j * exact[1], atol=2e-3 * np.abs(exact).max()
    )
    value, by_east, by_north = mean().with_gradient(at, 0.0)
    np.testing.assert_allclose(value, mean().at(at, 0.0), rtol=1e-12)
    for slope, step in ((by_east, 1.0), (by_north, 1j)):
        differences = (mean().at(at + step, 0.0) - mean().at(at - step, 0.0)) / 2.0
        np.testing.assert_allclose(slope, differences, atol=1e-6 * np.abs(slope).max())
    # free of divergence but for the spline's error
    assert np.abs(by_east.real + by_north.imag).max() < 0.02 * np.abs(by_east).max()


@pytest.mark.parametrize("changes", [False, True])
def test_a_path_is_the_slow_one(changes):
    currents = mean(changes)

    def one(place, time):
        return complex(currents.at(np.array([place]), time)[0])

    end = fly(currents, np.array([2e3j]), 7200.0, np.array([0.2 + 0.1j]), 10.0 * HOUR)[-1, 0]
    assert end == pytest.approx(
        slow.runge_kutta(one, 2e3j, 7200.0, 0.2 + 0.1j, 10.0 * HOUR, 10), rel=1e-12
    )
    assert end == pytest.approx(
        slow.runge_kutta(one, 2e3j, 7200.0, 0.2 + 0.1j, 10.0 * HOUR, 100), rel=1e-4
    )


@pytest.mark.parametrize("changes", [False, True])
def test_an_end_and_its_derivative_are_those_of_the_path(changes):
    currents, start, held = (
        mean(changes),
        np.array([2e3j, -4e3 + 1e3j]),
        np.array([0.2 + 0.1j, 0.1 - 0.05j]),
    )

    def end(velocity):
        return fly(currents, start, 7200.0, velocity, 10.0 * HOUR)[-1]

    found, derivative = end_and_derivative(currents, start, 7200.0, held, 10.0 * HOUR)
    np.testing.assert_allclose(found, end(held), rtol=1e-12)
    for k, step in enumerate((1e-5, 1e-5j)):
        change = (end(held + step) - end(held - step)) / 2e-5
        np.testing.assert_allclose(
            derivative[:, :, k], np.stack([change.real, change.imag], axis=1), rtol=1e-6, atol=1e-3
        )


def test_a_stretch_meets_its_goals_or_goes_as_far_as_it_can():
    two = np.array([8e3 + 8e3j, 18e3 + 6e3j])
    planned = plan_transit(mean(), np.zeros(1, dtype=complex), 0.0, two, 24.0 * HOUR, SPEED)
    np.testing.assert_allclose(planned.ends[0], two, atol=1.0)
    assert np.abs(planned.through_water).max() <= SPEED
    assert planned.durations.sum() == pytest.approx(24.0 * HOUR)
    times, path = path_of(mean(), np.zeros(1, dtype=complex), 0.0, planned)
    assert path[-1] == pytest.approx(planned.ends[0, -1])
    assert np.all(np.diff(times) > 0.0)
    assert fly_transit(mean(), np.zeros(1, dtype=complex), 0.0, planned)[0] == pytest.approx(
        planned.ends[0, -1]
    )
    far = plan_transit(
        mean(), np.zeros(1, dtype=complex), 0.0, np.array([60e3 + 0j]), 24.0 * HOUR, SPEED
    )
    assert abs(far.through_water[0, 0]) == pytest.approx(SPEED)
    assert 10e3 < abs(far.ends[0, 0]) < 45e3


def test_loops_return_in_time_and_the_first_two_wait_and_scout():
    made = timed(mean(), 1e3j, shapes(2.0 + 1j), (0.0, 24.0 * HOUR, 7), SPEED)
    assert made.corners.shape == (65, 3)
    assert made.flown.all()
    np.testing.assert_allclose(made.corners[:, -1], 1e3j, atol=1e-6)
    np.testing.assert_allclose(made.ends[:, -1], 1e3j, atol=200.0)
    np.testing.assert_allclose(made.ends[WAITING], 1e3j)
    ahead = (made.corners[SCOUTING, 0] - 1e3j) / (2.0 + 1j)
    assert ahead.imag == pytest.approx(0.0, abs=1e-9 * abs(ahead))
    assert ahead.real > 0.0
    # what is left of the vehicle's speed brings it home in other currents like these
    assert np.abs(np.diff(made.ends, axis=1)).max() < 24.0 * HOUR / 7 * (SPEED + 0.3)
    assert made.flown.all()
    # nothing returns against a current that is faster
    torrent = replace(mean(), coefficients=np.full_like(mean().coefficients, 0.5 + 0j))
    assert (
        not timed(torrent, 0j, shapes(1.0 + 0j), (0.0, 24.0 * HOUR, 7), SPEED)
        .flown[WAITING + 1 :]
        .any()
    )


def test_areas_close_the_loops_that_cross_them():
    made = timed(mean(), 0j, shapes(1.0 + 0j), (0.0, 24.0 * HOUR, 7), SPEED)
    lane = Ring(
        np.array([[3e3, -30e3], [3e3, 30e3], [9e3, 30e3], [9e3, -30e3]]),
        False,
        "lane",
        surface_only=True,
    )
    free = clear(made, 0j, (lane,), 100.0)
    assert free[WAITING]
    assert not free[SCOUTING]
    np.testing.assert_array_equal(free, made.corners.real.max(axis=1) < 2.9e3)
    assert not clear(made, 0j, (replace(lane, outside=True),), 100.0)[SCOUTING]


def test_refining_never_loses_and_keeps_to_what_may_be_flown():
    planned = plan_transit(
        mean(), np.zeros(1, dtype=complex), 24.0 * HOUR, GOAL, 20.0 * HOUR, SPEED
    )
    sense = end_sensitivity(mean(), 0j, 24.0 * HOUR, planned)
    rows = rows_at(known(), np.stack([sense.points.real, sense.points.imag], axis=-1), sense.times)
    aim = Aim(known(), rows.combined(sense.weights), 4e-4)

    def make(shape):
        made = timed(mean(), 0j, shape, (0.0, 24.0 * HOUR, 7), SPEED)
        return made, made.flown & (made.corners.real.max(axis=1) < 8e3)

    offered, allowed = make(shapes(complex(GOAL[0])))
    errors = allowed_errors(aim, offered, allowed)
    best = int(np.argmin(errors))
    shape, error = refine(aim, make, offered.corners[best], float(errors[best]))
    again, free = make(shape[None])
    assert free[0]
    assert error <= errors[best]
    assert aim.judge(again)[0] == pytest.approx(error, rel=1e-9)
    # of several loops the search loses nothing against that of one, and what it returns leaves the error that it states
    found, least = search(aim, make, shapes(complex(GOAL[0])), errors)
    again, free = make(found[None])
    assert free[0]
    assert least <= error
    assert aim.judge(again)[0] == pytest.approx(least, rel=1e-9)
    # where nothing else may be flown the survey waits
    waits, left = search(
        aim,
        make,
        shapes(complex(GOAL[0])),
        np.where(np.arange(errors.size) == WAITING, errors, np.inf),
    )
    assert not waits.any()
    assert left == errors[WAITING]


@pytest.mark.parametrize("changes", [False, True])
def test_what_is_predicted_comes_true_in_samples(changes):
    """Where the errors are small the stretch ends as far off as the linear prediction says; more is learnt by going than by waiting."""
    means = known(changes)
    times = slices(means, 0.0, 44.0 * HOUR)
    sea = drawn_sea(means, times, 80, 3)
    survey = timed(sea.mean, 0j, shapes(complex(GOAL[0])), (0.0, 24.0 * HOUR, 7), SPEED)
    planned = plan_transit(
        sea.mean, np.zeros(1, dtype=complex), 24.0 * HOUR, GOAL, 20.0 * HOUR, SPEED
    )
    sense = end_sensitivity(sea.mean, 0j, 24.0 * HOUR, planned)
    rows = rows_at(means, np.stack([sense.points.real, sense.points.imag], axis=-1), sense.times)
    aim = Aim(means, rows.combined(sense.weights), STRETCH.error**2)
    noise = np.random.default_rng(5).standard_normal((80, 7, 2))
    for k in (WAITING, SCOUTING):
        found = fly_after(sea, STRETCH, survey.picked([k]), noise)
        realised = float(np.sqrt(np.mean(np.abs(found.offsets) ** 2)))
        assert realised == pytest.approx(aim.judge(survey.picked([k]))[0], rel=0.35)
    now = fly_after(sea, STRETCH, None, noise)
    assert found.miss_90 < 0.8 * now.miss_90
    low, high = now.interval()
    assert low < now.miss_90 < high
    places_met, met, ends = fly_survey(sea, STRETCH, survey.picked([SCOUTING]))
    np.testing.assert_allclose(met[:, 2], sea.truth.at(places_met[:, 2], survey.times[2]))
    assert np.median(np.abs(ends)) < 2e3


def test_profiles_of_others_count():
    sea = drawn_sea(known(), np.zeros(1), 60, 3)
    noise = np.zeros((60, 7, 2))
    given = ((places(12, 7) * 0.5 + [9e3, 3e3], np.zeros(12)),)
    assert (
        fly_after(sea, STRETCH, None, noise, given).miss_90
        < 0.8 * fly_after(sea, STRETCH, None, noise).miss_90
    )


def test_ninety_percent_is_that():
    assert Flown(
        np.arange(101.0), np.zeros(101, dtype=complex), np.zeros(101)
    ).miss_90 == pytest.approx(90.0)


def test_a_miss_is_removed_where_the_current_shears_and_turns():
    lasts, miss = 10.0 * HOUR, np.array([900.0 - 500.0j])
    derivative = lasts * np.array([[[1.0, 0.4], [-0.2, 0.9]]])
    found = _solved(derivative, miss, lasts)
    moved = derivative[0] @ np.array([found.real, found.imag])[:, 0]
    np.testing.assert_allclose(moved, [900.0, -500.0], rtol=0.01)
    # where the end hardly depends on the velocity it is not changed much
    little = _solved(1e-3 * lasts * np.eye(2)[None], miss, lasts)
    assert np.abs(little) < np.abs(miss) / lasts
