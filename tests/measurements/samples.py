"""Messages of a small survey, and the loop over them."""

import math
from dataclasses import dataclass
from itertools import islice

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.measurements.observed import measure_messages, new_stream, rows

CONFIG = MeasurementConfig()
SECOND = 10**9


@dataclass(frozen=True)
class Used:
    """A message that was used."""

    topic: str


@dataclass(frozen=True)
class Skipped:
    """A message that was not used, and why."""

    topic: str
    reason: str


def interpret_block(stream, messages, config, last=False):
    """Return the stream after messages, and the events of each of them, what became of messages first; those of the end with the last."""
    after, block = measure_messages(stream, messages, config, last)
    found = [[] for _ in messages] or [[]]
    for order, topic, reason in block.outcomes.tolist():
        name = block.topics[topic]
        event = Used(name) if reason < 0 else Skipped(name, block.reasons[reason])
        found[min(order - stream.order, len(found) - 1)].append(event)
    for order, event in zip(block.events[:, 0].tolist(), rows(block), strict=True):
        found[min(order - stream.order, len(found) - 1)].append(event)
    return after, found


def interpret(stream, message, config):
    """Return the stream after a message, and the events that it completes."""
    stream, (events,) = interpret_block(stream, [message], config)
    return stream, events


def finish(stream, config):
    """Return the events of what still waits when the log ends."""
    return interpret_block(stream, [], config, last=True)[1][0]


def events_of(messages, config, system=None, component=None):
    """Yield the events that each message of a stream completes, and last those of what still waits at its end."""
    stream, rest = new_stream(system, component), iter(messages)
    while block := list(islice(rest, 128)):
        stream, found = interpret_block(stream, block, config)
        yield from found
    yield finish(stream, config)


# what no field of a message should hold
ODD = [
    None,
    True,
    -1,
    0,
    3.5,
    10**400,
    1e308,
    math.nan,
    "",
    "words",
    b"\xff",
    [],
    [None],
    ["a"],
    [[]],
    {},
    {"a": 1},
    [{}],
    [[1, 2], 3],
]


def ping(time_s=0.0, **changes):
    payload = {
        "coordinate_system": "earth",
        "reference": "earth",
        "orientation": "down",
        "n_cells": 3,
        "cell_size": 32.0,
        "bin0_distance": 16.0,
        "transducer_depth": 0.0,
        "velocity": [[0.1, 0.2, None], [0.3, None, 0.0], [0.5, 0.6, 0.0]],
        "velocity_std": 0.09,
        "pressure": 0.0,
    } | changes
    return logged("replay_kit.AdcpPing", payload, time_s, "/adcp")


def fix(time_s, longitude=152.0, latitude=-40.0, depth=None, **changes):
    metadata = [] if depth is None else [{"key": "depth", "value": str(depth)}]
    payload = {"longitude": longitude, "latitude": latitude, "altitude": 30.0}
    payload |= {"metadata": metadata, **changes}
    return logged("foxglove.LocationFix", payload, time_s, "/vehicle/fix")


def run(messages, config=CONFIG, component=None):
    found = events_of(messages, config, component=component)
    return [event for events in found for event in events]


def in_order(*messages):
    return sorted(messages, key=lambda message: message.time_ns)


def only(kind, events):
    return [event for event in events if isinstance(event, kind)]


def the(kind, messages, config=CONFIG):
    """Return the one event of a kind that messages give."""
    (event,) = only(kind, run(messages, config))
    return event


def reasons(events):
    """Return why messages were skipped."""
    return [event.reason for event in only(Skipped, events)]


def counted(events, topic):
    """Return how many messages of a topic were used or skipped."""
    return sum(event.topic == topic for event in only(Used | Skipped, events))


def logged(schema, payload, time_s=0, topic="/x"):
    return Message(int(time_s * SECOND), topic, schema, payload, 0, int(time_s))


def dac(time_s, start_s=0, end_s=None, **changes):
    ends = {"start_fix": start_s, "end_fix": time_s if end_s is None else end_s}
    payload = {"dive": 3, "dac_eastward": 0.1, "dac_northward": -0.2, "error": 0.03}
    for name, at in ends.items():
        payload[name] = {"time": {"sec": at, "nsec": 0}, "lon": 152.0, "lat": -40.0}
    return logged("replay_kit.DepthAveragedCurrent", payload | changes, time_s, "/dac")


def mapping(*entries):
    """Return a configuration that maps topics."""
    return MeasurementConfig.model_validate({"map": entries})


def mavlink_frames(time_s=5.0, array_id=7, n_components=3.0, skip=(), reference=0.0):
    nan = math.nan
    place = [3.0, 32.0, 16.0, 3.0, reference, 0.0, 1.0]
    parts = {
        "ADCP_CFG": [*place, *[0.0] * 4, 1500.0, nan, 0.0, 1.0, n_components, 0.0],
        "ADCP_E": [0.1, 0.3, 0.5],
        "ADCP_N": [0.2, nan, 0.6],
        "ADCP_U": [nan, 0.0, 0.0],
        "ADCP_STD": [0.09, 0.09, 0.09],
    }
    kind = "DEBUG_FLOAT_ARRAY"
    for k, (name, data) in enumerate(parts.items()):
        if name not in skip:
            payload = {"name": name, "array_id": array_id, "time_usec": int(time_s * 1e6)}
            payload["data"] = [*data, *[0.0] * (58 - len(data))]
            frame = logged(kind, payload, time_s, f"mavlink/1/1/{kind}")
            yield frame._replace(position=10 + k)


def position_int(time_s, depth=0.0, lon=1_520_000_000, lat=-400_000_000):
    payload = {"lon": lon, "lat": lat, "relative_alt": -int(depth * 1000)}
    kind = "GLOBAL_POSITION_INT"
    return logged(kind, payload, time_s, f"mavlink/1/1/{kind}")
