"""``python -m tests.fuzz hostile``: inputs made to take time or memory, each given to a command in a process of its own.

Each is a few bytes that claim much, or many bytes that mean nothing; a command must end with an error of ours, or with what is left.
"""

import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from mcap.writer import CompressionType, Writer

from tests.places import ROOT

#: What a command may take: memory at its peak [MB] and time [s].
MOST_MB, MOST_S = 300.0, 10.0
_ENSEMBLE = str(ROOT / "sample_logs" / "ensemble.nc")
_SURVEY = str(ROOT / "sample_logs" / "survey.mcap")
#: Makes the input in a folder and returns the arguments of the command.
Attack = Callable[[Path], list[str]]


@dataclass(frozen=True)
class Measured:
    """What a command took: exit code, processor time [s], memory at its peak [MB], and what it printed last."""

    code: int | None
    seconds: float
    megabytes: float
    said: str


def log(folder: Path, encoding: str, schema: tuple[str, str, bytes] | None, payload: bytes, topic: str = "/x") -> list[str]:
    """Return the command that reads an MCAP with one message."""
    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, chunk_size=1 << 30)
        writer.start()
        number = writer.register_schema(*schema[:2], schema[2]) if schema else 0
        channel = writer.register_channel(topic, encoding, number)
        writer.add_message(channel, 10**18, payload, 10**18)
        writer.finish()
    return ["info", "--full", str(path)]


def _ros1_empty(folder: Path) -> list[str]:
    return log(folder, "ros1", ("p/A", "ros1msg", b"E[] many\n" + b"=" * 80 + b"\nMSG: p/E\n"), struct.pack("<I", 2**31))


def _ros1_fixed(folder: Path) -> list[str]:
    text = b"B[9999] b\n" + b"".join(b"=" * 80 + f"\nMSG: p/{a}\n{b}[9999] c\n".encode() for a, b in ("BC", "CD", "DE")) + b"=" * 80
    return log(folder, "ros1", ("p/A", "ros1msg", text + b"\nMSG: p/E\n"), b"")


def _ros1_strings(folder: Path) -> list[str]:
    return log(folder, "ros1", ("p/A", "ros1msg", b"string[] many\n"), struct.pack("<I", 10**7) + bytes(4 * 10**7))


def _ros1_bool_arrays(folder: Path) -> list[str]:
    return log(folder, "ros1", ("p/A", "ros1msg", b"float32[] many\n"), struct.pack("<I", 15 * 10**6) + bytes(6 * 10**7))


def _cdr_nested(folder: Path) -> list[str]:
    text = b"E[] many\n" + b"=" * 80 + b"\nMSG: p/E\nbool flag\n"
    return log(folder, "cdr", ("p/msg/A", "ros2msg", text), b"\0\1\0\0" + struct.pack("<I", 3 * 10**7) + bytes(3 * 10**7))


def _cdr_fixed(folder: Path) -> list[str]:
    return log(folder, "cdr", ("p/msg/A", "ros2msg", b"float64[2000000000] many\n"), b"\0\1\0\0")


def _cdr_empty(folder: Path) -> list[str]:
    text = b"B[] many\n" + b"=" * 80 + b"\nMSG: p/B\nE[0] none\n" + b"=" * 80 + b"\nMSG: p/E\nbool flag\n"
    return log(folder, "cdr", ("p/msg/A", "ros2msg", text), b"\0\1\0\0" + struct.pack("<I", 2**31))


def _recursive(folder: Path) -> list[str]:
    return log(folder, "cdr", ("p/msg/A", "ros2msg", b"p/A a\n"), b"\0\1\0\0" + bytes(100))


def _idl(text: bytes) -> Attack:
    return lambda folder: log(folder, "cdr", ("p/msg/A", "ros2idl", text), b"\0\1\0\0")


def _big_schema(encoding: str, schema: str, text: bytes) -> Attack:
    return lambda folder: log(folder, encoding, ("p/msg/A" if encoding == "cdr" else "p/A", schema, text), b"\0\1\0\0")


def _json(text: bytes) -> Attack:
    return lambda folder: log(folder, "json", None, text)


def _many_schemas(folder: Path) -> list[str]:
    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        for k in range(300):
            text = f"float64 a{k}\n".encode() + b"\n" * 1_000_000
            channel = writer.register_channel(f"/t{k}", "cdr", writer.register_schema(f"p/msg/A{k}", "ros2msg", text))
            writer.add_message(channel, 10**18 + k, b"\0\1\0\0" + bytes(12), 10**18)
        writer.finish()
    return ["info", "--full", str(path)]


def _proto(folder: Path) -> list[str]:
    found = FileDescriptorSet()
    file: FileDescriptorProto = found.file.add(name="a.proto", package="p", syntax="proto3")
    kind = file.message_type.add(name="A")
    kind.field.add(name="many", number=1, label=3, type=11, type_name=".p.A")
    return log(folder, "protobuf", ("p.A", "protobuf", found.SerializeToString()), b"\x0a\x00" * 10**7)


