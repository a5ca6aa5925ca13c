"""Positions and depths of ArduPilot's logs: what is measured, what is computed, what is neither."""

from typing import Any

import pytest

from replay_kit.core.message import Message
from tests.measurements.samples import CONFIG, SECOND, Skipped, Used, events_of, only


def said(*messages: tuple[int, str, dict[str, Any]], system: int | None = None) -> list[Any]:
    """What the messages (second, schema or system/schema, payload) mean, without the plain ``Used``."""
    log = []
    for n, (second, schema, payload) in enumerate(messages):
        sender, _, name = schema.rpartition("/")
        log.append(Message(second * SECOND, f"mavlink/{sender or 1}/1/{name}", name, payload, 0, n))
    events = [event for each in events_of(log, CONFIG, system) for event in each]
    assert len(only(Used | Skipped, events)) == len(log)
    return [event for event in events if not isinstance(event, Used)]


def gps(fix_type: int) -> dict[str, Any]:
    return {"fix_type": fix_type, "lat": 473000000, "lon": -1246305732}


FILTER = {"lat": 473000000, "lon": -1246305732, "relative_alt": -2500}


def test_a_position_is_computed_when_the_last_fix_is_old():
    # without a GPS in the log it is taken at its word; another system's fix says nothing of this one
    position = "GLOBAL_POSITION_INT", FILTER
    (fix,) = said((0, *position))
    assert (fix.dead_reckoned, fix.latitude, fix.depth) == (False, pytest.approx(47.3), 2.5)
    assert not said((0, "GPS_RAW_INT", gps(3)), (8, "2/GLOBAL_POSITION_INT", FILTER))[
        0
    ].dead_reckoned
    again = (7, "GPS_RAW_INT", gps(4)), (7, *position)
    fixes = said((0, "GPS_RAW_INT", gps(3)), (5, *position), (6, *position), *again)
    assert [fix.dead_reckoned for fix in fixes] == [False, True, False]
    _, after = said((0, "GPS_RAW_INT", gps(2)), (1, *position))
    assert after.dead_reckoned


def test_dataflash_records():
    place = {"Lat": 47.3, "Lng": -124.63}
    first, filtered = said(
        (0, "dataflash.CTUN", {"Alt": -3.25, "BAlt": -9.0}),
        (0, "dataflash.GPS", {**place, "Status": 3, "I": 0}),
        (1, "dataflash.POS", place),
    )
    assert (first.latitude, first.longitude) == (47.3, -124.63)
    assert (first.depth, first.dead_reckoned) == (3.25, False)
    assert (filtered.depth, filtered.dead_reckoned) == (3.25, True)


@pytest.mark.parametrize(
    ("schema", "payload", "reason"),
    [
        ("dataflash.GPS", {"Lat": 47.3, "Lng": -124.6, "Status": 2}, "no fix (Status < 3)"),
        (
            "dataflash.GPS",
            {"Lat": 47.3, "Lng": -124.6, "Status": 4, "I": 1},
            "not the first GPS receiver",
        ),
        ("dataflash.POS", {"Lat": "x"}, "position is not a number"),
        ("dataflash.CTUN", {"Alt": float("nan")}, "depth is not a number"),
        ("GPS_RAW_INT", gps(2), "no fix (fix_type < 3)"),
        ("GLOBAL_POSITION_INT", FILTER | {"lat": 0, "lon": 0}, "position is 0, 0 (no fix)"),
        ("dataflash.BARO", {"Alt": -9.2, "I": 0}, "message type not used by the estimator"),
    ],
)
def test_what_is_not_used(schema, payload, reason):
    (event,) = said((0, schema, payload))
    assert event.reason == reason
