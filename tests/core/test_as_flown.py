"""How dives were flown, from what is known of each, and what their median is."""

import math
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.as_flown import AS_FLOWN, AsFlown, FlownDive, flown_dive
from replay_kit.core.errors import LogError

WAY = 0.3 * math.cos(math.radians(20.0))
DOWN = 0.3 * math.sin(math.radians(20.0))


def test_a_dive_of_one_yo_or_several_has_the_vertical_speed_of_all():
    # the path's depths need not hold the deepest
    dive = flown_dive(1000.0 / DOWN, (0.6 * WAY, 0.8 * WAY), [100.0, 490.0, 100.0], 500.0)
    found = dive.seconds, dive.depth, dive.along, dive.vertical
    assert found == pytest.approx((1000.0 / DOWN, 500.0, WAY, DOWN))
    twice = flown_dive(400.0 / DOWN, (WAY, 0.0), [50.0, 100.0, 50.0, 0.0, 50.0, 100.0], 100.0)
    assert twice.vertical == pytest.approx(DOWN)
    assert (dive.yos, twice.yos, AsFlown.of([dive, twice, twice]).yos) == (1, 2, 2)


@pytest.mark.parametrize(
    ("way", "deepest"),
    [((math.nan, 0.1), 300.0), ((0.1, 0.1), math.nan), ((0.1, 0.1), 0.0), ((0.01, 0.0), 300.0)],
)
def test_a_dive_that_goes_down_and_up_alone_or_is_not_known_shows_nothing(way, deepest):
    assert flown_dive(3600.0, way, [0.5 * deepest], deepest) is None


def test_how_a_vehicle_flew_is_the_median_of_its_dives_in_the_digits_in_which_it_is_said():
    stated = ((3600.0, 20.0, math.nan), (7000.0, 984.0, 2000.0), (7200.0, 986.0, math.nan))
    dives = [FlownDive(*each, 0.2, 0.1, radius=radius) for *each, radius in stated]
    flown = AsFlown.of(dives)
    assert flown.vertical == pytest.approx(0.1, abs=0.001)
    assert flown == replace(flown, speed=0.22, glide_angle_deg=27.0, depth=980.0, duration=7000.0)
    assert (flown.dives, flown.surface_time, flown.radius) == (3, None, 2000.0)
    alone = AsFlown.of(dives[:1])
    assert (alone.depth, alone.radius, alone.speed_std) == (20.0, None, None)
    assert "single dive" in alone.notes()[0]
    assert AsFlown.of([]) is None
    for each in (flown, alone):
        assert AsFlown.in_metadata({AS_FLOWN: each.to_record()}) == each
    assert AsFlown.in_metadata({"replay_kit.forecast": {}}) is None
    for damaged in ({"speed": "0.2"}, flown.to_record() | {"dives": "many"}):
        with pytest.raises(LogError, match=r"replay_kit\.as_flown: expected numbers"):
            AsFlown.in_metadata({AS_FLOWN: damaged})


def test_the_spread_of_the_dives_is_that_of_a_normal_distribution_whatever_one_of_them_did():
    rng = np.random.default_rng(3)
    ways, seconds = rng.normal(0.2, 0.02, 400), rng.normal(7200.0, 300.0, 400)
    ways[7] = 5.0
    dives = [FlownDive(lasts, 500.0, way, 0.0) for lasts, way in np.column_stack([seconds, ways])]
    flown = AsFlown.of(dives)
    assert flown.speed_std == pytest.approx(0.02, rel=0.1)
    assert flown.duration_std == pytest.approx(300.0, rel=0.1)
    assert flown.depth_std == 0.0


def test_the_time_at_the_surface_is_between_dives_that_follow_each_other():
    def apart(seconds):
        begins = (10**18 + round(k * seconds * 1e9) for k in (0, 1, 2, 9, 10))
        return AsFlown.of([FlownDive(7200.0, 500.0, 0.2, 0.1, begin) for begin in begins])

    assert apart(7800.0).surface_time == pytest.approx(600.0)
    assert "10 min" in apart(7800.0).notes()[0]
    # the fix that ends a dive begins the next one
    assert apart(7200.0).surface_time is None


@pytest.mark.parametrize(("speed", "plausible"), [(0.0, False), (0.17, True), (2.0, False)])
def test_a_speed_that_no_glider_has_is_told_from_one_that_it_has(speed, plausible):
    assert AsFlown.of([FlownDive(7200.0, 500.0, speed, 0.0)] * 3).is_plausible == plausible