def _chunk(folder: Path) -> list[str]:
    return log(folder, "none", None, bytes(250_000_000))


def _toml(text: bytes) -> Attack:
    def attack(folder: Path) -> list[str]:
        (folder / "run.toml").write_bytes(text)
        return [
            "replay",
            _SURVEY,
            "--ensemble",
            _ENSEMBLE,
            "--config",
            str(folder / "run.toml"),
            "--dry-run",
            "-o",
            str(folder / "out.mcap"),
        ]

    return attack


def _netcdf(make: Callable[[h5py.File], object], command: Callable[[str], list[str]]) -> Attack:
    def attack(folder: Path) -> list[str]:
        with h5py.File(folder / "file.nc", "w") as file:
            make(file)
        return command(str(folder / "file.nc"))

    return attack


def _as_log(name: str) -> list[str]:
    return ["info", name]


def _as_ensemble(name: str) -> list[str]:
    return ["info", "--ensemble", name]


def _grid(file: h5py.File, sizes: tuple[int, ...] = (4, 2, 50_000, 50_000), kind: object = "f4") -> None:
    """Write an ensemble whose velocities take no room in the file."""
    dims = ("member", "depth", "lat", "lon")
    for name, size in zip(dims, sizes, strict=True):
        axis = file.create_dataset(name, data=np.linspace(1.0, 50.0, size), compression="gzip")
        axis.make_scale(name)
    for name in ("u", "v"):
        values = file.create_dataset(name, shape=sizes, dtype=kind, chunks=tuple(min(size, 1000) for size in sizes))
        for axis, dim in zip(values.dims, dims, strict=True):
            axis.attach_scale(file[dim])


def _objects(file: h5py.File) -> None:
    _grid(file, (4, 2, 5, 5), h5py.string_dtype())


def _glider_grid(file: h5py.File) -> None:
    file.attrs["platform"] = "Seaglider"
    for name in ("time", "depth", "latitude", "longitude", "eng_depth", "log_gps_time", "log_gps_lat", "log_gps_lon", "ctd_depth"):
        file.create_dataset(name, shape=(2_000_000_000,), dtype="f8", chunks=(100_000,))


