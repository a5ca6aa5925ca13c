"""Absolute profiles of the current that a file holds as a section: one column a dive, at fixed depths."""

from collections.abc import Iterator, Sequence

import numpy as np

from replay_kit.logs.glider.columns import Columns
from replay_kit.logs.glider.currents import DiveMean
from replay_kit.logs.glider.pings import FROM_SURFACE, earth_ping
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import PING

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
