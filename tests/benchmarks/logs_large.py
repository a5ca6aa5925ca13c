"""A log of many messages: what is in it, by the index and in full, against a loop of the stock reader."""

import tempfile
from collections import Counter
from pathlib import Path
from typing import Any
from unittest import mock

from mcap.reader import make_reader
from mcap.writer import Writer

from replay_kit.config.run import load_config
from replay_kit.logs.mcap import index
from replay_kit.workflows.info.inspect import LogInfo, inspect_logs
from tests.benchmarks.measure import Row, row, seconds

_START = 1_542_326_400 * 10**9


def _many(path: Path, count: int) -> Path:
    """Write many small messages, one in a hundred of them a fix, in the stock writer's chunks of 1 MB."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = []
        for topic, schema in (("/attitude", "Attitude"), ("/fix", "foxglove.LocationFix")):
            number = writer.register_schema(schema, "jsonschema", b'{"type":"object"}')
            channels.append(writer.register_channel(topic, "json", number))
        for n in range(count):
            time_ns, fix = _START + n * 1_000_000, n % 100 == 0
            payload = b'{"n":%d,"roll":0.1,"pitch":0.2,"yaw":0.3}' % n
            if fix:
                payload = b'{"latitude":-40.1,"longitude":152.1,"altitude":%d}' % -n
            writer.add_message(channels[fix], time_ns, payload, time_ns, n)
        writer.finish()
    return path


def _stock_counts(path: Path) -> Counter[str]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return Counter(
            channel.topic for _, channel, _ in reader.iter_messages(log_time_order=False)
        )


def _counts(info: LogInfo) -> dict[str, int]:
    return {name: topic.messages for name, topic in info.topics.items()}


def _info_rows(what: str, path: Path) -> list[Row]:
    config = load_config(None)
    size = sum(chunk.uncompressed_size for chunk in _summary(path).chunk_indexes) / 1e6
    by_index_s, by_index = seconds(lambda: inspect_logs([path], config)[0])
    full_s, full = seconds(lambda: inspect_logs([path], config, full=True)[0])
    stock_s, stock = seconds(lambda: _stock_counts(path))
    summary_s, _ = seconds(lambda: _summary(path))
    differ = float(_counts(by_index) != stock)
    return [
        row(
            f"info by the index: {what}",
            by_index_s,
            error={"messages_differ": differ + float(by_index.sampled is None)},
            asked_s=2.0,
            summary_of_mcap_reader_s=summary_s,
        ),
        row(
            f"info --full: {what}",
            full_s,
            "mcap reader counts the messages, checksums on",
            stock_s,
            1.0,
            {"messages_differ": float(_counts(full) != stock)},
            megabytes=size,
            file_megabytes=path.stat().st_size / 1e6,
            megabytes_per_s=size / full_s,
            asked_megabytes_per_s=100.0,
            file_megabytes_per_s=path.stat().st_size / 1e6 / full_s,
        ),
    ]


def _summary(path: Path) -> Any:
    with path.open("rb") as file:
        return make_reader(file).get_summary()


def rows(tiny: bool) -> list[Row]:
    """Five million small messages; the file goes when it ends."""
    count = 2_000 if tiny else 5_000_000
    # a log of nothing would be read whole
    few = mock.patch.object(index, "FEW_MESSAGES", 1 if tiny else index.FEW_MESSAGES)
    with few, tempfile.TemporaryDirectory() as folder:
        return _info_rows(f"{count} messages", _many(Path(folder) / "many.mcap", count))
