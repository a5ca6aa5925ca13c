"""Results of earlier versions: their innovations, a message each, and weights, after each of them.

With ``measurements.flight_bias`` results before contract version 5 hold, as measured mean currents of dives, the corrected ones.
"""

import tomllib
from collections.abc import Iterator
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Innovation, Source
from replay_kit.results.reader import ResultReader
from replay_kit.results.topics import CONFIG_NAME

# The first contract version whose measured mean currents are the log's.
_MEASURED_SINCE = 5
_PAIRS = ("innovation", "innovation_std", "residual", "prior_innovation")
_NUMBERS = [
    "nis",
    "dof",
    "accepted",
    "error_inflation",
    "dive",
    "decision",
    "gate_statistic",
    "signal_dof",
]


def innovations(reader: ResultReader, topic: str, newest: bool) -> Iterator[Innovation] | None:
    """Return the innovations of a topic's messages, see ``ResultReader.messages``; None where they are of this version."""
    if not _is(reader, topic, "replay_kit.Innovation"):
        return None
    settings = tomllib.loads(reader.text(CONFIG_NAME))
    corrected = int(reader.metadata["contract"]["version"]) < _MEASURED_SINCE and bool(
        settings.get("measurements", {}).get("flight_bias", False)
    )
    return (_innovation(message, corrected) for _, message in reader.decoded(topic, newest))


def weights(reader: ResultReader, topic: str) -> Iterator[tuple[int, Array]] | None:
    """Return times [ns, UTC] and weights, level after level, of a topic's messages; None where they hold none."""
    if not _is(reader, topic, "replay_kit.FlowEstimate"):
        return None
    return ((time_ns, np.array(message.weights)) for time_ns, message in reader.decoded(topic))


def _is(reader: ResultReader, topic: str, schema: str) -> bool:
    held = reader.schema(topic)
    return held is not None and held.name == schema


def _innovation(message: Any, corrected: bool) -> Innovation:
    """Return an innovation; a dive's mean current that is called measured is corrected where that is so."""

    def pairs(name: str) -> Any:
        """Return both components; NaN where the message has not as many as bins."""
        each = [getattr(message, f"{name}_{end}") for end in ("east", "north")]
        known = len(each[0]) == len(message.depth)
        return np.transpose(each) if known else np.full((len(message.depth), 2), np.nan)

    mean, about = message.mean_current, dict[str, Any]()
    if message.HasField("mean_current"):
        about["mean_kind"] = mean.kind
        for name, of in (("measured", "mean"), ("corrected", "corrected")):
            error = getattr(mean, f"{name}_standard_error", 0.0) or np.nan
            if name == "measured" or error > 0.0:
                pair = [getattr(mean, f"{name}_{end}") for end in ("east", "north")]
                about[f"{of}_current"], about[f"{of}_std"] = np.array(pair), error
        about["estimated_std"] = getattr(mean, "estimated_standard_error", 0.0) or np.nan
        if corrected and mean.kind == "dac":
            about["corrected_current"] = about.pop("mean_current")
    source = Source(
        message.source_input,
        message.source_topic,
        message.source_position,
        message.source_time.ToNanoseconds(),
    )
    return Innovation(
        time_ns=message.timestamp.ToNanoseconds(),
        depth=np.array(message.depth),
        flags=np.array(message.flags, np.int8),
        reasons=np.array(message.reasons, np.int32),
        source=source,
        gate=message.gate_threshold,
        profiles=getattr(message, "profiles", 0),
        replayed_residual=pairs("replayed_residual"),
        **{name: getattr(message, name) for name in _NUMBERS},
        **{name: pairs(name) for name in _PAIRS},
        **about,
    )
