"""``[[measurements.map]]`` in a configuration: read, written again, and refused with the key that is wrong."""

import pytest

from replay_kit.config.run import load_config
from replay_kit.core.errors import ConfigError
from replay_kit.workflows.replay.inputs.provenance import run_settings_toml
from tests.measurements.messages.test_mapped import MOORING, POSITION, PROFILE

TOML = """
[[measurements.map]]
topic = "/nav"
kind = "position"
longitude = "x.0"
latitude = "x.1"
angle_unit = "rad"

[[measurements.map]]
topic = "/\\u2248 \\"adcp\\""
kind = "profile"
reference = "earth"
frame = "ned"
velocity = "cells.*.v"
missing = [-32768.0]
cell_size = "size"
first_cell = 2.5
"""


def test_mappings_in_toml(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(TOML)
    config = load_config(path)
    assert [kind.kind for kind in config.measurements.map] == ["position", "profile"]
    assert config.measurements.map[1].topic == '/\u2248 "adcp"'
    path.write_text(run_settings_toml(config), encoding="utf-8")
    assert load_config(path) == config


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({**POSITION, "lattitude": "y"}, r"unknown key '.*lattitude'; known here: .*latitude"),
        (
            {"topic": "/p", "kind": "depth", "depth": "d", "unit": "m"},
            r"unknown key '.*unit'; known here: .*depth_unit",
        ),
        ({**POSITION, "kind": "place"}, "'position', 'depth', 'profile'"),
        ({**POSITION, "latitude": "a..b"}, "latitude"),
        ({**POSITION, "angle_unit": "grad"}, "'deg', 'rad'"),
        (PROFILE, "give velocity, or east and north"),
        (
            {**PROFILE, "velocity": "v", "east": "e", "north": "n"},
            "give velocity, or east and north",
        ),
        ({**PROFILE, "east": "e", "north": "n", "frame": "beam"}, "not in a frame 'beam'"),
        ({**PROFILE, "velocity": "v", "latitude": "y"}, "longitude and latitude, or neither"),
        ({**PROFILE, "velocity": "v", "distances": "d"}, "give one of depths"),
        *(
            ({**MOORING, **half}, words)
            for half, words in (
                ({"place": [150.5, -41.0]}, "at_depth"),
                ({"longitude": "lon"}, "latitude"),
            )
        ),
        (
            {key: value for key, value in PROFILE.items() if key != "reference"}
            | {"velocity": "v"},
            "reference",
        ),
    ],
)
def test_a_wrong_mapping_is_an_error(fields, words):
    with pytest.raises(ConfigError, match=words):
        load_config(None, {"measurements": {"map": [fields]}})
