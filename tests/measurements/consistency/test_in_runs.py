"""Positions and pings checked together against the same one by one: states, events and findings at the very ping."""

import math
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from replay_kit.core.observation import Observation
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.monitor import ConsistencyState, check, check_quiet
from replay_kit.measurements.consistency.raw import raw_values
from replay_kit.measurements.consistency.summary import EnsembleSpeeds, summaries
from tests.measurements.samples import profile, vehicle

ENSEMBLE = EnsembleSpeeds(np.array([0.0, 100.0]), np.array([0.04, 0.02]))
BEGIN, CELLS = 120, 8


def _ping(rng, k, **changes):
    """The ping of second k: a shear, noise of its stated error, a depth and a heading by the vehicle's."""
    scale, beams = changes.get("scale", 1.0), changes.get("beams")
    shear = scale * (0.1 + 0.01 * np.arange(CELLS))[:, None]
    velocity = shear + rng.normal(0.0, 0.02, (CELLS, 3))
    if beams is not None:
        velocity = np.column_stack([velocity, velocity[:, 0]]) + rng.normal(0.0, beams, (CELLS, 4))
    if "cells" in changes:
        velocity = np.full_like(velocity, changes["cells"])
    (raw,) = raw_values(velocity[None], beams is not None)
    depth = _depth(k)
    raw = replace(raw, depth=changes.get("pressure", depth), heading=float(k % 360))
    return replace(
        profile(
            velocity[:, :2],
            changes.get("sign", 1.0) * (depth + 4.0 * np.arange(1.0, CELLS + 1.0)),
            changes.get("std", 0.02),
            changes.get("time_ns", k * 10**9),
            (150.0 + 2e-5 * k, -40.0),
        ),
        raw=raw,
        platform_velocity=(1.7, float(rng.normal(0.0, 0.05))) if k % 100 < 90 else None,
    )


def _depth(k):
    return 30.0 * (1.0 - math.cos(k / 60.0))


def _fix(k, east=0.0, **changes):
    depth = changes.pop("depth", _depth(k))
    return vehicle(float(k), 150.0 + 2e-5 * k + east, -40.0, depth, **changes)


def _log(kind, rng):
    """Yield the events of a log with a fault of a kind from ``BEGIN`` on."""
    for k in range(1000 if kind == "pressure" else 760):
        late = k >= BEGIN
        fix, ping = _fix(k, dead_reckoned=kind == "pressure"), {}
        if late and kind == "frozen":
            fix = replace(_fix(BEGIN), time_ns=fix.time_ns, depth=fix.depth)
        elif late and kind == "displaced":
            fix = _fix(k, 0.2 if k % 50 < 2 else 0.0)
        elif late and kind == "elsewhere":
            fix = _fix(k, 20.0 if k % 20 < 3 else 0.0)
        elif late and kind == "moved":
            fix = _fix(k, 0.5)
        elif kind == "logs":
            fix = _fix(k, log=k // 40 % 2, dead_reckoned=k % 7 == 0)
        elif kind == "sparse":
            fix = _fix(30 * k)
        elif late:
            ping = {
                "dead": {"cells": 0.1} if k % 9 < 4 else {},
                "noisy": {"std": 1e-4},
                "fast": {"scale": 60.0} if k % 3 else {},
                "above": {"sign": -1.0},
                "pressure": {"pressure": 3.0},
                "beams": {"beams": [0.02, 0.02, 0.02, 0.4]},
            }.get(kind, {})
        if kind == "beams" and not late:
            ping = {"beams": 0.02}
        if kind == "backwards" and k % 60 == 59:
            ping = {"time_ns": (k - 5) * 10**9}
        one = _ping(rng, 30 * k if kind == "sparse" else k, **ping)
        yield fix
        yield one
        if kind == "twice" and late and k % 2:
            yield from (fix, one)
        if kind == "topics" and k % 3:
            yield replace(_ping(rng, k), source=replace(one.source, topic="/other"))


def _same(one, other):
    """Whether two states are equal to the last bit."""
    if one is other:
        return True
    if is_dataclass(one):
        return type(one) is type(other) and all(
            _same(getattr(one, each.name), getattr(other, each.name)) for each in fields(one)
        )
    if isinstance(one, dict):
        return list(one) == list(other) and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, np.ndarray | float):
        return np.array_equal(one, other, equal_nan=True)
    return bool(one == other)


FOUND = {
    "sound": set(),
    "frozen": {findings.FROZEN},
    "displaced": {findings.DISPLACED},
    "elsewhere": {findings.PLACES, findings.DISPLACED},
    "moved": {findings.DISPLACED},
    "dead": {findings.DEAD},
    "noisy": {findings.ERRORS},
    "fast": {findings.UNIT},
    "above": {findings.DEPTH},
    "pressure": {findings.DEPTHS},
    "beams": {findings.BEAM},
    "twice": {findings.DUPLICATES},
    "topics": set(),
    "logs": set(),
    "sparse": set(),
    "backwards": set(),
}


@pytest.mark.parametrize("kind", FOUND)
def test_events_in_runs_are_checked_as_one_by_one(kind):
    rng = np.random.default_rng(len(kind))
    events = list(_log(kind, rng))
    of_pings = [event for event in events if isinstance(event, Observation)]
    known = dict(zip(map(id, of_pings), summaries(of_pings, ENSEMBLE), strict=True))
    one = together = ConsistencyState()
    begin, quiet = 0, []
    while begin < len(events):
        run = events[begin : begin + int(rng.integers(1, 40))]
        begin += len(run)
        checked = []
        for event in run:
            one, after = check(one, event, ENSEMBLE, summary=known.get(id(event)))
            checked.append(after)
        found = check_quiet(together, [(event, known.get(id(event))) for event in run])
        quiet.append(found is not None)
        if found is None:
            for event in run:
                together, _ = check(together, event, ENSEMBLE, summary=known.get(id(event)))
        else:
            together = found
            assert all(map(lambda a, b: a is b, checked, run))
        assert _same(one, together)
    assert {each.name for each in one.findings} == FOUND[kind]
    # of a sound log most are quiet
    assert kind != "sound" or np.mean(quiet) > 0.7
