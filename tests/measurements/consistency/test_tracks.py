"""Tracks of two vehicles are told from two logs of one, however those err."""

from collections.abc import Iterable

import numpy as np
import pytest

from replay_kit.core.observation import VehicleState
from replay_kit.measurements.consistency.tracks import LogTracks, Passages
from tests.measurements.samples import vehicle

MINUTE, HOUR = 60.0, 3600.0
# 0.3 m/s to the east at 40 S [degrees/s], and 65 km
SLOW, FAR = 0.3 / 85.4e3, 65.0 / 85.4


def position(seconds: float, longitude: float, log: int, reckoned: bool = False) -> VehicleState:
    return vehicle(seconds, longitude, dead_reckoned=reckoned, log=log)


def track(
    log: int,
    every: float,
    hours: float = 48.0,
    west: float = 152.0,
    speed: float = SLOW,
    begin: float = 0.0,
    error: float = 0.0,
):
    """The fixes of a log; its errors [degrees] are seeded."""
    times = np.arange(begin, begin + hours * HOUR, every)
    wrong = np.random.default_rng(log).normal(0.0, error, times.size)
    return [
        position(time, west + speed * time + off, log)
        for time, off in zip(times, wrong, strict=True)
    ]


def two_vehicles(*logs: Iterable[VehicleState]) -> Passages | None:
    """What of logs in one order of time is said."""
    tracks = LogTracks()
    for one in sorted((one for log in logs for one in log), key=lambda one: one.time_ns):
        tracks = tracks.after(one)
    return tracks.two_vehicles


def with_reckoning(log: int, error_km: float) -> list[VehicleState]:
    """Dives of six hours, reckoned ever farther from where the fixes are."""
    out = []
    for dive in range(8):
        begin = 6.0 * HOUR * dive
        out.append(position(begin, 152.0 + SLOW * begin, log))
        for minute in range(1, 359):
            drift = error_km / 85.4 * minute / 359.0
            out.append(
                position(
                    begin + minute * MINUTE,
                    152.0 + SLOW * (begin + minute * MINUTE) + drift,
                    log,
                    reckoned=True,
                )
            )
    return out


@pytest.mark.parametrize(
    "logs",
    [
        (track(0, MINUTE, west=152.0), track(1, MINUTE, west=152.0 + FAR, begin=30.0)),
        # fixes at the surface alone, between which the vehicles dive for four hours
        (track(0, 4 * HOUR), track(1, 4 * HOUR, west=152.0 + FAR, begin=2 * HOUR)),
        (track(0, MINUTE), track(1, 6 * HOUR, west=152.0 + FAR, begin=20.0)),
        # a file a dive of each
        [
            track(k, 30 * MINUTE, 4.0, 152.0 + FAR * (k % 2), begin=4 * HOUR * (k // 2) + k)
            for k in range(20)
        ],
        # beside two logs of one vehicle
        (
            track(0, MINUTE),
            track(1, MINUTE, begin=30.0),
            track(2, 3 * HOUR, west=152.0 + FAR, begin=20.0),
        ),
        (track(0, MINUTE), track(1, MINUTE, 3.0, 152.0 + FAR, begin=45 * HOUR + 30.0)),
    ],
    ids=[
        "dense",
        "sparse",
        "dense and sparse",
        "a file a dive",
        "three logs",
        "together at the end",
    ],
)
def test_two_tracks_that_interleave_far_apart_are_of_two_vehicles(logs):
    found = two_vehicles(*logs)
    assert found is not None
    assert found.beyond > 0.5 * found.number
    one, other = found.example
    assert one.source.input != other.source.input
    assert abs(other.longitude - one.longitude) == pytest.approx(FAR, abs=0.1)


@pytest.mark.parametrize(
    "logs",
    [
        (track(0, MINUTE, error=0.0005), track(1, 10.0, error=0.0005)),
        # a ship at 8 m/s that both log in turn, 86 km from the one to the other
        [track(k % 2, 10 * MINUTE, 3.0, speed=8.0 / 85.4e3, begin=6 * HOUR * k) for k in range(8)],
        (track(0, MINUTE), track(0, MINUTE)),
        [track(k, MINUTE, 4.0, begin=4 * HOUR * k) for k in range(12)],
        (track(0, 5.0 * MINUTE), with_reckoning(1, 15.0)),
        # a clock that is set to another zone
        (track(0, MINUTE), track(1, MINUTE, west=152.0 + SLOW * 11.0 * HOUR, begin=30.0)),
        # a ship, and its instrument's clock an hour late
        (
            track(0, MINUTE, speed=20 * SLOW),
            track(1, MINUTE, speed=20 * SLOW, begin=30.0, west=152.0 - 20 * SLOW * HOUR),
        ),
        # a survey back and forth, seen by the one log at its turns alone
        (
            [position(6.0 * HOUR * k, 152.0, 0) for k in range(9)],
            [
                position(
                    600.0 * k,
                    152.0 + 0.5 * (1.0 - abs(1.0 - (600.0 * k % (6 * HOUR)) / (3 * HOUR))),
                    1,
                )
                for k in range(1, 300)
            ],
        ),
        # tracks of two days with a week between them
        (track(0, MINUTE), track(1, MINUTE, west=152.0 + FAR, begin=216 * HOUR)),
    ],
    ids=[
        "dense",
        "ship in turn",
        "twice",
        "a file a dive",
        "dead reckoning",
        "zone",
        "late clock",
        "survey",
        "one after the other",
    ],
)
def test_two_logs_of_one_vehicle_pass(logs):
    assert two_vehicles(*logs) is None


def test_a_receiver_that_is_wrong_for_a_time_is_no_other_vehicle():
    clean, wrong = track(0, MINUTE), track(1, MINUTE, begin=30.0)
    jumped = [
        position(one.time_ns * 1e-9, one.longitude + (FAR if 60 <= k % 600 < 180 else 0.0), 1)
        for k, one in enumerate(wrong)
    ]
    assert two_vehicles(clean, jumped) is None
    # it repeats its first position while the vehicle goes 90 km
    frozen = [position(one.time_ns * 1e-9, 152.0, 1) for one in wrong]
    assert two_vehicles(track(0, MINUTE, speed=2 * SLOW), frozen) is None
    assert (
        two_vehicles(clean, [position(one.time_ns * 1e-9, one.longitude + FAR, 1) for one in wrong])
        is not None
    )
