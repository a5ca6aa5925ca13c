"""Inputs made to take time or memory: a few bytes that claim much, or many bytes that mean nothing."""

import struct
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from mcap.writer import CompressionType, Writer

from tests.forecast.forms import unwritten_stores
from tests.fuzz.bombs import BOMBS, Attack, info_of, replay_of
from tests.logs.adcp.raw_adcp_samples import nortek_sum

#: Makes the bytes: each only for its own attack, as many are tens of megabytes.
Text = Callable[[], bytes]


def log(folder: Path, *kinds: tuple[str, tuple[str, str, bytes] | None, bytes]) -> list[str]:
    """Return the command that reads a log of topics, each with message encoding, schema (name, encoding, text), and one payload."""
    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, chunk_size=1 << 22)
        writer.start()
        for k, (encoding, schema, payload) in enumerate(kinds):
            number = writer.register_schema(*schema) if schema else 0
            channel = writer.register_channel(f"/t{k}", encoding, number)
            writer.add_message(channel, 10**18 + k, payload, 10**18)
        writer.finish()
    return ["info", "--full", str(path)]


#: Begins the definition of another type.
_TYPE = b"=" * 80 + b"\nMSG: p/"


def _ros(cdr: bool, text: Text, payload: bytes) -> Attack:
    """Return a message of a type ``p/A`` of ROS 1 or 2."""
    name, encoding, schema = ("p/msg/A", "cdr", "ros2msg") if cdr else ("p/A", "ros1", "ros1msg")
    begin = b"\0\1\0\0" if cdr else b""
    return lambda folder: log(folder, (encoding, (name, schema, text()), begin + payload))


def _json(text: Text) -> Attack:
    return lambda folder: log(folder, ("json", None, text()))


def _many_schemas(folder: Path) -> list[str]:
    payload = b"\0\1\0\0" + bytes(12)
    texts = (f"float64 a{k}\n".encode() + b"\n" * 1_000_000 for k in range(300))
    return log(
        folder,
        *(("cdr", (f"p/msg/A{k}", "ros2msg", text), payload) for k, text in enumerate(texts)),
    )


def _protobuf_sets(folder: Path) -> list[str]:
    """Return the command that reads a log of 30 descriptor sets, each of a type of 800 lists of another of 800 fields."""

    def made(number: int) -> bytes:
        found, kind = FileDescriptorSet(), FieldDescriptorProto
        file = found.file.add(name=f"{number}.proto", package="p", syntax="proto3")
        lists, flat = file.message_type.add(name="A"), file.message_type.add(name="B")
        for k in range(1, 801):
            many = lists.field.add(name=f"b{k:x}", number=k, label=kind.LABEL_REPEATED)
            many.type, many.type_name = kind.TYPE_MESSAGE, ".p.B"
            one = flat.field.add(name=f"b{k:x}", number=k, label=kind.LABEL_OPTIONAL)
            one.type = kind.TYPE_INT32
        return found.SerializeToString()

    return log(
        folder, *(("protobuf", ("p.A", "protobuf", made(number)), b"") for number in range(30))
    )


def _proto(folder: Path) -> list[str]:
    found = FileDescriptorSet()
    file: FileDescriptorProto = found.file.add(name="a.proto", package="p", syntax="proto3")
    kind = file.message_type.add(name="A")
    kind.field.add(name="many", number=1, label=3, type=11, type_name=".p.A")
    schema = "p.A", "protobuf", found.SerializeToString()
    return log(folder, ("protobuf", schema, b"\x0a\x00" * 10**7))


def _chunk(folder: Path) -> list[str]:
    return log(folder, ("none", None, bytes(250_000_000)))


def _toml(text: Text) -> Attack:
    def attack(folder: Path) -> list[str]:
        (folder / "run.toml").write_bytes(text())
        return replay_of(folder, "--config", str(folder / "run.toml"), "--dry-run")

    return attack


def _netcdf(make: Callable[[h5py.File], object], *options: str) -> Attack:
    def attack(folder: Path) -> list[str]:
        with h5py.File(folder / "file.nc", "w") as file:
            make(file)
        return ["info", *options, str(folder / "file.nc")]

    return attack


def _zarr(folder: Path) -> list[str]:
    return ["info", "--ensemble", *map(str, unwritten_stores(folder, (80, 3059, 4322)))]


