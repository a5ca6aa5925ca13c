"""ArduPilot's logs against pymavlink's own readers: a telemetry log whole and in part, a DataFlash log.

The files are real ones; where they are absent, and at the tiny size, the sample and a smaller one made here.
"""

import tempfile
from collections.abc import Iterable, Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

from pymavlink import DFReader, mavutil

from replay_kit.logs import open_log
from replay_kit.workflows.replay.inputs.scan import MAVLINK_NAMES
from tests.benchmarks.measure import Row, peak_mb, row, runner, seconds
from tests.logs.log_samples import SHARED
from tests.logs.mavlink.dataflash_samples import dataflash
from tests.places import SAMPLES


def differing(ours: Iterable[tuple[str, dict[str, Any]]], theirs: Iterable[Any]) -> float:
    """How many messages are not the same in both, NaN being the same as NaN."""
    found = 0
    for mine, other in zip_longest(ours, theirs):
        expected = {} if other is None else other.to_dict()
        found += repr((expected.pop("mavpackettype", None), expected)) != repr(mine)
    return float(found)


def tlog_messages(path: Path, names: frozenset[str] | None) -> Iterator[tuple[str, dict[str, Any]]]:
    return (
        (message.schema, dict(message.payload))
        for message in open_log(path, wanted=names).messages()
    )


def pymavlink_messages(path: Path, names: frozenset[str] | None) -> Iterator[Any]:
    link = mavutil.mavlink_connection(str(path), dialect="ardupilotmega", zero_time_base=False)
    try:
        while (message := link.recv_match(type=None if names is None else list(names))) is not None:
            if message.get_type() != "BAD_DATA":
                yield message
    finally:
        link.close()


def tlog_row(path: Path, names: frozenset[str] | None, asked: float, repeats: int) -> Row:
    before = peak_mb(anew=True)
    ours_s, count = seconds(
        lambda: sum(1 for _ in open_log(path, wanted=names).messages()), repeats
    )
    grown = peak_mb() - before
    peer_s, _ = seconds(lambda: sum(1 for _ in pymavlink_messages(path, names)), repeats)
    errors = {
        "differing_messages": differing(tlog_messages(path, names), pymavlink_messages(path, names))
    }
    which = "all messages" if names is None else "what the estimator uses"
    size = path.stat().st_size / 1e6
    peer = "pymavlink, recv_match()" if names is None else "pymavlink, recv_match(type=...)"
    return row(
        f"telemetry log of {size:.1f} MB, {which}",
        ours_s,
        peer,
        peer_s,
        asked,
        errors,
        messages=count,
        peak_mb=grown,
    )


def pymavlink_records(path: Path) -> list[str]:
    """All records of a DataFlash log by pymavlink's reader."""
    log, found = DFReader.DFReader_binary(str(path), zero_time_base=False), list[str]()
    while (message := log.recv_msg()) is not None:
        fields = message.to_dict()
        plain = {n: list(v) if hasattr(v, "tolist") else v for n, v in fields.items()}
        found.append(f"dataflash.{plain.pop('mavpackettype')} {plain}")
    log.close()
    return found


def dataflash_records(path: Path) -> list[str]:
    """All records of a DataFlash log by ours."""
    return [f"{message.schema} {message.payload}" for message in open_log(path).messages()]


def dataflash_row(path: Path, repeats: int) -> Row:
    before = peak_mb(anew=True)
    ours_s, ours = seconds(lambda: dataflash_records(path), repeats)
    grown = peak_mb() - before
    peer_s, theirs = seconds(lambda: pymavlink_records(path), repeats)
    errors = {"differing_records": float(len(set(ours) ^ set(theirs)))}
    name = f"DataFlash log of {path.stat().st_size / 1e6:.1f} MB, all records as text"
    peer = "pymavlink, DFReader_binary"
    return row(name, ours_s, peer, peer_s, 0.9, errors, records=len(ours), peak_mb=grown)


def rows(tiny: bool) -> list[Row]:
    """All rows, each in a process of its own; tiny ones in this one."""
    real, run, repeats = SHARED / "ardusub", runner(tiny), 1 if tiny else 5
    with tempfile.TemporaryDirectory() as folder:
        telemetry, binary = real / "small.tlog", real / "small.BIN"
        if tiny or not real.is_dir():
            telemetry, binary = SAMPLES / "glider.tlog", Path(folder) / "small.BIN"
            binary.write_bytes(b"".join(dataflash(20)))
        return [
            run(lambda: tlog_row(telemetry, None, 2.5, repeats)),
            run(lambda: tlog_row(telemetry, MAVLINK_NAMES, 5.0, repeats)),
            run(lambda: dataflash_row(binary, repeats)),
        ]
