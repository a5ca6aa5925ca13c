"""Pings made absolute: what is turned, what is taken off, what is refused, and that nothing is done twice."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation, Reason
from tests.measurements.samples import fix, ping, reasons, run, the
from tests.measurements.turned import turned
from tests.reference import frames as slow

VECTORS = slow.janus_vectors(20.0)
LISTED = {"cell_size": None, "bin0_distance": None, "cell_distances": [16.0, 48.0, 80.0]}
WATER, VESSEL = np.array([0.4, -0.2, 0.02]), np.array([1.1, 0.3, 0.0])


def _raw(system: str, convention: str = "teledyne", **changes: Any) -> dict[str, Any]:
    """Return a ping of three equal cells over a moving vessel, as its instrument would store it; the heading is a true one."""
    angles = 35.0, 4.0, -3.0
    turn = getattr(slow, convention)(*angles, convention == "nortek").T
    axes = {"beam": VECTORS @ turn, "instrument": turn, "ship": slow.about(2, 35.0)}
    axes = axes.get(system, np.eye(3))
    track = {"velocity": (axes @ -VESSEL).tolist(), "velocity_std": 0.4, "distance": [300.0] * 4}
    own = {
        "coordinate_system": system,
        "reference": "platform",
        "attitude_convention": convention,
        "beam_unit_vectors": VECTORS.tolist(),
        "bin_mapped": False,
        "velocity": [(axes @ (WATER - VESSEL)).tolist()] * 3,
        "bottom_track": track,
        "velocity_std": None,
        "declination_applied": True,
    }
    own |= dict(zip(("heading", "pitch", "roll"), angles, strict=True))
    return ping(0).payload | own | changes


def _horizontal(ping: SimpleNamespace) -> Any:
    return ping.velocity[:, :2]


def assert_water(ping: SimpleNamespace) -> None:
    """Assert that all cells have the water's velocity over the ground."""
    assert_allclose(_horizontal(ping), np.tile(WATER[:2], (3, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("system", "convention"),
    [
        ("beam", "teledyne"),
        ("beam", "nortek"),
        ("instrument", "teledyne"),
        ("instrument", "nortek"),
        ("ship", "teledyne"),
        ("earth", "nortek"),
    ],
)
def test_every_coordinate_system_gives_the_current_over_the_ground(system, convention):
    absolute = turned(_raw(system, convention))
    assert_water(absolute)
    assert absolute.absolute
    assert np.isnan(absolute.error_std).all()
    assert_allclose(absolute.added, [*VESSEL[:2], 0.4], atol=1e-12)


@pytest.mark.parametrize("declination", [20.0, -20.0])
@pytest.mark.parametrize(
    ("changes", "velocity"),
    [
        ({"coordinate_system": "earth", "reference": "earth"}, [0.5, 3**0.5 / 2.0]),
        *(
            ({"attitude_convention": convention, "orientation": look}, forward)
            for convention, forward in (("teledyne", [0.0, 1.0]), ("nortek", [1.0, 0.0]))
            for look in ("down", "up")
        ),
    ],
)
def test_a_declination_east_turns_a_magnetic_heading_clockwise(changes, velocity, declination):
    """What flows forward along an instrument of magnetic heading 30 flows towards 30 plus the declination, whoever made it."""
    raw = _raw("instrument", heading=30.0, pitch=0.0, roll=0.0, bottom_track=None)
    raw |= {"velocity": [[*velocity, 0.0]] * 3, "beam_unit_vectors": None, **changes}
    raw |= {"declination_applied": False, "magnetic_declination": declination}
    bearing = np.deg2rad(30.0 + declination)
    expected = np.tile([np.sin(bearing), np.cos(bearing)], (3, 1))
    assert_allclose(_horizontal(turned(raw)), expected, atol=1e-12)


def test_the_configured_declination_is_for_pings_that_state_none():
    unknown = _raw("ship", declination_applied=False, magnetic_declination=None, heading=25.0)
    assert_water(turned(unknown, MeasurementConfig(magnetic_declination=10.0)))
    own = unknown | {"magnetic_declination": 10.0}
    assert_water(turned(own, MeasurementConfig(magnetic_declination=-90.0)))


def test_a_lost_beam_is_solved_around_in_water_and_bottom():
    raw = _raw("beam")
    raw["velocity"] = [row if k else [None, *row[1:]] for k, row in enumerate(raw["velocity"])]
    raw["bottom_track"]["velocity"][3] = None
    assert_water(turned(raw))
    raw["velocity"][1] = [None, None, 0.1, 0.2]
    assert np.isnan(_horizontal(turned(raw))[1]).all()


def test_gps_stands_in_for_a_lost_bottom():
    own = {"east": VESSEL[0], "north": VESSEL[1], "velocity_std": 0.4, "source": "gps"}
    for track in (None, {"velocity": [None] * 4}, {"velocity": "deep"}, "lost"):
        absolute = turned(_raw("beam", bottom_track=track, platform_velocity=own))
        assert_water(absolute)
        assert_array_equal(absolute.added, [*VESSEL[:2], 0.4])


def test_a_beams_stated_error_grows_in_the_solution():
    absolute = turned(_raw("beam", velocity_std=[0.1, 0.2, 0.3]))
    # two beams at 20 degrees from the vertical give a component: 1 / (sqrt(2) sin 20)
    expected = np.array([0.1, 0.2, 0.3]) / (np.sqrt(2.0) * np.sin(np.deg2rad(20.0)))
    assert_allclose(absolute.error_std, expected)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"heading": None}, "heading, pitch or roll is not known"),
        ({"roll": float("nan")}, "heading, pitch or roll is not known"),
        (
            {"attitude_convention": None},
            "expected attitude_convention to be one of teledyne, nortek",
        ),
        ({"beam_unit_vectors": [[0.1, 0.2]]}, "three numbers a beam"),
        ({"beam_unit_vectors": None}, "three numbers a beam"),
        ({"beam_unit_vectors": [[0.0, 0.0, 2.0]] * 4}, "vectors of length 1"),
        ({"orientation": "left"}, "expected orientation"),
        ({"declination_applied": False}, "declination unknown"),
        *(
            (LISTED | {"cell_distances": distances}, "evenly spaced")
            for distances in ([16.0, 48.0, 81.0], [80.0, 48.0, 16.0], [16.0, None, 80.0])
        ),
    ],
)
def test_a_rotation_that_lacks_something_is_refused_with_the_reason(changes, reason):
    with pytest.raises(ValueError, match=reason):
        turned(_raw("beam", **changes))


