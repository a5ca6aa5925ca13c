"""What a stream measures does not depend on how it is cut into blocks. What it measures is the record's to say (``tests/record``)."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.config.run import LogConfig, MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.logs import merge, open_logs
from replay_kit.measurements.observed import blocks, rows
from tests.places import SAMPLES
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


def _messages(name: str) -> list[Message]:
    config = LogConfig()
    try:
        readers = open_logs(logs()[name], config, several_missions=True)
        return list(merge(readers, config.reorder_window))
    except rk.ReplayKitError as error:
        pytest.skip(f"{name}: {type(error).__name__}")


def _now(
    messages: Sequence[Message], config: MeasurementConfig, size: int = 4096
) -> tuple[list[Any], Counter]:
    found = list(blocks(messages, config, size))
    return [row for block in found for row in rows(block)], sum(
        (Counter(block.counts()) for block in found), Counter()
    )


def _same(a: Any, b: Any) -> bool:
    """Return whether two values are the same, NaN where the other is NaN."""
    if is_dataclass(a):
        names = [field.name for field in fields(a)]
        return type(a) is type(b) and all(_same(getattr(a, n), getattr(b, n)) for n in names)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    numbers = isinstance(a, float) or (isinstance(a, np.ndarray) and a.dtype.kind == "f")
    return bool(np.array_equal(a, b, equal_nan=numbers))


def _check(messages: Sequence[Message], settings: str, sizes: Sequence[int]) -> None:
    config = MeasurementConfig(**_SETTINGS[settings])
    whole, said = _now(messages, config)
    assert said.total() == len(messages)
    for size in sizes:
        found, says = _now(messages, config, size)
        assert says == said
        assert len(whole) == len(found)
        assert all(map(_same, whole, found)), size


@pytest.mark.parametrize("settings", _SETTINGS)
@pytest.mark.parametrize("name", _SAMPLES)
def test_blocks_of_any_size_are_equal_to_the_bit(name, settings):
    assert (SAMPLES / name).exists()
    _check(_messages(name)[:600], settings, (1, 7, 64))


@pytest.mark.full
@pytest.mark.parametrize("settings", _SETTINGS)
@pytest.mark.parametrize("name", sorted(set(logs()) - set(_SAMPLES)))
def test_blocks_of_real_logs_are_equal_to_the_bit(name, settings):
    _check(_messages(name)[:4000], settings, (7, 64, 3000))
