"""Blocks of positions, pings and mean currents as a test states them, and what the checks say of them."""

import math
from typing import Any

import numpy as np

from replay_kit.core.geodesy import metres_per_degree
from replay_kit.core.observation.table import MEAN, PING, POSITION, Block
from replay_kit.measurements.checks.check import Checked, check

STEP = 600.0
EAST, NORTH = metres_per_degree(0.0)
Event = tuple[int, dict[str, Any]]


def fix(seconds, longitude=152.0, latitude=-40.0, depth=math.nan, reckoned=False, log=0):
    """A position."""
    place = {"longitude": longitude, "latitude": latitude, "depth": depth}
    return POSITION, place | {"time": seconds, "dead_reckoned": reckoned, "input": log}


def ping(seconds, velocity, depth=None, error=0.05, place=(152.0, -40.0), **changes):
    """A profile; its raw values are its velocities unless they are given."""
    velocity = np.asarray(velocity, np.float64)
    depth = (
        np.linspace(10.0, 50.0, len(velocity)) if depth is None else np.asarray(depth, np.float64)
    )
    known = np.isfinite(velocity).all(axis=1)
    columns = {
        "time": seconds,
        "longitude": place[0],
        "latitude": place[1],
        "depth": depth,
        "velocity": velocity,
        "error_std": np.full(len(velocity), error),
        "flags": np.where(known, 1, 9),
        "reasons": np.where(known, 0, 1),
        "raw": velocity,
        "distance": np.abs(depth),
        "platform": (math.nan, math.nan),
        "bins": len(velocity),
        "dive": 1,
    }
    zeros = ("common_std", "correlation_depth", "up", "along_beams", "input", "transducer_depth")
    unknown = ("pressure_depth", "heading", "error_velocity")
    return PING, columns | dict.fromkeys(zeros, 0.0) | dict.fromkeys(unknown, math.nan) | changes


def mean(seconds, velocity, start=None, deepest=400.0, dive=1, points=13, **changes):
    """A mean current of a dive down and up again, that ends at a time."""
    share = np.linspace(0.0, 1.0, points)
    start = seconds - 3600.0 if start is None else start
    return MEAN, {
        "time": seconds,
        "velocity": velocity,
        "path_time": start + (seconds - start) * share,
        "path_depth": deepest * (1.0 - np.abs(2.0 * share - 1.0)),
        "weight": np.full(points, 1.0 / points),
        "points": points,
        "dive": dive,
        "reckoned": (math.nan, math.nan),
        "beside_profiles": False,
    } | changes


_WHOLE = ["time", "path_time", "input", "topic", "dive", "points", "bins", "components"]
_TRUTHS = ["dead_reckoned", "up", "along_beams", "beside_profiles"]
_KINDS = dict.fromkeys(_WHOLE, np.int64) | dict.fromkeys(_TRUTHS, np.bool_)
_KINDS |= {"reasons": np.int32, "flags": np.int8}
_FILLS = {"flags": 9.0, "reasons": 0.0, "weight": 0.0, "path_time": 0.0}


def _columns(rows):
    """Return rows as columns, padded as a block's."""
    found = {}
    for name in rows[0]:
        values = [np.asarray(row[name], np.float64) for row in rows]
        shape = np.max([each.shape for each in values], axis=0).astype(int)
        padded = np.full((len(rows), *shape), _FILLS.get(name, math.nan))
        for k, each in enumerate(values):
            padded[(k, *map(slice, each.shape))] = each
        padded = np.round(padded * 1e9) if name in ("time", "path_time") else padded
        found[name] = padded.astype(_KINDS.get(name, np.float64))
    return found


_NONE = _columns([fix(0.0)[1] | {"topic": 0}])


def block_of(events: list[Event], topic: str = "/adcp") -> Block:
    """Return a block of events in order."""
    rows = {kind: [] for kind in (POSITION, PING, MEAN)}
    order = []
    for k, (kind, columns) in enumerate(events):
        order.append((k, kind, len(rows[kind])))
        more = {"components": columns["raw"].shape[1]} if kind == PING else {}
        rows[kind].append({"topic": 0, **columns, **more})
    position, pings, means = (_columns(of) if of else {} for of in rows.values())
    position = position or {name: column[:0] for name, column in _NONE.items()}
    order = np.array(order, np.int64).reshape(-1, 3)
    return Block(order, position, pings, means, (), (topic,), order[:0], ())


def judged(events, size=4096, ensemble=None, through_water=False):
    """Return what the checks remember, what they found with the number of its event, and the flags and reasons of each ping."""
    events, state = list(events), Checked()
    found, flags = [], []
    for first in range(0, len(events), size):
        block = block_of(events[first : first + size])
        state, block, new = check(state, block, ensemble, through_water)
        found += [(first + event, finding) for event, finding, _ in new]
        if block.ping:
            flags += zip(block.ping["flags"], block.ping["reasons"], strict=True)
    return state, found, flags


def names(events, **how):
    """Return the names of what is found."""
    return [finding.name for _, finding in judged(events, **how)[1]]
