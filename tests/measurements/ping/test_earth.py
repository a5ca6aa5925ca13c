"""Pings made absolute: what is turned, what is taken off, what is refused, and that nothing is done twice."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation, Reason
from tests.measurements.samples import CONFIG, ODD, counted, fix, ping, reasons, run, the
from tests.measurements.turned import stated, turned
from tests.reference import frames as slow

VECTORS = slow.janus_vectors(20.0)
WATER, VESSEL = np.array([0.4, -0.2, 0.02]), np.array([1.1, 0.3, 0.0])


def _raw(system: str, convention: str = "teledyne", **changes: Any) -> dict[str, Any]:
    """Return a ping of three equal cells over a moving vessel, as its instrument would store it; the heading is a true one."""
    heading, pitch, roll = 35.0, 4.0, -3.0
    turn = (
        slow.nortek(heading, pitch, roll, True)
        if convention == "nortek"
        else slow.teledyne(heading, pitch, roll, False)
    )
    relative = {"water": WATER - VESSEL, "bottom": -VESSEL}
    for name, velocity in relative.items():
        axes = {
            "instrument": turn.T @ velocity,
            "ship": slow.about(2, heading) @ velocity,
            "earth": velocity,
        }
        relative[name] = VECTORS @ (turn.T @ velocity) if system == "beam" else axes[system]
    payload = {
        **ping(0).payload,
        "coordinate_system": system,
        "reference": "platform",
        "attitude_convention": convention,
        "beam_unit_vectors": VECTORS.tolist(),
        "bin_mapped": False,
        "velocity": [relative["water"].tolist()] * 3,
        "bottom_track": {
            "velocity": relative["bottom"].tolist(),
            "velocity_std": 0.4,
            "distance": [300.0] * 4,
        },
        "velocity_std": None,
        "declination_applied": True,
    }
    return {**payload, "heading": heading, "pitch": pitch, "roll": roll, **changes}


def _absolute(payload: dict[str, Any], config: MeasurementConfig = CONFIG) -> SimpleNamespace:
    return turned(payload, config)


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
    absolute = _absolute(_raw(system, convention))
    assert_water(absolute)
    assert absolute.absolute
    assert np.isnan(absolute.error_std).all()
    assert_allclose(absolute.added, [*VESSEL[:2], 0.4], atol=1e-12)


def test_what_is_absolute_stays_as_it_is():
    same = _absolute(ping(0).payload)
    assert_array_equal(same.velocity, same.raw)
    assert (same.absolute, np.isnan(same.added).all()) == (True, True)


def test_words_and_truths_may_be_the_numbers_of_mavlink():
    numbers = {
        "coordinate_system": 2.0,
        "reference": 1.0,
        "orientation": 0.0,
        "declination_applied": 1.0,
        "bin_mapped": 0.0,
    }
    absolute = _absolute(_raw("ship", **numbers))
    assert_water(absolute)


def test_a_declination_turns_a_velocity_once():
    magnetic = {
        "declination_applied": False,
        "magnetic_declination": 90.0,
        "reference": "earth",
        "velocity": [[0.0, 1.0, None]] * 3,
    }
    absolute = _absolute({**ping(0).payload, **magnetic})
    assert_allclose(_horizontal(absolute), np.tile([1.0, 0.0], (3, 1)), atol=1e-15)


@pytest.mark.parametrize("orientation", ["down", "up"])
@pytest.mark.parametrize(
    ("convention", "forward"), [("teledyne", [0.0, 1.0, 0.0]), ("nortek", [1.0, 0.0, 0.0])]
)
@pytest.mark.parametrize("declination", [20.0, -20.0])
def test_a_declination_east_turns_a_magnetic_heading_clockwise(
    convention, forward, orientation, declination
):
    """What flows forward along an instrument of magnetic heading 30 flows towards 30 plus the declination, whoever made it."""
    raw = _raw(
        "instrument",
        convention,
        orientation=orientation,
        heading=30.0,
        pitch=0.0,
        roll=0.0,
        bottom_track=None,
    )
    raw |= {
        "velocity": [forward] * 3,
        "beam_unit_vectors": None,
        "declination_applied": False,
        "magnetic_declination": declination,
    }
    bearing = np.deg2rad(30.0 + declination)
    expected = np.tile([np.sin(bearing), np.cos(bearing)], (3, 1))
    assert_allclose(_horizontal(_absolute(raw)), expected, atol=1e-12)


def test_the_configured_declination_is_for_pings_that_state_none():
    unknown = _raw("ship", declination_applied=False, magnetic_declination=None, heading=25.0)
    with pytest.raises(ValueError, match="declination unknown"):
        _absolute(unknown)
    absolute = _absolute(unknown, MeasurementConfig(magnetic_declination=10.0))
    assert_water(absolute)
    own = _absolute(
        {**unknown, "magnetic_declination": 10.0}, MeasurementConfig(magnetic_declination=-90.0)
    )
    assert_allclose(_horizontal(own), _horizontal(absolute))


def test_a_lost_beam_is_solved_around_in_water_and_bottom():
    raw = _raw("beam")
    raw["velocity"] = [row if k else [None, *row[1:]] for k, row in enumerate(raw["velocity"])]
    raw["bottom_track"]["velocity"][3] = None
    assert_water(_absolute(raw))
    raw["velocity"][1] = [None, None, 0.1, 0.2]
    assert np.isnan(_horizontal(_absolute(raw))[1]).all()


def test_gps_stands_in_for_a_lost_bottom():
    own = {"east": VESSEL[0], "north": VESSEL[1], "velocity_std": 0.4, "source": "gps"}
    for track in (None, {"velocity": [None] * 4}, {"velocity": "deep"}, "lost"):
        absolute = _absolute(_raw("beam", bottom_track=track, platform_velocity=own))
        assert_water(absolute)
        assert_array_equal(absolute.added, [*VESSEL[:2], 0.4])


@pytest.mark.parametrize(
    "own",
    [
        None,
        {"east": 1.0, "north": None, "velocity_std": 0.1},
        {"east": 1.0, "north": 0.0, "velocity_std": 90.0},
        3,
    ],
)
def test_without_a_motion_a_ping_stays_relative(own):
    relative = _absolute(_raw("beam", bottom_track=None, platform_velocity=own))
    assert_allclose(_horizontal(relative), np.tile((WATER - VESSEL)[:2], (3, 1)), atol=1e-12)
    assert (relative.absolute, np.isnan(relative.added).all()) == (False, True)


def test_a_beams_stated_error_grows_in_the_solution():
    absolute = _absolute(_raw("beam", velocity_std=[0.1, 0.2, 0.3]))
    # two beams at 20 degrees from the vertical give a component: 1 / (sqrt(2) sin 20)
    expected = np.array([0.1, 0.2, 0.3]) / (np.sqrt(2.0) * np.sin(np.deg2rad(20.0)))
    assert_allclose(absolute.error_std, expected)


def test_flat_arrays_are_those_of_protobuf():
    raw = _raw("beam")
    flat = {
        "velocity": list(np.ravel(raw["velocity"])),
        "beam_unit_vectors": list(np.ravel(raw["beam_unit_vectors"])),
    }
    found, expected = (
        vars(stated(ping(0)._replace(payload=payload)))
        for payload in ({**raw, **flat, "velocity_std": []}, raw)
    )
    for name in set(found) - {"layout"}:
        np.testing.assert_equal(found[name], expected[name])
    # protobuf writes an empty list for what is not known
    unknown = _absolute(_raw("instrument", beam_unit_vectors=[]))
    assert_water(unknown)


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
    ],
)
def test_a_rotation_that_lacks_something_is_refused_with_the_reason(changes, reason):
    with pytest.raises(ValueError, match=reason):
        _absolute(_raw("beam", **changes))


@pytest.mark.parametrize("system", ["beam", "instrument", "ship", "earth"])
def test_junk_in_any_field_is_used_or_skipped_once(system):
    raw = _raw(system, platform_velocity=None, tilt_applied=True)
    arrays = ([[1e308] * 4] * 3, [[0.0] * 3] * 4, {"velocity": [1e308] * 4}, {"distance": ["b"]})
    for field in raw:
        for value in (*ODD, *arrays):
            message = ping(0)._replace(payload={**raw, field: value})
            assert counted(run([fix(0), message]), "/adcp") == 1, (field, value)


def test_a_raw_ping_becomes_an_observation():
    message = ping(0)
    raw = _raw("beam", correlation_depth=16.0)
    observation = the(
        Observation, [fix(0), message._replace(payload=raw)], MeasurementConfig(velocity_std=0.3)
    )
    assert_allclose(observation.velocity, np.tile(WATER[:2], (3, 1)), atol=1e-12)
    # the reference's error is one for all bins, not each bin's own
    assert_allclose(observation.error_std, 0.3)
    assert (observation.reference, observation.common_std, observation.correlation_depth) == (
        "earth",
        0.4,
        16.0,
    )
    assert_allclose(observation.platform_velocity, VESSEL[:2], atol=1e-12)


def test_a_ping_of_a_platform_of_unknown_motion_is_a_relative_observation():
    relative = ping(0)._replace(payload=_raw("ship", bottom_track=None))
    config = MeasurementConfig(correlation_depth=8.0)
    observation = the(Observation, [fix(0), relative], config)
    assert_allclose(observation.velocity, np.tile((WATER - VESSEL)[:2], (3, 1)), atol=1e-12)
    assert (observation.reference, observation.common_std, observation.platform_velocity) == (
        "platform",
        np.inf,
        None,
    )
    assert observation.correlation_depth == 8.0
    refused = run([fix(0), relative], MeasurementConfig(use_relative=False))
    assert "relative to the platform" in reasons(refused)[0]
    # a ping that came absolute says nothing of a platform
    plain = the(Observation, [fix(0), ping(0)])
    assert (plain.reference, plain.common_std, plain.platform_velocity) == ("earth", 0.0, None)


def test_velocities_of_an_unknown_declination_are_not_taken_as_true():
    magnetic = {**ping(0).payload, "declination_applied": False, "magnetic_declination": None}
    with pytest.raises(ValueError, match="declination unknown"):
        _absolute(magnetic)
    known = _absolute({**magnetic, "magnetic_declination": 0.0})
    assert_array_equal(known.velocity, known.raw)


LISTED = {"cell_size": None, "bin0_distance": None, "cell_distances": [16.0, 48.0, 80.0]}


def test_listed_cells_are_mapped_as_spaced_ones_are():
    sheared = _raw("beam")
    sheared["velocity"] = [
        [(k + 1) * value for value in row] for k, row in enumerate(sheared["velocity"])
    ]
    absolute = _absolute(sheared | LISTED)
    assert_allclose(_horizontal(absolute), _horizontal(_absolute(sheared)), atol=1e-12)
    assert np.isfinite(_horizontal(absolute)).all()


@pytest.mark.parametrize("distances", [[16.0, 48.0, 81.0], [80.0, 48.0, 16.0], [16.0, None, 80.0]])
def test_cells_that_are_not_evenly_spaced_cannot_be_mapped(distances):
    with pytest.raises(ValueError, match="evenly spaced"):
        _absolute(_raw("beam", **LISTED | {"cell_distances": distances}))


@pytest.mark.parametrize(
    ("cells", "depths", "flagged"),
    [({}, [100.0, None, 90.0, 95.0], [2]), (LISTED, [60.0, None, 70.0, 65.0], [1, 2])],
)
def test_bins_below_the_bottom_are_flagged(cells, depths, flagged):
    spoiled = ping(0, **cells, bottom_track={"distance": depths})
    below = the(Observation, [fix(0), spoiled]).reasons & Reason.BELOW_BOTTOM
    assert np.flatnonzero(below).tolist() == flagged
