"""Times stated in messages, and times that no mission has."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from replay_kit.core.words.quantities import CLOCKS, EARLIEST_NS
from replay_kit.core.words.text import time_text

# What the times of one message may differ by: a year [ns].
_APART_NS = 366 * 86_400 * 10**9
_MAX_NS = 2**63 - 1


def header_stamp(payload: Mapping[str, Any]) -> int | None:
    """Return the time stated in a payload [ns, UTC]; None without one.

    Read from ``header.stamp``, ``stamp`` and ``timestamp``, as a mapping of seconds and nanoseconds under the names in use. Zero means
    unset, as in ROS; values beyond int64 are ignored.
    """
    header = payload.get("header")
    stamps = [header.get("stamp")] if isinstance(header, Mapping) else []
    for stamp in (*stamps, payload.get("stamp"), payload.get("timestamp")):
        if isinstance(stamp, Mapping):
            seconds = _first_integer(stamp, ("sec", "secs", "seconds"))
            nanoseconds = _first_integer(stamp, ("nsec", "nanosec", "nsecs", "nanos"))
            if seconds is not None and nanoseconds is not None:
                time_ns = seconds * 1_000_000_000 + nanoseconds
                if 0 < time_ns <= _MAX_NS:
                    return time_ns
    return None


def _first_integer(stamp: Mapping[str, Any], names: tuple[str, ...]) -> int | None:
    return next((stamp[name] for name in names if isinstance(stamp.get(name), int)), None)


def doubtful_times(
    span: tuple[int, int], samples: Iterable[tuple[int, Mapping[str, Any]]], now_ns: int | None
) -> str:
    """Return the anomaly of the times of a log and a plausible explanation; empty for plausible times.

    Args:
        span: First and last time [ns, UTC].
        samples: Times and payloads of some messages.
        now_ns: Latest possible time, with a tolerance of a day [ns, UTC]; None for a result independent of today.
    """
    first_ns, last_ns = span
    latest = _MAX_NS if now_ns is None else now_ns + 86_400 * 10**9
    stated = [(time_ns, stamp) for time_ns, of in samples if (stamp := header_stamp(of))]
    apart = float(np.median([stamp - time_ns for time_ns, stamp in stated])) if stated else 0.0
    begin = f"the log begins {time_text(first_ns)}"
    if first_ns < EARLIEST_NS:
        odd = f"{begin}, before 1990"
    elif last_ns > latest:
        odd = f"the log ends {time_text(last_ns)}, in the future"
    elif abs(apart) > _APART_NS:
        odd = f"{begin}, {abs(apart) / 86_400e9:.0f} days {'before' if apart > 0 else 'after'} the stamps in its messages"
    else:
        return ""
    stamp = stated[0][1] if stated else 0
    if abs(apart) > _APART_NS and EARLIEST_NS <= stamp <= latest:
        return f"{odd}; by the stamps in the messages it is {time_text(stamp)}: --clock header reads these"
    for unit, factor in CLOCKS.items():
        if EARLIEST_NS <= first_ns * factor <= min(latest, EARLIEST_NS * 4):
            return f"{odd}; as if {unit} were taken for nanoseconds: that would be {time_text(first_ns * factor)}; correct the recorder"
    return f"{odd}; check the clock of the recorder"