def test_a_raw_ping_becomes_an_observation():
    message = ping(0)._replace(payload=_raw("beam", correlation_depth=16.0))
    observation = the(Observation, [fix(0), message], MeasurementConfig(velocity_std=0.3))
    # the reference's error is one for all bins, not each bin's own
    assert_allclose(observation.error_std, 0.3)
    assert (observation.common_std, observation.correlation_depth) == (0.4, 16.0)
    assert_allclose(observation.platform_velocity, VESSEL[:2], atol=1e-12)
    # a ping that came absolute says nothing of a platform
    plain = the(Observation, [fix(0), ping(0)])
    assert (plain.reference, plain.common_std, plain.platform_velocity) == ("earth", 0.0, None)


OF_UNKNOWN_ERROR = {"east": 1.0, "north": 0.0, "velocity_std": 90.0}


@pytest.mark.parametrize("own", [None, {"east": 1.0, "velocity_std": 0.1}, OF_UNKNOWN_ERROR, 3])
def test_a_ping_of_a_platform_of_unknown_motion_is_a_relative_observation(own):
    raw = _raw("ship", bottom_track=None, platform_velocity=own)
    messages = [fix(0), ping(0)._replace(payload=raw)]
    observation = the(Observation, messages, MeasurementConfig(correlation_depth=8.0))
    assert_allclose(observation.velocity, np.tile((WATER - VESSEL)[:2], (3, 1)), atol=1e-12)
    found = observation.reference, observation.common_std, observation.platform_velocity
    assert (*found, observation.correlation_depth) == ("platform", np.inf, None, 8.0)
    refused = run(messages, MeasurementConfig(use_relative=False))
    assert "relative to the platform" in reasons(refused)[0]


def test_listed_cells_are_mapped_as_spaced_ones_are():
    sheared = _raw("beam")
    sheared["velocity"] = [
        [(k + 1) * value for value in row] for k, row in enumerate(sheared["velocity"])
    ]
    absolute = turned(sheared | LISTED)
    assert_allclose(_horizontal(absolute), _horizontal(turned(sheared)), atol=1e-12)
    assert np.isfinite(_horizontal(absolute)).all()


@pytest.mark.parametrize(
    ("cells", "depths", "flagged"),
    [({}, [100.0, None, 90.0, 95.0], [2]), (LISTED, [60.0, None, 70.0, 65.0], [1, 2])],
)
def test_bins_below_the_bottom_are_flagged(cells, depths, flagged):
    spoiled = ping(0, **cells, bottom_track={"distance": depths})
    below = the(Observation, [fix(0), spoiled]).reasons & Reason.BELOW_BOTTOM
    assert np.flatnonzero(below).tolist() == flagged
