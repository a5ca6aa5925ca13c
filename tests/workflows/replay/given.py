"""Events that a test states, as the run of a replay is given them, and logs moved elsewhere."""

import numpy as np

from replay_kit.core.observation import Observation, Profiles, Source, VehicleState
from replay_kit.core.observation.table import LINEAR, PING, POSITION, Block
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log


def position(seconds, longitude=152.0, latitude=-40.0, depth=0.0, reckoned=False):
    """A position of the vehicle at a time [s]."""
    time_ns = int(seconds * 1e9)
    source = Source(0, "/fix", int(seconds), time_ns)
    return VehicleState(time_ns, longitude, latitude, depth, reckoned, source)


def block_of(values, topics=None):
    """A block of positions, profiles of as many bins each, and other measurements, in order."""
    kinds = [
        POSITION
        if isinstance(one, VehicleState)
        else PING
        if isinstance(one, Observation)
        else LINEAR
        for one in values
    ]
    each = {
        kind: [one for one, own in zip(values, kinds, strict=True) if own == kind]
        for kind in (POSITION, PING, LINEAR)
    }
    rows = [kinds[:k].count(kind) for k, kind in enumerate(kinds)]
    topics = topics or sorted({one.source.topic for one in values})
    position = {
        "time": np.array([one.time_ns for one in each[POSITION]]),
        "input": np.array([one.source.input for one in each[POSITION]]),
        "topic": np.array([topics.index(one.source.topic) for one in each[POSITION]], np.int64),
        "ordinal": np.array([one.source.position for one in each[POSITION]]),
    } | {
        name: np.array([getattr(one, name) for one in each[POSITION]])
        for name in ("longitude", "latitude", "depth", "dead_reckoned")
    }
    ping = {}
    if each[PING]:
        made = Profiles.of(each[PING])
        names = np.array([topics.index(name) for name in made.topics])
        bins = np.full(len(made), made["depth"].shape[1])
        ping = {**made.columns, "topic": names[made["topic"]], "bins": bins}
    events = np.column_stack([np.arange(len(values)), kinds, rows])
    return Block(events, position, ping, {}, each[LINEAR], topics, np.empty((0, 3), np.int64), ())


def moved(path, out, seconds=0.0, degrees=0.0, without=()):
    """A log with other times or longitudes, or without some topics."""

    def changed(value):
        if isinstance(value, dict):
            found = {key: changed(each) for key, each in value.items()}
            if "sec" in found:
                found["sec"] += int(seconds)
            if "longitude" in found:
                found["longitude"] += degrees
            return found
        return value

    kept = [one for one in open_log(path).messages() if one.topic not in without]
    write_mcap_log(
        out,
        (
            one._replace(
                time_ns=one.time_ns + int(seconds * 1e9), payload=changed(dict(one.payload))
            )
            for one in kept
        ),
    )
    return out
