"""Reading and writing MCAP against the stock library, in one run on the same files."""

import base64
import json
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import foxglove.messages as fox
import orjson
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import Innovation, Source, VehicleState
from replay_kit.estimator import build
from replay_kit.logs import merge, open_log
from replay_kit.results import ResultWriter
from tests.benchmarks import scene
from tests.benchmarks.measure import Row, row, seconds

_SECOND = 1_000_000_000
_START = 1_542_326_400 * _SECOND


def _fix(n: int) -> dict[str, Any]:
    return {
        "timestamp": {"sec": _START // _SECOND + n, "nsec": 0},
        "frame_id": "vehicle",
        "latitude": -40.1 + 1e-6 * n,
        "longitude": 152.1 - 1e-6 * n,
        "altitude": -12.5,
        "position_covariance": [0.25 * k for k in range(9)],
        "position_covariance_type": 0,
        "metadata": [{"key": "dead_reckoned", "value": "0"}],
    }


def _protobuf_fix(n: int) -> bytes:
    value = _fix(n)
    del value["position_covariance_type"]
    value["timestamp"] = fox.Timestamp(value["timestamp"]["sec"], 0)
    value["metadata"] = [fox.KeyValuePair(**pair) for pair in value["metadata"]]
    return bytes(fox.LocationFix(**value).encode())


def _write(
    path: Path,
    count: int,
    encoding: str,
    schema: tuple[str, str, bytes],
    payload: Callable[[int], bytes],
) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/fix", encoding, writer.register_schema(*schema))
        for n in range(count):
            writer.add_message(channel, _START + n * _SECOND, payload(n), _START + n * _SECOND, n)
        writer.finish()
    return path


def _ours(path: Path) -> list[Any]:
    """The number of messages, and the last payload."""
    count, payload = 0, None
    for message in merge([open_log(path)], 1.0):
        count, payload = count + 1, message.payload
    return [count, payload]


def _peer_json(path: Path) -> list[Any]:
    count, payload = 0, None
    with path.open("rb") as file:
        for _, _, message in make_reader(file, validate_crcs=True).iter_messages():
            count, payload = count + 1, orjson.loads(message.data)
    return [count, payload]


def _peer_protobuf(path: Path) -> list[Any]:
    count, value = 0, None
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for _, _, _, value in reader.iter_decoded_messages():  # noqa: B007 - the last is compared
            count += 1
    return [count, {name: getattr(value, name) for name in ("latitude", "longitude")}]


def _reading(
    name: str, path: Path, peer: Callable[[Path], list[Any]], words: str, repeats: int
) -> Row:
    """In order of time, as a replay reads and as the stock reader does unless told otherwise."""
    ours_s, (count, payload) = seconds(lambda: _ours(path), repeats)
    peer_s, (peer_count, some) = seconds(lambda: peer(path), repeats)
    differs = count != peer_count or any(payload[key] != value for key, value in some.items())
    return row(
        name,
        ours_s,
        words,
        peer_s,
        1.0,
        {"messages_differ": float(differs)},
        messages=count,
        megabytes=path.stat().st_size / 1e6,
    )


def reading_rows(folder: Path, tiny: bool) -> list[Row]:
    """JSON and protobuf, decoded to plain dicts, against the stock reader with orjson and with mcap-protobuf-support."""
    count, repeats = (200, 1) if tiny else (300_000, 3)
    schema = fox.LocationFix.get_schema()
    peer = "mcap reader, mcap-protobuf-support, checksums on; its values stay packed, ours are plain dicts"
    forms = {
        "JSON": (
            *(("foxglove.LocationFix", "jsonschema", b'{"type":"object"}'), _peer_json),
            *(lambda n: orjson.dumps(_fix(n)), "mcap reader, orjson, checksums on"),
        ),
        "protobuf": (
            (schema.name, schema.encoding, schema.data),
            _peer_protobuf,
            _protobuf_fix,
            peer,
        ),
    }
    return [
        _reading(
            f"MCAP read, {name}",
            _write(folder / f"{name}.mcap", count, name.lower(), about, payload),
            *(read, words, repeats),
        )
        for name, (about, read, payload, words) in forms.items()
    ]


def writing_row(folder: Path, tiny: bool) -> Row:
    """An hour of pings at 1 Hz: fixes, innovations and, of 300 modes a level, six times slices with arrows."""
    pings = 20 if tiny else 3600
    size, modes = ((5, 6, 3, 6), 4) if tiny else ((17, 31, 8, 95), 300)
    members, truth = scene.withheld(*size)
    estimator = build([members], EstimatorConfig(modes=modes))
    observed = scene.pings(truth, scene.track(1))
    state, (step,) = estimator.assimilate(estimator.initial(), observed)
    flow, levels = estimator.flow(state), members.grid.levels
    fix = VehicleState(_START, 152.0, -40.0, 10.0, False, Source(0, "/fix", 1, _START))
    depths = tuple(float(levels[k]) for k in sorted({0, levels.size // 2, levels.size - 1}))

    def write() -> None:
        writer, block = ResultWriter(folder / "ours.mcap", overwrite=True), list[Innovation]()
        for n in range(pings):
            time_ns = _START + n * _SECOND
            writer.fix(replace(fix, time_ns=time_ns))
            block.append(replace(step.innovation, time_ns=time_ns))
            if len(block) == 16:
                writer.innovations(block)
                block.clear()
            if n % 600 == 0:
                writer.grids(time_ns, flow, depths)
        writer.close()

    ours_s, _ = seconds(write)
    written = list(open_log(folder / "ours.mcap").messages())
    peer_s, count = seconds(lambda: _as_json(folder / "peer.mcap", written))
    return row(
        f"MCAP results of {pings} pings computed, written, synced and read back",
        ours_s,
        "the same messages written by mcap.Writer and json.dumps, neither computed nor synced nor read back",
        peer_s,
        1.0,
        {"messages_differ": float(count != len(written))},
        megabytes=(folder / "ours.mcap").stat().st_size / 1e6,
        peer_megabytes=(folder / "peer.mcap").stat().st_size / 1e6,
    )


def _as_json(path: Path, messages: Iterable[Message]) -> int:
    """Write messages as JSON, and return how many the file says it has."""
    with path.open("wb") as file:
        writer, channels = Writer(file, enable_data_crcs=True), dict[str, int]()
        writer.start()
        for message in messages:
            if message.topic not in channels:
                schema = writer.register_schema(message.schema, "jsonschema", b'{"type":"object"}')
                channels[message.topic] = writer.register_channel(message.topic, "json", schema)
            data = json.dumps(message.payload, default=_plain).encode()
            writer.add_message(channels[message.topic], message.time_ns, data, message.time_ns)
        writer.finish()
    return sum(1 for _ in open_log(path).messages())


def _plain(value: Any) -> Any:
    """Return as JSON has it what it does not know: arrays as lists, bytes in base 64."""
    return base64.b64encode(value).decode() if isinstance(value, bytes) else value.tolist()


def rows(tiny: bool) -> list[Row]:
    """All rows; temporary files go when they end."""
    with tempfile.TemporaryDirectory() as folder:
        return [*reading_rows(Path(folder), tiny), writing_row(Path(folder), tiny)]
