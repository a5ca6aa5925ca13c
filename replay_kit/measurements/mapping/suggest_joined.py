"""Guessed entries for velocities of which each message carries one component under a name: ``VE`` and ``VN``."""

import json
import re
from collections.abc import Mapping
from typing import Any

from replay_kit.measurements.mapping.leaves import leaves
from replay_kit.measurements.mapping.suggest_profile import (
    NO_REFERENCE,
    geometry_lines,
    line,
    speed_lines,
)

# of a name: what stands before the component, the component, the number of the cell
_EAST = re.compile(
    r"(?P<before>(?:.*_)?(?:cur|vel|adcp|v|c)?)(?P<east>east|e)(?P<cell>_?\d*)|(?P<other>(?:.*_)?)u(?P<number>_?\d*)",
    re.IGNORECASE,
)
# s; components of one measurement are sent one after the other, a few milliseconds apart
_WITHIN = 0.05
#: Key to schema and payload, as of ``suggestions``.
Samples = Mapping[str, tuple[str, Mapping[str, Any]]]


def component_pairs(samples: Samples, carries_names: Mapping[str, bool]) -> list[tuple[str, str]]:
    """Return the keys of the eastward and the northward component of each velocity that comes as two messages.

    Args:
        samples: Messages by key.
        carries_names: By key, whether its message carries a number or an array under a name.
    """
    named = {key.lower(): key for key in samples if carries_names[key] and _values(samples[key][1])}
    pairs = []
    for lower, key in named.items():
        topic, _, name = lower.partition("\n")
        match = _EAST.fullmatch(name)
        if match is None:
            continue
        if match["east"] is not None:
            partner = (
                f"{match['before']}{'north' if match['east'] == 'east' else 'n'}{match['cell']}"
            )
        else:
            partner = f"{match['other']}v{match['number']}"
        other = named.get(f"{topic}\n{partner}")
        if other is not None and len(_values(samples[key][1])) == len(_values(samples[other][1])):
            pairs.append((key, other))
    return pairs


def joined_entry(east: str, north: str, samples: Samples) -> str:
    """Return the TOML of an entry for two components, with a comment on each guess."""
    topic, _, east_name = east.partition("\n")
    north_name = north.partition("\n")[2]
    schema, payload = samples[east]
    values = [*_values(payload), *_values(samples[north][1])]
    profile = len(values) > 2
    found = [
        f"# {json.dumps(topic, ensure_ascii=False)}: one component in each {schema or 'message without a schema'}",
        "[[measurements.map]]",
        f"topic = {json.dumps(topic, ensure_ascii=False)}",
        f'kind = "{"profile" if profile else "velocity"}"',
        line("reference", "unknown", NO_REFERENCE),
        line("east", east_name, "the name of its messages; vx of NED axes is north"),
        line("north", north_name, "the name of its messages"),
        line("join_within", _WITHIN, "s between the stamps of the two"),
        *speed_lines(values),
    ]
    if profile:
        found += [line("frame", "enu", "by its names"), *geometry_lines([], len(values) // 2)]
    else:
        found.append(
            line(
                "distance",
                0.0,
                "NOT KNOWN: of the cell from the vehicle, in m; 0 measures at the vehicle",
            )
        )
    return "\n".join(found) + "\n"


def _values(payload: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the number or the array that a message carries under its name; nothing of other messages."""
    return next((leaf.values for leaf in leaves(payload) if leaf.path in ("value", "data")), ())
