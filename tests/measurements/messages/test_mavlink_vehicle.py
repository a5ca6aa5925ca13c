"""Positions and depths of ArduPilot's logs: what is measured, what is computed, what is neither."""

from typing import Any

import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import VehicleState
from replay_kit.logs import merge, open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.measurements import observations
from replay_kit.measurements.observed import begun
from replay_kit.workflows.replay.inputs.scan import MAVLINK_NAMES
from tests.logs.dataflash.dataflash_samples import dataflash
from tests.measurements.samples import Skipped, Used, interpret, ping

SECOND = 1_000_000_000


def said(*messages: tuple[int, str, dict[str, Any]]) -> list[Any]:
    """What the messages (second, schema or system/schema, payload) mean, without the plain ``Used``."""
    state, found = begun(), []
    for n, (second, schema, payload) in enumerate(messages):
        system, _, name = schema.rpartition("/")
        message = Message(second * SECOND, f"mavlink/{system or 1}/1/{name}", name, payload, 0, n)
        state, events = interpret(state, message, MeasurementConfig())
        assert sum(isinstance(event, Used | Skipped) for event in events) == 1
        found += [event for event in events if not isinstance(event, Used)]
    return [*found, state.memory.depths["depth"][0]]


def gps(fix_type: int) -> dict[str, Any]:
    return {"fix_type": fix_type, "lat": 473000000, "lon": -1246305732}


FILTER = {"lat": 473000000, "lon": -1246305732, "relative_alt": -2500}


def test_a_position_without_a_gps_in_the_log_is_taken_at_its_word():
    fix, depth = said((0, "GLOBAL_POSITION_INT", FILTER))
    assert isinstance(fix, VehicleState)
    assert (fix.dead_reckoned, fix.latitude, depth) == (False, pytest.approx(47.3), 2.5)


def test_a_position_is_computed_when_the_last_fix_is_old():
    fixes = said(
        (0, "GPS_RAW_INT", gps(3)),
        (5, "GLOBAL_POSITION_INT", FILTER),
        (6, "GLOBAL_POSITION_INT", FILTER),
        (7, "GPS_RAW_INT", gps(4)),
        (7, "GLOBAL_POSITION_INT", FILTER),
    )
    assert [fix.dead_reckoned for fix in fixes[:-1]] == [False, True, False]
    # another system's fix says nothing of this one
    fix, _ = said((0, "GPS_RAW_INT", gps(3)), (8, "2/GLOBAL_POSITION_INT", FILTER))
    assert fix.dead_reckoned is False


@pytest.mark.parametrize(("asked", "counts"), [(None, "1"), (1, "1"), (2, "2")])
def test_positions_of_one_system_count(asked, counts):
    state, places, skipped = begun(asked), [], []
    for n, system in enumerate("1212"):
        topic = f"mavlink/{system}/1/GLOBAL_POSITION_INT"
        message = Message(
            n * SECOND,
            topic,
            "GLOBAL_POSITION_INT",
            {**FILTER, "lon": 10_000_000 * int(system)},
            0,
            n,
        )
        state, events = interpret(state, message, MeasurementConfig())
        places += [event.longitude for event in events if isinstance(event, VehicleState)]
        skipped += [event for event in events if isinstance(event, Skipped)]
    assert places == [float(counts)] * 2
    assert len(skipped) == 2
    assert all("choose with system in [logs]" in event.reason for event in skipped)


def test_fixes_that_are_none():
    events = said(
        (0, "GPS_RAW_INT", gps(2)),
        (1, "GLOBAL_POSITION_INT", FILTER),
        (2, "GLOBAL_POSITION_INT", {**FILTER, "lat": 0, "lon": 0}),
    )
    assert events[0] == Skipped("mavlink/1/1/GPS_RAW_INT", "no fix (fix_type < 3)")
    assert events[1].dead_reckoned
    assert events[2] == Skipped("mavlink/1/1/GLOBAL_POSITION_INT", "position is 0, 0 (no fix)")


def test_dataflash_records():
    place = {"Lat": 47.3, "Lng": -124.63}
    first, filtered, depth = said(
        (0, "dataflash.CTUN", {"Alt": -3.25, "BAlt": -9.0}),
        (0, "dataflash.GPS", {**place, "Status": 3, "I": 0}),
        (1, "dataflash.POS", place),
    )
    assert (first.latitude, first.longitude, first.depth, first.dead_reckoned) == (
        47.3,
        -124.63,
        3.25,
        False,
    )
    assert (filtered.depth, filtered.dead_reckoned) == (3.25, True)
    assert depth == 3.25


def test_a_dataflash_log_places_the_pings_of_another_log(tmp_path):
    (tmp_path / "log.BIN").write_bytes(b"".join(dataflash(20)))
    start_ns = next(open_log(tmp_path / "log.BIN", wanted=MAVLINK_NAMES).messages()).time_ns
    write_mcap_log(
        tmp_path / "adcp.mcap",
        [ping(pressure=None)._replace(time_ns=start_ns + 10 * SECOND + SECOND // 2)],
    )
    logs = [
        open_log(tmp_path / name, n, wanted=MAVLINK_NAMES)
        for n, name in enumerate(("log.BIN", "adcp.mcap"))
    ]
    (observation,) = observations(merge(logs, 1.0))
    assert (observation.latitude, observation.longitude) == pytest.approx(
        (47.5, -124.6305732), abs=1e-5
    )
    # the depth that CTUN last said, and the distance to the first cell
    assert observation.depth[0] == 12.0 + 16.0


@pytest.mark.parametrize(
    ("schema", "payload", "reason"),
    [
        ("dataflash.GPS", {"Lat": 47.3, "Lng": -124.6, "Status": 2}, "no fix (Status < 3)"),
        (
            "dataflash.GPS",
            {"Lat": 47.3, "Lng": -124.6, "Status": 4, "I": 1},
            "not the first GPS receiver",
        ),
        ("dataflash.GPS", {"Lat": 0.0, "Lng": 0.0, "Status": 3}, "position is 0, 0 (no fix)"),
        ("dataflash.POS", {"Lat": "x"}, "position is not a number"),
        ("dataflash.CTUN", {"Alt": float("nan")}, "depth is not a number"),
        ("GPS_RAW_INT", {}, "no fix (fix_type < 3)"),
        ("dataflash.BARO", {"Alt": -9.2, "I": 0}, "message type not used by the estimator"),
    ],
)
def test_what_is_not_used(schema, payload, reason):
    (event, _) = said((0, schema, payload))
    assert event.reason == reason
