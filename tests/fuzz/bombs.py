"""Inputs that are small on the disk and large when they are read: compressed, never written, nested, or made anew by their reader."""

import gzip
import sqlite3
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np

from tests.places import SAMPLES
from tests.planners.flow_samples import eddying_flow

_AREA = b'{"type":"Polygon","coordinates":'
_DRIFTERS = b"time,latitude,longitude,drogue_lost_date\nUTC,degrees_north,degrees_east,UTC\n"
#: Makes the input in a folder and returns the arguments of the command.
Attack = Callable[[Path], list[str]]


def info_of(name: str, data: Callable[[], bytes]) -> Attack:
    """Return the command that reads a log of some bytes, which are made only for it."""

    def attack(folder: Path) -> list[str]:
        (folder / name).write_bytes(data())
        return ["info", str(folder / name)]

    return attack


def _gzip(block: bytes, size: int) -> Attack:
    """Return a compressed file of a SeaExplorer that repeats a text up to a size [bytes]."""
    head = b"PLD_REALTIMECLOCK;NAV_LONGITUDE;NAV_LATITUDE;NAV_DEPTH\n"
    many = block * (10_000_000 // len(block))
    packed = gzip.compress
    return info_of(
        "sea012.1.pld1.sub.1.gz", lambda: packed(head) + packed(many) * (size // len(many))
    )


def _of_zeros(file: h5py.File, name: str, shape: Sequence[int], part: Sequence[int]) -> None:
    """Add an array of zeros that are all written, and take a thousandth of their room."""
    data = file.create_dataset(name, shape, "f4", chunks=tuple(part), compression="gzip")
    packed = zlib.compress(bytes(4 * int(np.prod(part))))
    for at in np.ndindex(*(-(-size // step) for size, step in zip(shape, part, strict=True))):
        data.id.write_direct_chunk(tuple(np.multiply(at, part).tolist()), packed)


def _glider(folder: Path) -> list[str]:
    with h5py.File(folder / "p0170001.nc", "w") as file:
        file.attrs["platform"] = "Seaglider"
        for name in ("time", "depth", "latitude", "longitude", "ctd_depth", "log_gps_time"):
            _of_zeros(file, name, (200_000_000,), (5_000_000,))
    return ["info", str(folder / "p0170001.nc")]


def replay_of(folder: Path, *options: str) -> list[str]:
    """Return a replay of a sample, with its own forecast unless another is among the options."""
    own = () if "--ensemble" in options else ("--ensemble", str(SAMPLES / "ensemble.nc"))
    survey = str(SAMPLES / "survey.mcap")
    return ["replay", survey, *own, *options, "-o", str(folder / "out.mcap")]


def _plan(folder: Path, *options: str) -> list[str]:
    eddying_flow(12).save(folder / "flow.nc")
    return [
        *("plan", str(folder / "flow.nc"), "--start=152.42,-40.0,0", "--goal=152.52,-39.96,0"),
        *("--depth=390", *options),
    ]


def _areas(name: str, data: Callable[[], bytes]) -> Attack:
    def attack(folder: Path) -> list[str]:
        (folder / name).write_bytes(data())
        return _plan(folder, "--no-go", str(folder / name))

    return attack


def _package(select: str) -> Attack:
    def attack(folder: Path) -> list[str]:
        with sqlite3.connect(folder / "areas.gpkg") as file:
            file.execute("CREATE TABLE gpkg_geometry_columns (table_name, column_name, srs_id)")
            file.execute("INSERT INTO gpkg_geometry_columns VALUES ('areas', 'geom', 4326)")
            file.execute(f"CREATE VIEW areas AS {select}")
        return _plan(folder, "--no-go", str(folder / "areas.gpkg"))

    return attack


_POINT = "47500001" + "0" * 8 + "0101000000" + "0" * 32
_WITHOUT_END = "WITH RECURSIVE a(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM a) SELECT"


def _unwritten(name: str, head: bytes, command: Callable[[Path], list[str]]) -> Attack:
    """Return a file of 20 GB of which only the first bytes were written."""

    def attack(folder: Path) -> list[str]:
        words = command(folder)
        with (folder / name).open("wb") as file:
            file.write(head)
            file.truncate(20_000_000_000)
        return words

    return attack


def _following(folder: Path) -> list[str]:
    return replay_of(folder, "--follow", "--until-idle=0", "--goal-file", str(folder / "goal"))


def _config(text: Callable[[], bytes]) -> Attack:
    def attack(folder: Path) -> list[str]:
        (folder / "fleet.toml").write_bytes(text())
        return ["fleet", str(folder / "fleet.toml"), "-o", str(folder / "out")]

    return attack


BOMBS: dict[str, Attack] = {
    "gzip: 2 GB of empty lines": _gzip(b"\n", 2_000_000_000),
    "gzip: 2 GB of one line": _gzip(b"1", 2_000_000_000),
    "gzip: 400 MB of rows": _gzip(b"01/01/2020 00:00:00;1;2;3\n", 400_000_000),
    "drifters: a long value": info_of(
        "drifters.csv", lambda: _DRIFTERS + b"1,,,\n" * 50_000 + b"1" * 100_000 + b",,,\n"
    ),
    "radials: 60 MB of empty lines": info_of(
        "radials.ruv", lambda: b"%CTF: 1.00\n" + b"\n" * 60_000_000
    ),
    "NetCDF glider: 5 GB of zeros": _glider,
    "areas: 100,000 nested lists": _areas(
        "areas.json", lambda: _AREA + b"[" * 100_000 + b"]" * 100_000 + b"}"
    ),
    "areas: 30 million lists": _areas("areas.json", lambda: _AREA + b"[" + b"[]," * 30_000_000),
    "areas: 5 million numbers": _areas("areas.json", lambda: _AREA + b"[" + b"1.5," * 4_000_000),
    "areas: 4 million tags of KML": _areas(
        "areas.kml", lambda: b"<kml>" + b"<a/>" * 4_000_000 + b"</kml>"
    ),
    "areas: KML of 900,000 nested tags": _areas(
        "areas.kml", lambda: b"<kml>" + b"<a>" * 450_000 + b"</a>" * 450_000 + b"</kml>"
    ),
    "areas: entities of KML": _areas(
        "areas.kml", lambda: b'<!DOCTYPE kml [<!ENTITY a "aaaaaaaaaa">]><kml>&a;</kml>'
    ),
    "areas: rows without end": _package(f"{_WITHOUT_END} n, x'{_POINT}' AS geom FROM a"),
    "areas: a search without end": _package(f"{_WITHOUT_END} n, x'00' AS geom FROM a WHERE n < 0"),
    "areas: a value of 900 MB": _package("SELECT zeroblob(900000000) AS geom"),
    "areas: 20 GB": _unwritten(
        "areas.json", _AREA, lambda folder: _plan(folder, "--no-go", str(folder / "areas.json"))
    ),
    "estimate: 20 GB": _unwritten("flow.nc", b"\x89HDF\r\n\x1a\n", _plan),
    "goal file: 20 GB": _unwritten("goal", b"#", _following),
    "fleet: nested 100,000 deep": _config(lambda: b"a=" + b"[" * 100_000 + b"]" * 100_000),
    "fleet: 12,000 missions": _config(lambda: b"[[mission]]\nname='a'\n" * 12_000),
}
