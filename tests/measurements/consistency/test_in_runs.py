"""Positions and pings of a log at 1 Hz checked together and one by one: sound ones, and ones with a fault from some second on."""

import math
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.raw import raw_values
from replay_kit.measurements.consistency.summary import EnsembleSpeeds
from tests.measurements.samples import checked, profile, vehicle

ENSEMBLE = EnsembleSpeeds(np.array([0.0, 100.0]), np.array([0.04, 0.02]))
BEGIN, CELLS = 120, 8


def logged(second, rng, fix=(), ping=()):
    """Return the position and the ping of a second, of a vehicle that dives: a shear, noise of its stated error, its depth and heading."""
    depth = 30.0 * (1.0 - math.cos(second / 60.0))
    fix = {"longitude": 150.0 + 2e-5 * second, "depth": depth, **dict(fix)}
    ping = {"scale": 1.0, "beams": None, "sign": 1.0, "std": 0.02, "pressure": depth} | dict(ping)
    shear = ping["scale"] * (0.1 + 0.01 * np.arange(CELLS))[:, None]
    velocity = shear + rng.normal(0.0, 0.02, (CELLS, 3))
    if ping["beams"] is not None:
        velocity = shear + rng.normal(0.0, ping["beams"], (CELLS, 4))
    (raw,) = raw_values(ping.get("cells", velocity)[None], ping["beams"] is not None)
    one = profile(
        velocity[:, :2],
        ping["sign"] * (depth + 4.0 * np.arange(1.0, CELLS + 1.0)),
        ping["std"],
        int(1e9 * ping.get("second", second)),
        (150.0 + 2e-5 * second, -40.0),
        platform_velocity=(1.7, float(rng.normal(0.0, 0.05))) if second % 100 < 90 else None,
        raw=replace(raw, depth=ping["pressure"], heading=float(second % 360)),
    )
    return vehicle(second, **fix), one


# what is found, and by second what is other than in a sound log
KINDS = {
    "sound": (None, lambda k: {}),
    "frozen": (findings.FROZEN, lambda k: {"fix": {"longitude": 150.0}}),
    "displaced": (
        findings.DISPLACED,
        lambda k: {"fix": {"longitude": 150.2}} if k % 50 < 2 else {},
    ),
    "moved": (findings.DISPLACED, lambda k: {"fix": {"longitude": 150.5 + 2e-5 * k}}),
    "elsewhere": (findings.PLACES, lambda k: {"fix": {"longitude": 170.0}} if k % 20 < 3 else {}),
    "dead": (findings.DEAD, lambda k: {"ping": {"cells": np.ones((8, 2))}} if k % 9 < 4 else {}),
    "noisy": (findings.ERRORS, lambda k: {"ping": {"std": 1e-4}}),
    "fast": (findings.UNIT, lambda k: {"ping": {"scale": 60.0}} if k % 3 else {}),
    "above": (findings.DEPTH, lambda k: {"ping": {"sign": -1.0}}),
    "stuck": (
        findings.DEPTHS,
        lambda k: {"fix": {"dead_reckoned": True}, "ping": {"pressure": 3.0}},
    ),
    "beams": (findings.BEAM, lambda k: {"ping": {"beams": [0.02, 0.02, 0.02, 0.4]}}),
    "late": (None, lambda k: {"ping": {"second": k - 5.0}} if k % 60 == 59 else {}),
    "logs": (None, lambda k: {"fix": {"log": k // 40 % 2, "dead_reckoned": k % 7 == 0}}),
    "twice": (findings.DUPLICATES, lambda k: {}),
    "topics": (None, lambda k: {}),
}


@pytest.mark.parametrize("kind", KINDS)
def test_events_in_runs_are_checked_as_one_by_one(kind):
    rng, events = np.random.default_rng(0), []
    named, faults = KINDS[kind]
    for k in range(1050 if kind == "stuck" else 760):
        sound = {"ping": {"beams": 0.02}} if kind == "beams" else {}
        pair = logged(k, rng, **(faults(k) if k >= BEGIN else sound))
        events += pair * (2 if kind == "twice" and k % 2 else 1)
        if kind == "topics":
            other = logged(k, rng)[1]
            events.append(replace(other, source=replace(other.source, topic="/other")))
    state, _, quiet = checked(events, ENSEMBLE)
    assert (named in {each.name for each in state.findings}) == (named is not None)
    assert named or not state.findings
    # of a sound log most are quiet
    assert kind != "sound" or quiet > 0.7 * len(events)