def _grid(
    file: h5py.File, sizes: tuple[int, ...] = (4, 2, 50_000, 50_000), kind: object = "f4"
) -> None:
    """Write an ensemble whose velocities take no room in the file."""
    dims = ("member", "depth", "lat", "lon")
    for name, size in zip(dims, sizes, strict=True):
        axis = file.create_dataset(name, data=np.linspace(1.0, 50.0, size), compression="gzip")
        axis.make_scale(name)
    for name in ("u", "v"):
        values = file.create_dataset(
            name, shape=sizes, dtype=kind, chunks=tuple(min(size, 1000) for size in sizes)
        )
        for axis, dim in zip(values.dims, dims, strict=True):
            axis.attach_scale(file[dim])


def _objects(file: h5py.File) -> None:
    _grid(file, (4, 2, 5, 5), h5py.string_dtype())


def _glider_grid(file: h5py.File) -> None:
    file.attrs["platform"] = "Seaglider"
    for name in (
        "time",
        "depth",
        "latitude",
        "longitude",
        "eng_depth",
        "log_gps_time",
        "log_gps_lat",
        "log_gps_lon",
        "ctd_depth",
    ):
        file.create_dataset(name, shape=(2_000_000_000,), dtype="f8", chunks=(100_000,))


def _tlog() -> bytes:
    time = struct.pack(">Q", 1_700_000_000_000_000)
    return (time + b"\xfd\xff\x01" + bytes(9)) * 500_000


def _pd0() -> bytes:
    one = b"\x7f\x7f" + struct.pack("<HBBH", 65_000, 0, 1, 8) + b"\0\0"
    return one * 400_000 + bytes(65_000)


def _ad2cp() -> bytes:
    head = b"\xa5\x0a\x16\x10\xff\xff\x00\x00"
    return (head + struct.pack("<H", nortek_sum(head))) * 1_000_000


ATTACKS: dict[str, Attack] = {
    # other claims of messages are refused by the budget, which the tests of decoders try
    "ROS 1: array of 2^31 empty messages": _ros(
        False, lambda: b"E[] many\n" + _TYPE + b"E\n", struct.pack("<I", 2**31)
    ),
    "ROS 2: array of 30 million messages": _ros(
        True,
        lambda: b"E[] many\n" + _TYPE + b"E\nbool flag\n",
        struct.pack("<I", 3 * 10**7) + bytes(3 * 10**7),
    ),
    "ROS 2: a type that contains itself": _ros(True, lambda: b"p/A a\n", bytes(100)),
    "schema: 50 MB": _ros(True, lambda: b"float64 abc\n" * 4_200_000, b""),
    "schema: 300 of 1 MB": _many_schemas,
    "JSON: 30 million lists": _json(lambda: b'{"a":[' + b"[]," * 30_000_000 + b"[]]}"),
    "JSON: 100,000 nested lists": _json(
        lambda: b'{"a":NaN,"b":' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    ),
    "JSON: a text without end": _json(lambda: b'{"a":NaN' + b'"\\' * 100_000),
    "protobuf: 10 million empty messages": _proto,
    "protobuf: 30 sets of 800 lists of 800 fields": _protobuf_sets,
    "chunk: 250 MB of zeros": _chunk,
    "TOML: nested 5,000 deep": _toml(lambda: b"a=" + b"[" * 5000 + b"]" * 5000),
    "TOML: key of 5,000 parts": _toml(lambda: b".".join([b"a"] * 5000) + b"=1"),
    "TOML: integer of 5,000 digits": _toml(lambda: b"[output]\nthreads=" + b"9" * 5000),
    "TOML: 30 MB": _toml(lambda: b"[output]\n" + b"# comment\n" * 3_000_000),
    "NetCDF ensemble: grid of 10^10 cells": _netcdf(_grid, "--ensemble"),
    "NetCDF ensemble: velocities are texts": _netcdf(_objects, "--ensemble"),
    "Zarr ensemble: 17 GB that were never written": _zarr,
    "NetCDF glider: 2 billion samples": _netcdf(_glider_grid),
    "MAVLink: 500,000 frames cut short": info_of("log.tlog", _tlog),
    "PD0: 400,000 headers of 65 kB": info_of("log.pd0", _pd0),
    "AD2CP: a million headers of 65 kB": info_of("log.ad2cp", _ad2cp),
    **BOMBS,
}
