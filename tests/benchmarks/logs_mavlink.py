"""ArduPilot's logs against pymavlink's own readers: a telemetry log whole and in part, a DataFlash log.

The files are the real ones repeated, each time with later stamps; where they are absent, and at the tiny size, small ones made here.
"""

import tempfile
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import DFReader, mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.logs import open_log
from replay_kit.logs.dataflash.reader import DataflashReader
from replay_kit.logs.dataflash.records import HEAD, read_records
from replay_kit.logs.mavlink.frames import read_frames
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.measurements import MAVLINK_NAMES
from tests.benchmarks.measure import Row, peak_mb, row, runner, seconds
from tests.logs.dataflash.dataflash_samples import dataflash
from tests.logs.log_samples import SHARED, attitude, tlog_entry

START_US = 1_700_000_000_000_000


def repeated_tlog(data: bytes, copies: int) -> bytes:
    """A telemetry log many times over, each copy stamped a second after the end of the one before."""
    places, stamps = [], []
    for frames in read_frames(BytesIO(data), ReadStatistics()):
        places.append(frames.start + frames.offset)
        stamps.append(frames.stamp_us)
    return _repeated(data, copies, np.concatenate(places), np.concatenate(stamps), ">u8")


def repeated_dataflash(data: bytes, copies: int) -> bytes:
    """A DataFlash log many times over, each copy stamped a second after the end of the one before."""
    stamps = []
    for records in read_records(BytesIO(data), ReadStatistics()):
        for form, which in records.decodable():
            if "TimeUS" in form.columns:
                values = records.structured(form, which)["TimeUS"]
                stamps.append(
                    (
                        records.offset
                        + records.start[which]
                        + HEAD
                        + form.dtype.fields["TimeUS"][1],
                        values,
                    )
                )
    place, stamp = (np.concatenate(column) for column in zip(*stamps, strict=True))
    return _repeated(data, copies, place, stamp, "<u8")


def _repeated(data: bytes, copies: int, place: Any, stamp: Any, form: str) -> bytes:
    """Stamps lie at some places, as numbers of a form."""
    stamp = stamp.astype(np.int64)
    step = np.ptp(stamp) + 1_000_000
    out = np.tile(np.frombuffer(data, dtype=np.uint8), (copies, 1))
    for n, copy in enumerate(out):
        copy[place[:, None] + np.arange(8)] = (
            (stamp + n * step).astype(form).view(np.uint8).reshape(-1, 8)
        )
    return out.tobytes()


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


def pymavlink_columns(path: Path) -> dict[str, dict[str, list[Any]]]:
    """All columns of a DataFlash log by pymavlink's reader."""
    log = DFReader.DFReader_binary(str(path), zero_time_base=False)
    tables: dict[str, dict[str, list[Any]]] = {}
    while (message := log.recv_msg()) is not None:
        kind = message.get_type()
        if kind not in tables:
            tables[kind] = {name: [] for name in message.get_fieldnames()}
        for name, values in tables[kind].items():
            values.append(getattr(message, name))
    log.close()
    return tables


def differing_columns(
    ours: dict[str, dict[str, Any]], theirs: dict[str, dict[str, list[Any]]]
) -> float:
    found = float(len(ours.keys() ^ theirs.keys()))
    for kind in ours.keys() & theirs.keys():
        for name in ours[kind].keys() | theirs[kind].keys():
            mine = ours[kind][name].tolist()
            other = [
                list(value) if hasattr(value, "tolist") else value for value in theirs[kind][name]
            ]
            found += mine != other and repr(mine) != repr(other)
    return found


def dataflash_row(path: Path, repeats: int) -> Row:
    before = peak_mb(anew=True)
    ours_s, ours = seconds(lambda: DataflashReader(path).tables(), repeats)
    grown = peak_mb() - before
    peer_s, theirs = seconds(lambda: pymavlink_columns(path), repeats)
    bare_s, _ = seconds(lambda: _records_only(path))
    errors = {"differing_columns": differing_columns(ours, theirs)}
    count = sum(len(next(iter(columns.values()))) for columns in ours.values())
    name = f"DataFlash log of {path.stat().st_size / 1e6:.1f} MB, all columns"
    peer = "pymavlink, DFReader_binary, each field of each message into a list"
    return row(
        name,
        ours_s,
        peer,
        peer_s,
        6.0,
        errors,
        records=count,
        peer_without_fields_s=bare_s,
        peak_mb=grown,
    )


def _records_only(path: Path) -> None:
    log = DFReader.DFReader_binary(str(path), zero_time_base=False)
    while log.recv_msg() is not None:
        pass
    log.close()


def rows(tiny: bool) -> list[Row]:
    """All rows, each in a process of its own; tiny ones in this one."""
    real = SHARED / "ardusub"
    use = real.is_dir() and not tiny
    telemetry = (real / "small.tlog").read_bytes() if use else small_tlog()
    binary = (real / "small.BIN").read_bytes() if use else b"".join(dataflash(20))
    run = runner(tiny)
    repeats = 1 if tiny else 2
    # so many times a reader takes seconds; the synthetic logs are shorter
    all_times, some_times, binary_times = (
        (2, 2, 2) if tiny else (10, 30, 40) if use else (2000, 6000, 2000)
    )
    with tempfile.TemporaryDirectory() as folder:
        whole, part, columns = (
            Path(folder) / name for name in ("all.tlog", "some.tlog", "log.BIN")
        )
        whole.write_bytes(repeated_tlog(telemetry, all_times))
        part.write_bytes(repeated_tlog(telemetry, some_times))
        columns.write_bytes(repeated_dataflash(binary, binary_times))
        return [
            run(lambda: tlog_row(whole, None, 2.5, repeats)),
            run(lambda: tlog_row(part, MAVLINK_NAMES, 5.0, repeats)),
            run(lambda: dataflash_row(columns, repeats)),
        ]
