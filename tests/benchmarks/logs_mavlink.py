"""ArduPilot's logs against pymavlink's own readers: a telemetry log whole and in part, a DataFlash log.

The files are real ones; where they are absent, and at the tiny size, smaller ones made here.
"""

import tempfile
from collections.abc import Callable, Iterable, Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

from pymavlink import DFReader, mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.logs import open_log
from replay_kit.workflows.replay.inputs.scan import MAVLINK_NAMES
from tests.benchmarks.measure import Row, peak_mb, row, runner, seconds
from tests.logs.log_samples import SHARED, attitude, tlog_entry
from tests.logs.mavlink.dataflash_samples import dataflash

START_US = 1_700_000_000_000_000


def small_tlog() -> bytes:
    """A telemetry log with a little of everything."""
    kinds: tuple[Callable[[int], Any], ...] = (
        attitude,
        lambda n: dialect.MAVLink_global_position_int_message(
            n, 473000000 + n, -1246305732, 60, -1500 - n, 1, 2, 3, 65535
        ),
        lambda n: dialect.MAVLink_gps_raw_int_message(
            START_US + n, 3, 473000000 + n, -1246305732, 0, 199, 65535, 0, 0, 21
        ),
        lambda n: dialect.MAVLink_statustext_message(6, b"dive %d" % n),
        lambda n: dialect.MAVLink_debug_float_array_message(
            START_US, b"ADCP_E", n, [0.5 * n, float("nan"), *[0.0] * 56]
        ),
        lambda n: dialect.MAVLink_system_time_message(START_US + 1000 * n, 1 + n),
    )
    # MAVLink 2 throughout: pymavlink takes the version of the first frame for that of all
    return b"".join(tlog_entry(START_US + 1000 * n, kinds[n % 6](n)) for n in range(120))


def differing(ours: Iterable[tuple[str, dict[str, Any]]], theirs: Iterable[Any]) -> float:
    """How many messages are not the same in both, NaN being the same as NaN."""
    found = 0
    for mine, other in zip_longest(ours, theirs):
        expected = None if other is None else other.to_dict()
        if (
            mine is None
            or expected is None
            or mine[0] != expected.pop("mavpackettype")
            or mine[1] != expected
        ):
            found += mine is None or expected is None or repr(mine[1]) != repr(expected)
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
    log = DFReader.DFReader_binary(str(path), zero_time_base=False)
    found = []
    while (message := log.recv_msg()) is not None:
        fields = {
            name: list(value) if hasattr(value, "tolist") else value
            for name, value in message.to_dict().items()
        }
        found.append(f"dataflash.{fields.pop('mavpackettype')} {fields}")
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
            telemetry, binary = (Path(folder) / name for name in ("small.tlog", "small.BIN"))
            telemetry.write_bytes(small_tlog())
            binary.write_bytes(b"".join(dataflash(20)))
        return [
            run(lambda: tlog_row(telemetry, None, 2.5, repeats)),
            run(lambda: tlog_row(telemetry, MAVLINK_NAMES, 5.0, repeats)),
            run(lambda: dataflash_row(binary, repeats)),
        ]
