"""Results of earlier versions: innovations and weights as single messages.

With ``measurements.flight_bias``, results before contract version 5 hold corrected mean currents as measured ones.
"""

import tomllib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.results.reader import ResultReader
from replay_kit.results.schemas import MESSAGES
from replay_kit.results.topics import CONFIG_NAME

# The first contract version whose measured mean currents are the log's.
_MEASURED_SINCE = 5


def innovations(reader: ResultReader, topic: str, newest: bool) -> Iterator[dict[str, Any]] | None:
    """Return the fields of ``replay_kit.Innovations`` of each message of a topic, see ``ResultReader.messages``.

    None if the messages are of this version.
    """
    if not _is(reader, topic, "replay_kit.Innovation"):
        return None
    settings = tomllib.loads(reader.text(CONFIG_NAME))
    corrected = int(reader.metadata["contract"]["version"]) < _MEASURED_SINCE and bool(
        settings.get("measurements", {}).get("flight_bias", False)
    )
    return (_fields(message, corrected) for _, message in reader.decoded(topic, newest))


def weights(reader: ResultReader, topic: str) -> Iterator[tuple[int, Array]] | None:
    """Return times [ns, UTC] and weights, by level, of a topic's messages; None if they hold none."""
    if not _is(reader, topic, "replay_kit.FlowEstimate"):
        return None
    return ((time_ns, np.array(message.weights)) for time_ns, message in reader.decoded(topic))


def _is(reader: ResultReader, topic: str, schema: str) -> bool:
    held = reader.schema(topic)
    return held is not None and held.name == schema


def _fields(message: Any, corrected: bool) -> dict[str, Any]:
    """Return a block of one innovation; with ``corrected``, the measured mean current of a dive is a corrected one."""
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
                is_corrected = corrected and mean.kind == "dac"
                of = "corrected" if is_corrected else name
                for end in ("east", "north"):
                    held[f"mean_current_{of}_{end}"] = [getattr(mean, f"{name}_{end}")]
    return held
