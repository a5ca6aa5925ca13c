"""What the columns hold beside the track: absolute profiles, the water's properties, the echo sounder, the battery, the next waypoint."""

from collections.abc import Iterator, Sequence
from types import MappingProxyType

import numpy as np

from replay_kit.logs.glider.adcp import FROM_SURFACE, earth_ping
from replay_kit.logs.glider.columns import Columns, Table
from replay_kit.logs.glider.currents import DiveMean
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import PING, number, stamp

#: Topics with the schema of their messages and the quantities in them; a message is written where one of the second group is known.
_INSTRUMENTS = MappingProxyType(
    {
        "/ctd": (
            "replay_kit.Ctd",
            ("depth", "pressure"),
            ("temperature", "salinity", "conductivity"),
        ),
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


#: Topic of the profiles.
PROFILES = "/adcp/absolute"


def absolute_profiles(
    columns: Columns, means: Sequence[DiveMean], notes: list[str]
) -> Iterator[Entry]:
    """Yield the absolute profiles of a mission as pings at the middle of their dives, where the file states it.

    They were referenced to the mean currents: ``computed_from`` and, in the mean currents, ``also_in`` keep them from counting twice.
    """
    profile, samples = columns.profile, columns.samples
    if not profile:
        return
    depth = profile["depth"]
    steps = np.diff(depth)
    even = bool(steps.size and np.allclose(steps, steps[0]) and steps[0] > 0.0)
    placed = {mean.middle.time_ns for mean in means if mean.middle is not None}
    notes.append(
        "absolute profiles: taken as east and north relative to the earth, each at the middle of its dive"
    )
    for k in range(len(profile["east"])):
        velocity = np.column_stack([profile["east"][k], profile["north"][k]])
        if not np.isfinite(velocity).all(axis=1).any():
            continue
        middle_ns = int(samples["dac_time"][k]) if "dac_time" in samples else 0
        time_ns = middle_ns if middle_ns in placed else int(samples["time"][k])
        payload = earth_ping(
            time_ns,
            k,
            int(samples["dive"][k]),
            velocity,
            (float(steps[0]) if even else 1.0, float(depth[0])),
        )
        payload |= FROM_SURFACE | {
            "computed_from": ["/dac"],
            **({} if even else {"cell_distances": depth.tolist()}),
        }
        yield time_ns, PROFILES, PING, payload
