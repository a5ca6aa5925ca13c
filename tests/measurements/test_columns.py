"""Blocks in columns against one message at a time, as the rest of the program reads them, and against blocks of other sizes."""

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
from replay_kit.measurements import Skipped, Used, events_of
from replay_kit.measurements.observed import blocks, counts, rows
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


def _before(messages: Sequence[Message], config: MeasurementConfig) -> tuple[list[Any], Counter]:
    found = [event for events in events_of(messages, config) for event in events]
    said = Counter(
        (event.topic, event.reason if isinstance(event, Skipped) else "")
        for event in found
        if isinstance(event, Skipped | Used)
    )
    return [event for event in found if not isinstance(event, Skipped | Used)], said


def _now(
    messages: Sequence[Message], config: MeasurementConfig, size: int = 4096
) -> tuple[list[Any], Counter]:
    found = list(blocks(messages, config, size))
    return [row for block in found for row in rows(block)], Counter(counts(found))


def _same(a: Any, b: Any, tolerance: float) -> bool:
    """Return whether two values are the same, numbers to a tolerance."""
    if is_dataclass(a):
        names = [field.name for field in fields(a)]
        return type(a) is type(b) and all(
            _same(getattr(a, name), getattr(b, name), tolerance) for name in names
        )
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(_same, a, b, [tolerance] * len(a)))
    if isinstance(a, float) or (isinstance(a, np.ndarray) and a.dtype.kind == "f"):
        return np.shape(a) == np.shape(b) and np.allclose(
            a, b, rtol=tolerance, atol=tolerance, equal_nan=True
        )
    return bool(np.array_equal(a, b))


def _check(name: str, settings: str) -> None:
    messages, config = _messages(name), MeasurementConfig(**_SETTINGS[settings])
    (before, said), (now, says) = _before(messages, config), _now(messages, config)
    assert says == said
    assert len(now) == len(before)
    wrong = [k for k, pair in enumerate(zip(before, now, strict=True)) if not _same(*pair, 1e-9)]
    assert not wrong, (before[wrong[0]], now[wrong[0]])


@pytest.mark.parametrize("settings", _SETTINGS)
@pytest.mark.parametrize("name", _SAMPLES)
def test_columns_say_what_messages_said(name, settings):
    _check(name, settings)


@pytest.mark.full
@pytest.mark.parametrize("settings", _SETTINGS)
@pytest.mark.parametrize("name", sorted(set(logs()) - set(_SAMPLES)))
def test_columns_say_what_messages_of_real_logs_said(name, settings):
    _check(name, settings)


@pytest.mark.parametrize("name", _SAMPLES)
def test_blocks_of_any_size_are_equal_to_the_bit(name):
    assert (SAMPLES / name).exists()
    messages, config = _messages(name)[:1200], MeasurementConfig()
    whole, said = _now(messages, config)
    for size in (1, 7, 64):
        found, says = _now(messages, config, size)
        assert says == said
        assert all(map(_same, whole, found, [0.0] * len(whole))), size
        assert len(whole) == len(found)
