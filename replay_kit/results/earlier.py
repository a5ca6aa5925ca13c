"""Results of earlier versions: their innovations, a message each, and weights, after each of them.

With ``measurements.flight_bias`` results before contract version 5 hold, as measured mean currents of dives, the corrected ones.
"""

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Innovation, Source
from replay_kit.results.topics import CONFIG_NAME, stated_records

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


def innovations(path: Path, topic: str, messages: Iterator[bytes]) -> Iterator[Innovation] | None:
    """Return the innovations of the messages of a topic; None where they are of this version.

    Args:
        path: The result.
        topic: Of its innovations.
        messages: Of the topic.
    """
    if (decode := _decoder(path, topic, "replay_kit.Innovation")) is None:
        return None
    with path.open("rb") as file:
        metadata, attached = stated_records(make_reader(file))
    settings = tomllib.loads(attached.get(CONFIG_NAME, b"").decode())
    corrected = int(metadata["contract"]["version"]) < _MEASURED_SINCE and bool(
        settings.get("measurements", {}).get("flight_bias", False)
    )
    return (_innovation(decode(data), corrected) for data in messages)


def weights(
    path: Path, topic: str, messages: Iterator[tuple[int, bytes]]
) -> Iterator[tuple[int, Array]] | None:
    """Return times [ns, UTC] and weights, level after level, of the messages of a topic; None where they hold none.

    Args:
        path: The result.
        topic: Of its estimates.
        messages: Of the topic, with their times.
    """
    if (decode := _decoder(path, topic, "replay_kit.FlowEstimate")) is None:
        return None
    return ((time_ns, np.array(decode(data).weights)) for time_ns, data in messages)


def _decoder(path: Path, topic: str, schema: str) -> Callable[[bytes], Any] | None:
    """Return the decoder of a topic's messages; None where they have another schema."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for one in summary.channels.values():
        if one.topic == topic and summary.schemas[one.schema_id].name == schema:
            return DecoderFactory().decoder_for("protobuf", summary.schemas[one.schema_id])
    return None


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
