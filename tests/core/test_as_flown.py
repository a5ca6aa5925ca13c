"""How dives were flown, from what is known of each, and what their median is."""

import math

import pytest

from replay_kit.core.as_flown import AS_FLOWN, AsFlown, FlownDive, flown_dive
from replay_kit.core.errors import LogError

WAY = 0.3 * math.cos(math.radians(20.0))
DOWN = 0.3 * math.sin(math.radians(20.0))


def test_a_dive_down_and_up_has_the_vertical_speed_of_both():
    seconds = 2.0 * 500.0 / DOWN
    # the path's depths need not hold the deepest
    dive = flown_dive(seconds, (0.6 * WAY, 0.8 * WAY), [100.0, 300.0, 490.0, 300.0, 100.0], 500.0)
    assert (dive.seconds, dive.depth) == (seconds, 500.0)
    assert (dive.along, dive.vertical) == pytest.approx((WAY, DOWN))


def test_several_yos_between_surfacings_are_climbed_one_by_one():
    dive = flown_dive(
        4.0 * 100.0 / DOWN, (WAY, 0.0), [50.0, 100.0, 50.0, 0.0, 50.0, 100.0, 50.0], 100.0
    )
    assert dive.vertical == pytest.approx(DOWN)


@pytest.mark.parametrize(
    ("way", "deepest"),
    [((math.nan, 0.1), 300.0), ((0.1, 0.1), math.nan), ((0.1, 0.1), 0.0), ((0.01, 0.0), 300.0)],
)
def test_a_dive_that_goes_down_and_up_alone_or_is_not_known_shows_nothing(way, deepest):
    assert flown_dive(3600.0, way, [0.5 * deepest], deepest) is None


def test_how_a_vehicle_flew_is_the_median_of_its_dives_in_the_digits_in_which_it_is_said():
    dives = [
        FlownDive(seconds, depth, 0.2, 0.1)
        for seconds, depth in ((3600.0, 20.0), (7000.0, 984.0), (7200.0, 986.0))
    ]
    flown = AsFlown.of(dives)
    assert flown == AsFlown(speed=0.22, glide_angle_deg=27.0, depth=980.0, duration=7000.0, dives=3)
    assert AsFlown.of(dives[:1]).depth == 20.0
    assert AsFlown.of([]) is None
    assert AsFlown.in_metadata({AS_FLOWN: flown.to_record()}) == flown
    assert AsFlown.in_metadata({"replay_kit.forecast": {}}) is None
    for damaged in ({"speed": "0.2"}, flown.to_record() | {"dives": "many"}):
        with pytest.raises(LogError, match=r"replay_kit\.as_flown: expected numbers"):
            AsFlown.in_metadata({AS_FLOWN: damaged})
