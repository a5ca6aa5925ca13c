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


def instrument_entries(samples: Table) -> Iterator[Entry]:
    """Yield the messages of the instruments that a glider has: SI units, degrees, degrees Celsius, V and A h; null where unknown.

    A waypoint is written when it changes.

    Args:
        samples: Along the track.
    """
    for topic, (schema, beside, own) in _INSTRUMENTS.items():
        held = [name for name in own if name in samples]
        if not held:
            continue
        values = np.column_stack([samples[name] for name in held])
        known = np.flatnonzero(np.isfinite(values).any(axis=1))
        if topic == "/vehicle/waypoint" and known.size:
            known = known[np.r_[True, (np.diff(values[known], axis=0) != 0.0).any(axis=1)]]
        names = [*(name for name in beside if name in samples), *held]
        columns = [samples[name][known].tolist() for name in names]
        for time_ns, *row in zip(samples["time"][known].tolist(), *columns, strict=True):
            payload = dict(zip(names, map(number, row), strict=True))
            yield time_ns, topic, schema, {"stamp": stamp(time_ns), **payload}
