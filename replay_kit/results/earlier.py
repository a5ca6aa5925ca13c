"""Innovations of results of 0.3, single messages of contract version 5."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from replay_kit.results.reader import ResultReader
from replay_kit.results.schemas import MESSAGES


def innovations(reader: ResultReader, topic: str, newest: bool) -> Iterator[dict[str, Any]] | None:
    """Return the fields of ``replay_kit.Innovations`` of each message of a topic, see ``ResultReader.messages``.

    None if the messages are of this version.
    """
    held = reader.schema(topic)
    if held is None or held.name != "replay_kit.Innovation":
        return None
    return (_fields(message) for _, message in reader.decoded(topic, newest))


def _fields(message: Any) -> dict[str, Any]:
    """Return a block of one innovation."""
    mean, held = message.mean_current, dict[str, Any]()
    for field in MESSAGES["Innovations"]:
        value = getattr(message, field.name, 0 if field.name == "profiles" else ())
        if isinstance(value, str | int | float):
            held[field.name] = [value]
        elif isinstance(value, Sequence) and len(value) == len(message.depth):
            held[field.name] = value
    held["timestamp"] = [message.timestamp.ToNanoseconds()]
    held["source_time"] = [message.source_time.ToNanoseconds()]
    held["bins"], held["mean_current_kind"] = [len(message.depth)], [mean.kind]
    if message.HasField("mean_current"):
        for name in ("measured", "corrected", "estimated"):
            error = getattr(mean, f"{name}_standard_error", 0.0)
            held[f"mean_current_{name}_standard_error"] = [error or np.nan]
            if name == "measured" or (name == "corrected" and error > 0.0):
                for end in ("east", "north"):
                    held[f"mean_current_{name}_{end}"] = [getattr(mean, f"{name}_{end}")]
    return held
