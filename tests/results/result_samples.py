"""A small run's settings, and its result read back with stock readers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

DEPTHS = (0.5, 120.0)
METADATA = {"inputs": {"log": "sha256:00"}, "options": {"preset": "default", "modes": "4"}}
CONFIG = "[estimator]\nmodes = 4\n"
TOPICS = {
    "/tf": "foxglove.FrameTransform",
    "/vehicle/fix": "foxglove.LocationFix",
    "/flow/innovation": "replay_kit.Innovations",
    "/flow/estimate": "replay_kit.Estimate",
    "/flow/grid/0.5m": "foxglove.Grid",
    "/flow/arrows/0.5m": "foxglove.SceneUpdate",
    "/flow/grid/120m": "foxglove.Grid",
    "/flow/arrows/120m": "foxglove.SceneUpdate",
    "/plan/path": "foxglove.PosesInFrame",
    "/plan/geojson": "foxglove.GeoJSON",
    "/plan/controls": "replay_kit.Plan",
    "/log": "foxglove.Log",
}

Run = Callable[[Path], Path]


def decoded(path: Path, *topics: str) -> dict[str, list[tuple[int, Any]]]:
    """Return the messages of some topics of a result, of all without one, by topic: time and value."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        out: dict[str, list[tuple[int, Any]]] = {}
        for schema, channel, message, value in reader.iter_decoded_messages(topics=topics or None):
            assert TOPICS.get(channel.topic, schema.name) == schema.name
            assert message.log_time == message.publish_time
            out.setdefault(channel.topic, []).append((message.log_time, value))
    return out


def metadata_of(path: Path) -> dict[str, dict[str, str]]:
    """Return the metadata records of a result by their names."""
    with path.open("rb") as file:
        return {record.name: record.metadata for record in make_reader(file).iter_metadata()}
