"""Inputs that are small on the disk and large when they are read: compressed, never written, nested, or made anew by their reader."""

import gzip
import zlib
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import h5py
import numcodecs
import numpy as np
import xarray as xr

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


@cache
def _packed(size: int, known: bytes) -> bytes:
    """Return compressed bytes that repeat some known ones up to a size."""
    packer, block = zlib.compressobj(), known * (1_000_000 // len(known))
    whole, rest = divmod(size, len(block))
    parts = [packer.compress(block) for _ in range(whole)]
    return b"".join([*parts, packer.compress(block[:rest]), packer.flush()])


def _of_zeros(
    file: h5py.File,
    name: str,
    shape: Sequence[int],
    part: Sequence[int],
    chunk: int = 0,
    known: bytes = b"\0" * 4,
) -> None:
    """Add an array that repeats known bytes, all written, in a thousandth of their room; its chunks may unpack to more bytes."""
    data = file.create_dataset(name, shape, "f4", chunks=tuple(part), compression="gzip")
    packed = _packed(chunk or 4 * int(np.prod(part)), known)
    for at in np.ndindex(*(-(-size // step) for size, step in zip(shape, part, strict=True))):
        data.id.write_direct_chunk(tuple(np.multiply(at, part).tolist()), packed)


def _columns(
    names: str,
    sizes: Sequence[int],
    part: Sequence[int],
    chunk: int = 0,
    axis: int = 0,
    since: str = "seconds since 2020-01-01",
) -> Attack:
    """Return the reading of a log of zeros under some names, whose chunks may unpack to more bytes; ``axis`` is a grid's own size."""

    def attack(folder: Path) -> list[str]:
        with h5py.File(folder / "p0170001.nc", "w") as file:
            if "ctd" in names:
                file.attrs["platform"] = "Seaglider"
            for name in names.split():
                if axis and name in ("lat", "lon"):
                    file[name] = np.arange(float(axis))
                else:
                    _of_zeros(file, name, sizes, part, chunk)
                if "time" in name:
                    file[name].attrs["units"] = since
        return ["info", "--full", str(folder / "p0170001.nc")]

    return attack


# Bytes to which a chunk of a few values unpacks.
_ENDLESS = 2_000_000_000
GLIDER = "time depth latitude longitude ctd_depth log_gps_time"
_RADAR = "time lat lon u v u_err v_err"
_AXES = {"lat": (-41.0, -39.0), "lon": (151.0, 154.0), "depth": (0.0, 500.0)}


def field(
    sizes: dict[str, int], known: bytes | None = b"\0" * 4, chunk: int = 0, kind: object = "f4"
) -> Callable[[Path], Path]:
    """Return what writes fields of some sizes by dimension, each horizontal one a chunk of known bytes.

    Args:
        sizes: By dimension; without members and times depths of a bottom.
        known: Bytes that are repeated; None for values that are never written.
        chunk: What one unpacks to [bytes]; 0 for its size.
        kind: Type of values that are never written.
    """
    names = ("u", "v") if len(sizes) > 2 else ("elevation",)

    def make(folder: Path) -> Path:
        shape = tuple(sizes.values())
        part = (1,) * (len(shape) - 2) + tuple(min(size, 4000) for size in shape[-2:])
        with h5py.File(folder / "field.nc", "w") as file:
            for dim, size in sizes.items():
                least, most = _AXES.get(dim, (0.0, size - 1.0))
                file.create_dataset(dim, data=np.linspace(least, most, size)).make_scale(dim)
            if "time" in sizes:
                file["time"].attrs["units"] = "hours since 2020-01-01"
            for name in names:
                if known is None:
                    file.create_dataset(name, shape, kind, chunks=part)
                else:
                    _of_zeros(file, name, shape, part, chunk, known)
                file[name].attrs["units"] = "m s-1" if len(names) > 1 else "m"
                for axis, dim in zip(file[name].dims, sizes, strict=True):
                    axis.attach_scale(file[dim])
        return folder / "field.nc"

    return make


def _store(folder: Path) -> Path:
    """Write a Zarr store of a few values whose chunks unpack to 2 GB."""
    small = field({"member": 3, "depth": 2, "lat": 8, "lon": 8})(folder)
    with xr.open_dataset(small, engine="h5netcdf", phony_dims="access") as data:
        own = {"compressors": (numcodecs.Zlib(),), "chunks": (1, 1, 8, 8)}
        data.drop_encoding().to_zarr(
            folder / "e.zarr", zarr_format=2, encoding={"u": own, "v": own}
        )
    bomb = _packed(_ENDLESS, bytes(4))
    for chunk in (folder / "e.zarr").glob("[uv]/*.*.*"):
        chunk.write_bytes(bomb)
    return folder / "e.zarr"


def _replayed(make: Callable[[Path], Path]) -> Attack:
    return lambda folder: replay_of(folder, "--ensemble", str(make(folder)))


def _bottom(make: Callable[[Path], Path]) -> Attack:
    return lambda folder: _plan(folder, "--bathymetry", str(make(folder)))


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
    "gzip: 2 GB of one line": _gzip(b"1", 2_000_000_000),
    "gzip: 400 MB of rows": _gzip(b"01/01/2020 00:00:00;1;2;3\n", 400_000_000),
    "drifters: a long value": info_of(
        "drifters.csv", lambda: _DRIFTERS + b"1,,,\n" * 50_000 + b"1" * 100_000 + b",,,\n"
    ),
    "drifters: 60 MB of commas": info_of("drifters.csv", lambda: _DRIFTERS + b"," * 60_000_000),
    "drifters: a quotation without end": info_of(
        "drifters.csv", lambda: _DRIFTERS + b'"' + b"1,,,\n" * 10_000_000
    ),
    "radials: 60 MB of one line": info_of(
        "radials.ruv", lambda: b"%CTF: 1.00\n" + b"1 " * 30_000_000
    ),
    "NetCDF glider: 5 GB of zeros": _columns(GLIDER, (200_000_000,), (5_000_000,)),
    "NetCDF glider: a chunk of 2 GB": _columns(GLIDER, (1000,), (1000,), _ENDLESS),
    "radar: axes of a million points": _columns(_RADAR, (2, 10, 10), (1, 10, 10), axis=1_000_000),
    "NetCDF glider: times since the year 10^9": _columns(
        GLIDER, (1000,), (1000,), since="seconds since 1000000000-01-01"
    ),
    "NetCDF glider: a unit of time of 50 kB": _columns(
        GLIDER, (1000,), (1000,), since="seconds since " + "2020-" * 10_000
    ),
    "forecast: 6 GB of zeros, members": _replayed(
        field({"member": 400, "depth": 1, "lat": 1000, "lon": 1000})
    ),
    "forecast: 6 GB of zeros, times": _replayed(
        field({"time": 400, "member": 2, "depth": 1, "lat": 700, "lon": 700})
    ),
    "forecast: a chunk of 2 GB": _replayed(
        field({"member": 3, "depth": 2, "lat": 8, "lon": 8}, chunk=_ENDLESS)
    ),
    "forecast: chunks of 2 GB in Zarr": _replayed(_store),
    "bathymetry: a chunk of 2 GB": _bottom(field({"lat": 20, "lon": 20}, chunk=_ENDLESS)),
    "areas: 100,000 nested lists": _areas(
        "areas.json", lambda: _AREA + b"[" * 100_000 + b"]" * 100_000 + b"}"
    ),
    "areas: 30 million lists": _areas("areas.json", lambda: _AREA + b"[" + b"[]," * 30_000_000),
    "areas: KML of 900,000 nested tags": _areas(
        "areas.kml", lambda: b"<kml>" + b"<a>" * 450_000 + b"</a>" * 450_000 + b"</kml>"
    ),
    "areas: entities of KML": _areas(
        "areas.kml", lambda: b'<!DOCTYPE kml [<!ENTITY a "aaaaaaaaaa">]><kml>&a;</kml>'
    ),
    "areas: 20 GB": _unwritten(
        "areas.json", _AREA, lambda folder: _plan(folder, "--no-go", str(folder / "areas.json"))
    ),
    "estimate: 20 GB": _unwritten("flow.nc", b"\x89HDF\r\n\x1a\n", _plan),
    "goal file: 20 GB": _unwritten("goal", b"#", _following),
    "fleet: nested 100,000 deep": _config(lambda: b"a=" + b"[" * 100_000 + b"]" * 100_000),
    "fleet: 12,000 missions": _config(lambda: b"[[mission]]\nname='a'\n" * 12_000),
}