def _dataflash(folder: Path) -> list[str]:
    declare = struct.pack("<2sBBB4s16s64s", b"\xa3\x95", 128, 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    kinds = (
        struct.pack("<2sBBB4s16s64s", b"\xa3\x95", 128, 10 + k % 2, 12, b"AB" + b"%02d" % (k % 97), b"Qb", b"TimeUS,V")
        for k in range(100_000)
    )
    (folder / "log.BIN").write_bytes(declare + b"".join(kinds))
    return ["info", str(folder / "log.BIN")]


def _tlog(folder: Path) -> list[str]:
    (folder / "log.tlog").write_bytes((struct.pack(">Q", 1_700_000_000_000_000) + b"\xfd\xff\x01" + bytes(9)) * 500_000)
    return ["info", str(folder / "log.tlog")]


def _pd0(folder: Path) -> list[str]:
    one = b"\x7f\x7f" + struct.pack("<HBBH", 65_000, 0, 1, 8) + b"\0\0"
    (folder / "log.pd0").write_bytes(one * 400_000 + bytes(65_000))
    return ["info", str(folder / "log.pd0")]


def _ad2cp(folder: Path) -> list[str]:
    (folder / "log.ad2cp").write_bytes(b"\xa5\x0a\xff\x16\x10\xff\xff\x00\x00\x00" * 400_000)
    return ["info", str(folder / "log.ad2cp")]


def _threads(folder: Path) -> list[str]:
    return ["replay", _SURVEY, "--ensemble", _ENSEMBLE, "--output.threads", "1000000", "-o", str(folder / "out.mcap")]


ATTACKS: dict[str, Attack] = {
    "ROS 1: array of 2^31 empty messages": _ros1_empty,
    "ROS 1: fixed arrays of arrays, 10^16 messages": _ros1_fixed,
    "ROS 1: 10 million texts": _ros1_strings,
    "ROS 1: 15 million numbers": _ros1_bool_arrays,
    "ROS 2: array of 30 million messages": _cdr_nested,
    "ROS 2: fixed array of 2 billion numbers": _cdr_fixed,
    "ROS 2: array of 2^31 empty messages": _cdr_empty,
    "ROS 2: a type that contains itself": _recursive,
    "IDL: 200 kB of newlines": _idl(b"\n" * 200_000),
    "IDL: 200 kB of comments without end": _idl(b"/*" * 100_000),
    "IDL: 200 kB of quotation marks": _idl(b'"\\' * 100_000),
    "IDL: nested modules": _idl(b"module a {" * 100_000),
    "schema: 50 MB of ros2msg": _big_schema("cdr", "ros2msg", b"float64 abc\n" * 4_200_000),
    "schema: 50 MB of ros2idl": _big_schema("cdr", "ros2idl", b"module a { };\n" * 3_600_000),
    "schema: 50 MB of ros1msg": _big_schema("ros1", "ros1msg", b"float64 abc\n" * 4_200_000),
    "schema: 300 of 1 MB": _many_schemas,
    "JSON: 30 million lists": _json(b'{"a":[' + b"[]," * 30_000_000 + b"[]]}"),
    "JSON: 5 million mappings": _json(b'{"a":[' + b'{"":1},' * 5_000_000 + b"{}]}"),
    "JSON: 900 nested lists": _json(b'{"a":' + b"[" * 900 + b"]" * 900 + b"}"),
    "JSON: 100,000 nested lists": _json(b'{"a":NaN,"b":' + b"[" * 100_000 + b"]" * 100_000 + b"}"),
    "JSON: quotation marks without end": _json(b'{"a":NaN' + b'"\\' * 100_000),
    "protobuf: 10 million empty messages": _proto,
    "chunk: 250 MB of zeros": _chunk,
    "TOML: nested 5,000 deep": _toml(b"a=" + b"[" * 5000 + b"]" * 5000),
    "TOML: key of 5,000 parts": _toml(b".".join([b"a"] * 5000) + b"=1"),
    "TOML: integer of 5,000 digits": _toml(b"[output]\nthreads=" + b"9" * 5000),
    "TOML: 30 MB": _toml(b"[output]\n" + b"# comment\n" * 3_000_000),
    "NetCDF ensemble: grid of 10^10 cells": _netcdf(_grid, _as_ensemble),
    "NetCDF ensemble: velocities are texts": _netcdf(_objects, _as_ensemble),
    "NetCDF glider: 2 billion samples": _netcdf(_glider_grid, _as_log),
    "DataFlash: 100,000 declarations": _dataflash,
    "MAVLink: 500,000 frames cut short": _tlog,
    "PD0: 400,000 headers of 65 kB": _pd0,
    "AD2CP: 400,000 headers of 65 kB": _ad2cp,
    "threads = 1000000": _threads,
}


def measured(arguments: list[str], folder: Path, limit_s: float = 90.0, limit_mb: int = 6000) -> Measured:
    """Run ``replay-kit`` in a process of its own and return what it took.

    Args:
        arguments: Of the command.
        folder: In which it runs.
        limit_s: After which it is stopped [s of the clock].
        limit_mb: Address space that it may have [MB].
    """
    begin, peak, killed = time.perf_counter(), 0.0, False
    with open(folder / "said", "w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-c", _CHILD, str(limit_mb << 20), *arguments],
            stdout=said,
            stderr=said,
            cwd=folder,
            env={**os.environ, "COLUMNS": "160"},
        )
        while (ended := os.wait4(process.pid, os.WNOHANG))[0] == 0:
            peak = _peak(f"/proc/{process.pid}/status") or peak
            if time.perf_counter() - begin > limit_s and not killed:
                process.kill()
                killed = True
            time.sleep(0.02)
        process.returncode = os.waitstatus_to_exitcode(ended[1])
        said.seek(0)
        text = said.read()
    if (folder / "peak").exists():
        peak = _peak(str(folder / "peak"))
    # of the process alone: other work on the machine takes none of it
    seconds = ended[2].ru_utime + ended[2].ru_stime
    return Measured(None if killed else process.returncode, seconds, peak, text)


#: The resident memory that the kernel remembers of a process is, unlike that of ``getrusage``, not its parent's before it.
_CHILD = """
import resource, sys
from replay_kit.cli.app import main
resource.setrlimit(resource.RLIMIT_AS, 2 * (int(sys.argv.pop(1)),))
try:
    main()
finally:
    open("peak", "w").write(open("/proc/self/status").read())
"""


def _peak(status: str) -> float:
    """Return the resident memory at its peak [MB] that a process's status states; 0 when it has ended."""
    try:
        lines = Path(status).read_text().splitlines()
    except (OSError, ProcessLookupError):
        return 0.0
    return next((float(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmHWM")), 0.0)


def run_all(words: str) -> int:
    """Print a table of those whose names hold some words, and return how many take too much or end with a traceback."""
    bad = 0
    for name, attack in ATTACKS.items():
        if words not in name:
            continue
        with tempfile.TemporaryDirectory() as folder:
            arguments = attack(Path(folder))
            took = measured(arguments, Path(folder))
        wrong = took.code is None or "Traceback" in took.said or took.megabytes > MOST_MB or took.seconds > MOST_S
        bad += wrong
        last = " / ".join(" ".join(line.split()) for line in took.said.splitlines() if line.strip())
        marks = ("annot", "replay-kit:", "skipped", "Damage")
        told = next((line.strip() for line in took.said.splitlines() if any(mark in line for mark in marks)), last[-200:])[:240]
        figures = f"{'none' if took.code is None else took.code} | {took.seconds:.1f} s | {took.megabytes:.0f} MB"
        print(f"| {name} | {figures} | {'BAD ' if wrong else ''}{told} |", flush=True)
    return bad
