"""What a glider's other instruments say: the water's properties, the echo sounder, the battery, the next waypoint."""

from collections.abc import Iterator
from types import MappingProxyType

import numpy as np

from replay_kit.logs.glider.columns import Table
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import number, stamp

#: Topics with the schema of their messages and the quantities in them; a message is written where one of the second group is known.
_INSTRUMENTS = MappingProxyType(
    {
        "/ctd": ("replay_kit.Ctd", ("depth",), ("temperature", "conductivity")),
        "/vehicle/altimeter": ("replay_kit.Altimeter", ("depth",), ("altitude", "water_depth")),
        "/vehicle/battery": ("replay_kit.Battery", (), ("voltage", "charge_used")),
        "/vehicle/waypoint": (
            "replay_kit.Waypoint",
            (),
            ("waypoint_longitude", "waypoint_latitude"),
        ),
    }
)
_MINUTE_NS = 60 * 10**9


def instrument_entries(samples: Table) -> list[Iterator[Entry]]:
    """Return the messages of each instrument that a glider has, in order of time: SI units, degrees, degrees Celsius, V, A h; null unknown.

    Args:
        samples: Along the track.
    """
    return [
        _entries(topic, samples)
        for topic, (_, _, own) in _INSTRUMENTS.items()
        if any(name in samples for name in own)
    ]


def _entries(topic: str, samples: Table) -> Iterator[Entry]:
    """Yield an instrument's messages: each of the CTD, a waypoint when it changes, others once a minute."""
    schema, beside, own = _INSTRUMENTS[topic]
    held = [name for name in own if name in samples]
    values = np.column_stack([samples[name] for name in held])
    known = np.flatnonzero(np.isfinite(values).any(axis=1))
    if topic == "/vehicle/waypoint":
        known = known[
            np.r_[True, (np.diff(values[known], axis=0) != 0.0).any(axis=1)][: known.size]
        ]
    elif topic != "/ctd":
        minute = samples["time"][known] // _MINUTE_NS
        known = known[np.r_[True, np.diff(minute) > 0][: known.size]]
    names = [*(name for name in beside if name in samples), *held]
    for k in known.tolist():
        time_ns = int(samples["time"][k])
        payload = {name: number(float(samples[name][k])) for name in names}
        yield time_ns, topic, schema, {"stamp": stamp(time_ns), **payload}
