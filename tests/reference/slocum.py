"""A Slocum's cycles read one sensor after the other, as the format is described: the slow twin of ``logs/slocum/cycles.py``."""

import struct

from tests.logs.slocum.slocum_samples import FORMS, Sensors


def cycles(data: bytes, at: int, sensors: Sensors) -> list[dict[str, tuple[int, float]]]:
    """Return for each cycle the state and value of each sensor that it writes, from the 16 known bytes on."""
    order = ">" if struct.unpack_from(">h", data, at + 2)[0] == 0x1234 else "<"
    at += 16
    last: dict[str, float] = {}
    found = []
    while data[at : at + 1] == b"d":
        states = data[at + 1 : at + 1 + (len(sensors) + 3) // 4]
        at += 1 + len(states)
        cycle = {}
        for k, (name, size, _) in enumerate(sensors):
            state = states[k // 4] >> (6 - 2 * (k % 4)) & 3
            if state == 2:
                last[name] = struct.unpack_from(order + FORMS[size], data, at)[0]
                at += size
            if state:
                cycle[name] = (state, last.get(name, float("nan")))
        found.append(cycle)
    return found
