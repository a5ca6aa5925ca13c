"""Inputs made to take time or memory: a few bytes that claim much, or many bytes that mean nothing."""

import struct
from collections.abc import Callable
from pathlib import Path

import h5py
from mcap.writer import CompressionType, Writer

from tests.forecast.forms import unwritten_stores
from tests.fuzz.bombs import BOMBS, GLIDER, Attack, field, info_of, replay_of
from tests.reference.adcp_records import nortek_sum

#: Makes the bytes: each only for its own attack, as many are tens of megabytes.
Text = Callable[[], bytes]


def _chunk(folder: Path) -> list[str]:
    with (folder / "log.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        writer.add_message(writer.register_channel("/t", "none", 0), 10**18, bytes(250_000_000), 0)
        writer.finish()
    return ["info", "--full", str(folder / "log.mcap")]


def _toml(text: Text) -> Attack:
    def attack(folder: Path) -> list[str]:
        (folder / "run.toml").write_bytes(text())
        return replay_of(folder, "--config", str(folder / "run.toml"), "--dry-run")

    return attack


def _ensemble(side: int, kind: object) -> Attack:
    """Return the description of an ensemble whose velocities take no room in the file."""
    make = field({"member": 4, "depth": 2, "lat": side, "lon": side}, None, kind=kind)
    return lambda folder: ["info", "--ensemble", str(make(folder))]


def _zarr(folder: Path) -> list[str]:
    return ["info", "--ensemble", *map(str, unwritten_stores(folder, (80, 3059, 4322)))]


def _glider(folder: Path) -> list[str]:
    with h5py.File(folder / "file.nc", "w") as file:
        file.attrs["platform"] = "Seaglider"
        for name in f"{GLIDER} eng_depth log_gps_lat log_gps_lon".split():
            file.create_dataset(name, shape=(2_000_000_000,), dtype="f8", chunks=(100_000,))
    return ["info", str(folder / "file.nc")]


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
    # claims of messages and schemas are refused by the budget, which the tests of decoders try
    "chunk: 250 MB of zeros": _chunk,
    "TOML: nested 5,000 deep": _toml(lambda: b"a=" + b"[" * 5000 + b"]" * 5000),
    "TOML: key of 5,000 parts": _toml(lambda: b".".join([b"a"] * 5000) + b"=1"),
    "TOML: integer of 5,000 digits": _toml(lambda: b"[output]\nthreads=" + b"9" * 5000),
    "TOML: 30 MB": _toml(lambda: b"[output]\n" + b"# comment\n" * 3_000_000),
    "NetCDF ensemble: grid of 10^10 cells": _ensemble(50_000, "f4"),
    "NetCDF ensemble: velocities are texts": _ensemble(5, h5py.string_dtype()),
    "Zarr ensemble: 17 GB that were never written": _zarr,
    "NetCDF glider: 2 billion samples": _glider,
    "MAVLink: 500,000 frames cut short": info_of("log.tlog", _tlog),
    "PD0: 400,000 headers of 65 kB": info_of("log.pd0", _pd0),
    "AD2CP: a million headers of 65 kB": info_of("log.ad2cp", _ad2cp),
    **BOMBS,
}
