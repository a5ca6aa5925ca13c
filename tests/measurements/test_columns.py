"""What a stream measures does not depend on how it is cut into blocks. What it measures is the record's to say (``tests/record``)."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.config.run import LogConfig, MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.logs import merge, open_logs
from replay_kit.measurements.observed import blocks, rows
from tests.measurements.samples import fix, ping
from tests.record.measured import logs

# each exercises what the others leave out
_SETTINGS = {
    "default": {},
    "absolute alone": {"use_relative": False, "without": ("dac",)},
    "not inverted": {"use_inverted": False, "dead_reckoning": "through_water"},
    "declination": {"magnetic_declination": 5.0, "reference": "earth", "velocity_unit": "cm/s"},
    "short": {"position_max_age": 5.0, "max_speed": 1.0, "surface_depth": 0.5},
    "water track": {"water_track_distance": 5.0, "magnetic_declination": 0.0},
}
_SAMPLES = ("glider.mcap", "glider.tlog", "survey.mcap")


def _pings() -> list[Message]:
    """Return messages of pings of all sorts: of different cells, with and without beams, up and down, bad ones, in dives and not."""
    rng = np.random.default_rng(3)
    tilted = {"attitude_convention": "nortek", "pitch": 12.0, "roll": 2.0}
    tracked = {"bottom_track": {"velocity": [], "distance": [25.0, 30.0]}, "reference": "platform"}
    up = {"orientation": "up", "transducer_depth": 20.0}
    messages = [fix(0.0, depth=0.0)]
    for k in range(1, 60):
        n = int(rng.choice([3, 6, 7]))
        changes = {"n_cells": n, "velocity_std": 0.05, "cell_size": 4.0, "bin0_distance": 6.0}
        changes["velocity"] = rng.normal(0.0, 0.4, (n - (k % 9 == 0), 3)).tolist()
        for name in ("correlation", "amplitude", "percent_good"):
            if rng.random() < 0.5:
                changes[name] = rng.uniform(10.0, 100.0, (n, int(rng.choice([1, 4])))).tolist()
        for some in (tilted, tracked, up):
            changes |= some if rng.random() < 0.3 else {}
        messages += [ping(10.0 * k + more, **changes) for more in (0.0, 3.0)]
        if k % 4 == 0:
            depth = float(rng.choice([0.0, 40.0]))
            messages.append(fix(10.0 * k + 1.0, 152.0 + 1e-4 * k, depth=depth))
    return messages


def _messages(name: str) -> list[Message]:
    config = LogConfig()
    try:
        readers = open_logs(logs()[name], config, several_missions=True)
        return list(merge(readers, config.reorder_window))
    except rk.ReplayKitError as error:
        pytest.skip(f"{name}: {type(error).__name__}")


def _check(messages: Sequence[Message], settings: str, sizes: Sequence[int]) -> bool:
    """Return whether messages hold observations, which are equal however they are cut."""
    found = []
    for size in (4096, *sizes):
        parts = list(blocks(messages, MeasurementConfig(**_SETTINGS[settings]), size))
        said = sum((Counter(block.counts()) for block in parts), Counter())
        found.append((said, [asdict(row) for block in parts for row in rows(block)]))
    (said, whole), *others = found
    assert said.total() == len(messages)
    for other in others:
        assert other[0] == said
        np.testing.assert_equal(other[1], whole)
    return bool(whole)


@pytest.mark.parametrize("settings", _SETTINGS)
def test_blocks_of_any_size_are_equal_to_the_bit(settings):
    assert _check(_pings(), settings, (1,) if settings == "default" else (13,))


@pytest.mark.parametrize("name", _SAMPLES)
def test_blocks_of_a_log_are_equal_to_the_bit(name):
    assert _check(_messages(name)[:300], "default", (7,))


@pytest.mark.full
@pytest.mark.parametrize("settings", _SETTINGS)
@pytest.mark.parametrize("name", sorted(logs()))
def test_blocks_of_all_logs_are_equal_to_the_bit(name, settings):
    _check(_messages(name)[:4000], settings, (7, 64, 3000))
