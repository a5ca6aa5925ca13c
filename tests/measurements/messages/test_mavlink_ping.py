"""A ping through a telemetry log and back: every number is what float32 holds of it, NaN stays NaN."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.logs import open_log
from replay_kit.logs.mavlink.writer import MAX_CELLS, write_tlog
from replay_kit.logs.tables.columns import raws_of
from replay_kit.logs.tables.frames import SCHEMA
from replay_kit.logs.tables.schemas import tables_of

STATED = (
    "heading",
    "pitch",
    "roll",
    "pressure",
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


def through_a_log(folder: Path, payload: dict[str, Any], time_ns: int) -> Any:
    """Return the ping that the frames in a log make."""
    write_tlog(folder / "log", [Message(time_ns, "/adcp", "replay_kit.AdcpPing", payload, 0, 0)])
    framed = [one for one in open_log(folder / "log").messages() if one.schema == SCHEMA]
    frames = [one for one in framed if str(one.payload["name"]).startswith("ADCP_")]
    keys = {(one.payload["array_id"], one.payload["time_usec"]) for one in frames}
    assert keys == {(payload["ping"] % 65536, time_ns // 1000)}
    assert {one.time_ns for one in framed} == {time_ns // 1000 * 1000}
    tables, pending = tables_of(raws_of(framed), MeasurementConfig())
    assert not pending
    (table,) = (one for one in tables if one.kind == "ping")
    assert table["messages"].tolist() == [len(frames)]
    return SimpleNamespace(
        **{name: column[0] for name, column in table.columns.items()}, **table.fixed
    )


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
    velocity = float32(
        [[np.nan if one is None else one for one in cell] for cell in payload["velocity"]]
    )
    assert_array_equal(back.velocity[:, : velocity.shape[1]], velocity)
    std = payload["velocity_std"]
    std = float32(std if isinstance(std, list) else [std] * payload["n_cells"])
    assert_array_equal(back.error_std, np.where((std >= 1e-6) & (std <= 1e3), std, np.nan))
    assert_array_equal(back.cell_size, float32(payload["cell_size"]))
    assert_array_equal(back.distance[0], float32(payload["bin0_distance"]))
    for name in STATED:
        assert_array_equal(getattr(back, name), float32(payload[name]))
