"""Topics that the configuration maps: every unit, sign and shape, and a wrong path said once."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation import Observation, VehicleState
from replay_kit.logs.tables.mapped import look_up
from tests.measurements.samples import (
    Skipped,
    Used,
    fix,
    logged,
    mapping,
    only,
    reasons,
    run,
    the,
)
from tests.measurements.turned import stated

PROFILE = {
    "topic": "/p",
    "kind": "profile",
    "reference": "earth",
    "frame": "enu",
    "cell_size": 4.0,
    "first_cell": 6.0,
}
POSITION = {"topic": "/p", "kind": "position", "longitude": "lon", "latitude": "lat"}


def entry(**fields):
    return mapping(fields)


def mapped(payload, config):
    return stated(logged("", payload, topic="/p"), config)


def profile(payload, vehicle_depth=0.0, **fields):
    config = mapping({**PROFILE, **fields})
    return run([fix(0, depth=vehicle_depth), logged("vendor.Thing", payload, topic="/p")], config)


def observed(payload, **fields):
    (observation,) = only(Observation, profile(payload, **fields))
    return observation


@pytest.mark.parametrize(
    ("path", "found"),
    [
        ("a.b.0", 10),
        ("a.b.-1.c", 3),
        ("cells.*.v", [1, None]),
        ("raw.0", 5),
        ("x", "the message holds a, cells, raw"),
        ("a.b.c", "at 'a.b' holds a list"),
        ("a.b.0.c", "at 'a.b.0' holds one int"),
        ("cells.1.v.w", "at 'cells.1.v' holds nothing"),
        ("a.*", "at 'a' holds b"),
    ],
)
def test_a_path_leads_to_a_value_or_says_what_stands_there(path, found):
    payload = {"a": {"b": [10, {"c": 3}]}, "cells": [{"v": 1}, {"v": None}], "raw": b"\x05"}
    if not isinstance(found, str):
        assert look_up(payload, path) == found
        return
    with pytest.raises(MeasurementError, match=found):
        look_up(payload, path)
    # one reason for all messages
    messages = [logged("vendor.Fix", payload, k, "/p") for k in range(3)]
    (reason,) = set(reasons(run(messages, entry(**POSITION | {"longitude": path}))))
    assert f"{path!r} leads nowhere" in reason


@pytest.mark.parametrize(
    ("unit", "each"), [("deg", 1.0), ("degE7", 1e7), ("rad", math.radians(1.0))]
)
def test_positions(unit, each):
    config = entry(**POSITION, angle_unit=unit, dead_reckoned=True, depth="p", depth_unit="bar")
    message = logged("", {"lon": 152.5 * each, "lat": -40.25 * each, "p": 10.0}, topic="/p")
    state = the(VehicleState, [message], config)
    assert (state.longitude, state.latitude) == pytest.approx((152.5, -40.25), abs=1e-12)
    assert (state.dead_reckoned, round(state.depth)) == (True, 99)
    zero = {"lon": 0, "lat": 0, "p": 1.0}
    assert "position is 0, 0" in the(Skipped, [message._replace(payload=zero)], config).reason


@pytest.mark.parametrize(
    ("fields", "value", "expected"),
    [
        ({}, 12.5, "depth"),
        ({"depth_positive": "up"}, -12.5, "depth"),
        ({"depth_unit": "cm"}, 1250, "depth"),
        ({"depth_unit": "dbar"}, 12.5, "pressure"),
        ({"depth_unit": "bar"}, 1.25, "pressure"),
        ({"depth_unit": "Pa"}, 125_000.0, "pressure"),
        ({"depth_unit": "Pa", "depth_absolute": True}, 226_325.0, "pressure"),
    ],
)
def test_depths_and_pressures(fields, value, expected):
    found = mapped(
        {"d": {"value": value}}, entry(topic="/p", kind="depth", depth="d.value", **fields)
    )
    assert found.by == expected
    assert getattr(found, expected) == pytest.approx(12.5, abs=1e-12)


@pytest.mark.parametrize(
    ("unit", "factor", "frame", "cell"),
    [
        ("m/s", 1, "enu", [0.125, -0.25, 0.5]),
        ("dm/s", 10, "ned", [-0.25, 0.125, -0.5]),
        ("cm/s", 100, "enu", [0.125, -0.25, 0.5]),
        ("mm/s", 1000, "ned", [-0.25, 0.125, -0.5]),
    ],
)
def test_speeds_and_frames(unit, factor, frame, cell):
    cell = [factor * value for value in cell]
    fields = {"velocity": "v", "speed_unit": unit, "frame": frame}
    for payload, more in (({"v": [cell] * 2}, {}), ({"v": cell * 2}, {"components": 3})):
        found = observed(payload, **fields, **more)
        assert_array_equal(found.velocity, [[0.125, -0.25]] * 2)


def test_columns_and_missing_numbers():
    cells = {"cells": [{"u": 100, "v": -32768}, {"u": 0, "v": 5}, {"u": None, "v": 1}]}
    columns = {
        "east": "cells.*.u",
        "north": "cells.*.v",
        "speed_unit": "mm/s",
        "missing": [-32768, 0],
    }
    found = observed(cells, **columns, velocity_std=0.04)
    assert_array_equal(found.velocity, [[0.1, np.nan], [np.nan, 0.005], [np.nan, 0.001]])
    assert_array_equal(found.error_std, 0.04)


@pytest.mark.parametrize(
    ("fields", "payload", "expected"),
    [
        ({}, {}, [106.0, 110.0]),
        ({"orientation": "up"}, {}, [94.0, 90.0]),
        (
            {"cell_size": "size", "first_cell": "first", "distance_unit": "cm"},
            {"size": 50, "first": 75},
            [100.75, 101.25],
        ),
        (
            {"cell_size": None, "first_cell": None, "distances": "at"},
            {"at": [3.0, 9.0]},
            [103.0, 109.0],
        ),
        (
            {"cell_size": None, "first_cell": None, "depths": "at", "depth_positive": "up"},
            {"at": [-3.0, -9.0]},
            [3.0, 9.0],
        ),
        ({"depth": "p", "depth_unit": "dbar"}, {"p": 0.0}, [6.0, 10.0]),
    ],
)
def test_where_the_cells_are(fields, payload, expected):
    fields = {key: value for key, value in {**PROFILE, **fields}.items() if value is not None}
    config = mapping({**fields, "velocity": "v"})
    message = logged("", {**payload, "v": [[0.1, 0.2]] * 2}, topic="/p")
    observation = the(Observation, [fix(0, depth=100.0), message], config)
    assert_array_equal(observation.depth, expected)


@pytest.mark.parametrize(
    ("payload", "fields", "words"),
    [
        ({"v": [0.1, 0.2, 0.3]}, {"velocity": "v", "components": 2}, "number of components"),
        ({"v": 0.1}, {"velocity": "v"}, "not a list"),
        ({"e": [1.0], "n": [1.0, 2.0]}, {"east": "e", "north": "n"}, "not lists of one length"),
        ({"v": []}, {"velocity": "v"}, "n_cells >= 1"),
        ({"v": [[0.1]]}, {"velocity": "v", "frame": "ned"}, "expected cells"),
    ],
)
def test_profiles_that_are_none(payload, fields, words):
    events = profile(payload, **fields)
    assert not only(Observation, events)
    assert words in reasons(events)[0]


@pytest.mark.parametrize(
    ("payload", "profiles", "positions"),
    [
        ({"v": [[0.1, 0.2]], "lon": 10.5, "lat": -30.0}, [10.5], [152.0, 10.5]),
        ({"v": [[0.1, 0.2]], "lon": 0.0, "lat": 0.0}, [152.0], [152.0]),
        # a position counts where the profile in its message does not
        ({"v": [[1.0]], "lon": 10.5, "lat": -30.0}, [], [152.0, 10.5]),
    ],
)
def test_a_profile_with_a_position_in_the_same_message(payload, profiles, positions):
    events = profile(payload, velocity="v", longitude="lon", latitude="lat")
    assert [one.longitude for one in only(Observation, events)] == profiles
    assert [one.longitude for one in only(VehicleState, events)] == positions
    assert len(only(Used, events)) == 1 + len(profiles)


def test_a_mapping_goes_before_a_known_kind():
    payload = {"relative_alt": -12_500, "lat": 0, "lon": 0}
    topic = "mavlink/1/1/GLOBAL_POSITION_INT"
    fields = {"topic": topic, "kind": "depth", "depth": "relative_alt"}
    config = entry(**fields, depth_positive="up", depth_unit="mm")
    found = stated(logged("GLOBAL_POSITION_INT", payload, topic=topic), config)
    assert (found.kind, found.depth) == ("depth", 12.5)


MOORING = {
    "topic": "/p",
    "kind": "velocity",
    "reference": "earth",
    "east": "v.0",
    "north": "v.1",
    "speed_unit": "cm/s",
    "velocity_std": 0.02,
}
PLACE = {"longitude": "lon", "latitude": "lat", "depth": "p", "depth_unit": "dbar"}


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"place": [150.5, -41.0], "at_depth": 80.0}, (150.5, -41.0, 80)),
        (PLACE, (151.0, -39.0, 100)),
        ({}, (152.0, -40.0, 40)),
    ],
)
def test_one_velocity_at_one_depth(fields, where):
    payload = {"v": [10.0, -20.0], "lon": 151.0, "lat": -39.0, "p": 101.0}
    messages = [fix(0, depth=40.0), logged("", payload, 5, "/p"), fix(10)]
    found = the(Observation, messages, entry(**MOORING, **fields))
    assert (found.longitude, found.latitude, round(float(found.depth[0]))) == where
    assert_allclose([*found.velocity[0], *found.error_std], [0.1, -0.2, 0.02])


@pytest.mark.parametrize("frame", ["beam", "instrument", "ship"])
def test_profiles_in_other_frames_keep_their_components(frame):
    payload = {"v": [[1.0, 2.0, 3.0, 4.0]]}
    found = mapped(payload, entry(**PROFILE | {"frame": frame, "velocity": "v"}))
    assert (found.frame, found.velocity.tolist()) == (frame, payload["v"])
