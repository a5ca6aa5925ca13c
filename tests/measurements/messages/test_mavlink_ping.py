"""A ping through a telemetry log and back: every number is what float32 holds of it, NaN stays NaN."""

from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from replay_kit.core.message import Message
from replay_kit.logs import open_log
from replay_kit.logs.mavlink.writer import MAX_CELLS, write_tlog
from replay_kit.measurements.messages.mavlink import (
    SCHEMA,
    PingFrame,
    assemble,
    is_complete,
    ping_frame,
)

STATED = (
    "heading",
    "pitch",
    "roll",
    "pressure",
    "sound_speed",
    "temperature",
    "transducer_depth",
)
# NaN is "unknown", as null is; infinities are no velocities
NUMBER = st.one_of(st.none(), st.floats(-1e6, 1e6, allow_nan=False))
POSITIVE = st.floats(1e-3, 1e4)


@st.composite
def pings(draw: st.DrawFn) -> dict[str, Any]:
    cells = draw(st.integers(1, MAX_CELLS))
    column = st.lists(NUMBER, min_size=cells, max_size=cells)
    return {
        "ping": draw(st.integers(0, 2**32)),
        "coordinate_system": draw(st.sampled_from(["beam", "instrument", "ship", "earth"])),
        "reference": draw(st.sampled_from(["earth", "platform"])),
        "orientation": draw(st.sampled_from(["down", "up"])),
        "n_cells": cells,
        "cell_size": draw(POSITIVE),
        "bin0_distance": draw(POSITIVE),
        "velocity": [
            list(cell)
            for cell in zip(*(draw(column) for _ in range(draw(st.integers(2, 3)))), strict=True)
        ],
        "velocity_std": draw(st.one_of(column, POSITIVE, st.none())),
        **{name: draw(NUMBER) for name in STATED},
    }


def frames_in(path: Path) -> tuple[set[int], list[PingFrame]]:
    """Return the times [ns] and the frames of the pings in a log."""
    found = [
        (message.time_ns, ping_frame(message))
        for message in open_log(path).messages()
        if message.schema == SCHEMA
    ]
    return {time_ns for time_ns, _ in found}, [frame for _, frame in found if frame is not None]


def through_a_log(folder: Path, payload: dict[str, Any], time_ns: int) -> dict[str, Any]:
    write_tlog(folder / "log", [Message(time_ns, "/adcp", "replay_kit.AdcpPing", payload, 0, 0)])
    times_ns, frames = frames_in(folder / "log")
    assert {frame.key[1:] for frame in frames} == {(payload["ping"] % 65536, time_ns // 1000)}
    assert times_ns == {time_ns // 1000 * 1000}
    by_name = {frame.name: frame for frame in frames}
    assert is_complete(by_name)
    return assemble(by_name)


def float32(values: Any) -> Any:
    return np.array(values, dtype=np.float64).astype(np.float32)


@settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(payload=pings(), time_us=st.integers(1_000_000_000_000_000, 4_000_000_000_000_000))
def test_a_ping_comes_back_to_the_last_bit_of_float32(tmp_path, payload, time_us):
    back = through_a_log(tmp_path, payload, time_us * 1000)
    cells = payload["n_cells"]
    assert back["n_cells"] == cells
    assert_array_equal(np.array(back["velocity"]), float32(payload["velocity"]))
    std = payload["velocity_std"]
    assert_array_equal(
        np.array(back["velocity_std"]), float32(std if isinstance(std, list) else [std] * cells)
    )
    for name in ("cell_size", "bin0_distance", *STATED):
        assert_array_equal(back[name], float32(payload[name]))
