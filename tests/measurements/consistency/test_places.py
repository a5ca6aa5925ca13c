"""Positions of two missions are told from those of one, and from wrong fixes."""

import pytest

from replay_kit.core.observation import VehicleState
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.monitor import ConsistencyState, check
from tests.measurements.samples import vehicle

HOUR, DAY = 3600.0, 86_400.0


def position(
    seconds: float, longitude: float, latitude: float = -40.0, log: int = 0
) -> VehicleState:
    return vehicle(seconds, longitude, latitude, log=log)


def found(*positions: VehicleState) -> list[str]:
    """What a log of these positions, in order of time, is said to be."""
    state = ConsistencyState()
    for one in sorted(positions, key=lambda one: one.time_ns):
        state, event = check(state, one)
        assert event is one
    return [str(finding) for finding in state.findings]


HERE = [position(HOUR * k, 152.0 + 0.01 * k) for k in range(20)]


@pytest.mark.parametrize(
    "other",
    [
        [position(HOUR * k + 60.0, 155.0, log=1) for k in range(20)],
        [position(HOUR * (30 + k), -30.0, 60.0, log=1) for k in range(5)],
        [position(400 * DAY + HOUR * k, 152.0, log=1) for k in range(5)],
        [position(-400 * DAY + HOUR * k, 152.0, log=1) for k in range(5)],
    ],
    ids=["beside it", "after it", "a year later", "a year before"],
)
def test_a_log_of_another_place_or_year_is_named_once_with_both(other):
    (words,) = found(*HERE, *other)
    assert words.startswith(findings.PLACES)
    assert "of log0)" in words
    assert "of log1)" in words
    # four positions are wrong fixes
    assert found(*HERE, *other[:4]) == []


def test_a_vehicle_that_goes_on_is_one_mission():
    # a ship's transit, a pause of months in the log, and a way across the antimeridian
    assert found(*(position(HOUR * k, 170.0 + 0.3 * k) for k in range(60))) == []
    assert found(*HERE, *(position(300 * DAY + HOUR * k, 160.0) for k in range(9))) == []


def test_wrong_fixes_are_no_mission():
    spikes = [position(HOUR * k + 60.0, 20.0 * k, 10.0 * k) for k in range(1, 9)]
    (words,) = found(*HERE, *spikes)
    assert words.startswith(findings.DISPLACED)
    # nor where the log begins with some
    assert found(*(position(-HOUR - k, 0.0, 0.0) for k in range(4)), *HERE) == []
