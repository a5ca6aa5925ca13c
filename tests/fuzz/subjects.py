"""Small sound logs of every format, and what must come of each when it is damaged at random.

Every piece of a log that a checksum covers, and that is whole in the damaged file, must come; nothing may come that no checksum of the
damaged file covers, save where the report counts it as unchecked; a loss is told. The oracles walk the files by the formats' own rules.
"""

import json
import os
import signal
import struct
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from mcap.opcode import Opcode
from mcap.writer import CompressionType
from scipy.io import netcdf_file

from replay_kit.config.run import ForecastConfig, load_config
from replay_kit.core.errors import LogError, ReplayKitError
from replay_kit.forecast import read_ensemble
from replay_kit.logs import open_log
from replay_kit.workflows.planning.areas import read_areas
from replay_kit.workflows.planning.bathymetry import read_bathymetry
from tests.fuzz import damage
from tests.fuzz.mishap import Mishap, mishap
from tests.logs.adcp import ad2cp_samples, raw_adcp_samples
from tests.logs.log_samples import json_mcap, record_offsets
from tests.logs.slocum import slocum_samples
from tests.logs.sound import SOUND
from tests.places import SAMPLES

#: More seconds than this for a log of some kilobytes are a hang.
_MOST_S = 10.0
#: Says what is wrong with what was made of a damaged file.
Check = Callable[[Mishap, Path], list[str]]
#: Start, end, and what the piece says.
Piece = tuple[int, int, Any]


@dataclass(frozen=True)
class Subject:
    """A sound log, or another input.

    Attributes:
        name: For a person; of a log its format comes first.
        data: The file.
        check: Says what is wrong with what was made of a damaged one.
    """

    name: str
    data: bytes
    check: Check

    @property
    def format(self) -> str:
        """The name of its format."""
        return self.name.split()[0]


def sweep(
    count: int, seed: int, folder: Path, names: Sequence[str] = ()
) -> Iterator[tuple[str, list[str]]]:
    """Yield name and what is wrong for each of many random damages; the subjects take turns.

    Args:
        count: How many damages.
        seed: Of the random numbers.
        folder: Where the damaged files are written.
        names: Of their formats; all when empty.
    """
    chosen = [subject for subject in subjects(folder) if not names or subject.format in names]
    for number in range(count):
        subject = chosen[number % len(chosen)]
        yield subject.name, damaged(subject, number // len(chosen), seed, folder)


def damaged(subject: Subject, number: int, seed: int, folder: Path) -> list[str]:
    """Return what is wrong with what is made of a damaged file, which is written to a folder."""
    harm, path = mishap(subject.data, number, seed), folder / "damaged"
    path.write_bytes(harm.data)
    # processor time, which other work on the machine does not lengthen
    begin = time.process_time()
    try:
        wrong = subject.check(harm, path)
    # every exception but ours is a finding
    except Exception as error:
        wrong = [f"{type(error).__name__}: {error}"]
    if (seconds := time.process_time() - begin) > _MOST_S:
        wrong.append(f"took {seconds:.0f} s")
    return [f"{subject.name} {number}: {harm.what}: {words}" for words in wrong]


def of_file(path: Path) -> Subject:
    """Return a sound MCAP, telemetry or DataFlash log."""
    data = path.read_bytes()
    if path.suffix == ".BIN":
        return Subject(str(path), data, _dataflash(path))
    return Subject(str(path), data, {".mcap": _mcap, ".tlog": _telemetry}[path.suffix](data))


def subjects(folder: Path) -> list[Subject]:
    """Return a sound log of every format and of its variants; NetCDF files are made in a folder."""
    times = range(1000, 1000 + 60 * 10**7, 10**7)
    mcaps = {
        "mcap": json_mcap(times),
        "mcap zstd": json_mcap(times, CompressionType.ZSTD),
        "mcap lz4": json_mcap(times, CompressionType.LZ4),
        "mcap one chunk": json_mcap(times, chunk_size=1 << 20),
        "mcap unchunked": json_mcap(times, use_chunking=False, data_crcs=True),
    }
    mcaps |= {
        f"{name} without end": mcaps[name][: record_offsets(mcaps[name], Opcode.DATA_END)[0]]
        for name in ("mcap", "mcap zstd", "mcap unchunked")
    }
    classic, dataflash = _classic(folder / "classic"), folder / "sound.BIN"
    files = {name: make(folder) for name, make in SOUND.items() if name != "mcap"}
    dataflash.write_bytes(files["dataflash"])
    checks = {
        "tlog": _telemetry,
        "dataflash": lambda _: _dataflash(dataflash),
        "pd0": lambda data: _covered(ensembles(data), ensembles, _pings_of),
        "ad2cp": lambda data: _covered(bursts(data), bursts, _pings_of, 1),
        "netcdf": lambda _: _apart(_uncovered),
    }
    packed = slocum_samples.compressed(files["slocum"])
    return [
        *(Subject(name, data, _mcap(data)) for name, data in mcaps.items()),
        *(
            Subject(name, data, checks.get(name, lambda _: _uncovered)(data))
            for name, data in files.items()
        ),
        Subject("slocum compressed", packed, _uncovered),
        Subject("netcdf 3", classic.read_bytes(), _uncovered),
        *_inputs(folder),
    ]


def _mcap(data: bytes) -> Check:
    # the oracle wants an end
    ended = (
        data if data.endswith(b"MCAP0\r\n") else data + struct.pack("<BQI", Opcode.DATA_END, 4, 0)
    )
    sound = damage.sound_messages(ended)
    every, covered = (
        Counter(message.said[1:] for message in sound),
        any(message.checked for message in sound),
    )

    def check(harm: Mishap, path: Path) -> list[str]:
        try:
            said, report = damage.read_raw(path)
        except LogError:
            return (
                ["refused although the magic bytes are there"] if harm.data[:8] == data[:8] else []
            )
        # of a channel whose record is lost the topic is not known
        came = Counter(message[1:] for message in said)
        whole = Counter(
            message.said[1:] for message in sound if harm.keeps(message.start, message.unit_end)
        )
        lost, new = (
            every - came,
            sum(count for message, count in came.items() if message not in every),
        )
        unchecked, told, wrong = (
            sum(report.unchecked.values()),
            bool(report.losses or report.undecodable),
            [],
        )
        if covered and (missing := whole - came):
            wrong.append(f"{missing.total()} messages that are whole under a checksum did not come")
        if new > unchecked:
            wrong.append(f"{new} messages came wrong, {unchecked} are said to be unchecked")
        if lost.total() > (0 if told else unchecked) and not told:
            wrong.append(f"{lost.total()} messages went without a word")
        if (
            told
            and not new
            and not report.undecodable
            and all(loss.messages is not None for loss in report.losses)
        ):
            stated = sum(loss.messages or 0 for loss in report.losses)
            wrong += (
                [f"{stated} messages are said to be lost, {lost.total()} are"]
                if stated != lost.total()
                else []
            )
        return wrong

    return check


def _covered(
    sound: Sequence[Piece],
    walk: Callable[[bytes], list[Piece]],
    read: Callable[[Path], tuple[list[Any], bool]],
    needed: int = 0,
) -> Check:
    """Return the check of a format whose pieces have checksums.

    Args:
        sound: Pieces of the sound file.
        walk: Finds those of any file.
        read: What our reader makes of a file, and whether it tells of a loss.
        needed: Number of pieces at the beginning without which the file may be refused; they say nothing themselves.
    """

    def check(harm: Mishap, path: Path) -> list[str]:
        found = walk(harm.data)
        here = [what for _, _, what in found]
        try:
            said, told = read(path)
        except LogError:
            kept = all(harm.keeps(start, end) for start, end, _ in sound[:needed])
            return (
                ["refused although a whole piece is in it"]
                if kept and any(what is not None for what in here[needed:])
                else []
            )
        said_of = Counter(map(repr, said))
        whole = Counter(
            repr(what) for start, end, what in sound if what is not None and harm.keeps(start, end)
        )
        wrong = (
            [f"{(whole - said_of).total()} whole pieces did not come"] if whole - said_of else []
        )
        if foreign := said_of.keys() - {repr(what) for what in here}:
            wrong.append(
                f"{len(foreign)} pieces came that no checksum covers: {next(iter(foreign))[:80]}"
            )
        every = Counter(repr(what) for _, _, what in sound if what is not None)
        # bytes that make whole pieces again, one after another but for stamps of 8 bytes, leave no trace
        taken = sum(end - start for start, end, _ in found)
        traceless = len(harm.data) - taken <= 8 * len(found)
        if every - said_of and not told and not traceless:
            wrong.append(f"{(every - said_of).total()} pieces went without a word")
        return wrong

    return check


def _telemetry(data: bytes) -> Check:
    return _covered(damage.frames(data), damage.frames, _frames_of)


def _dataflash(file: Path) -> Check:
    """Return the check of a log without checksums whose records are known: those before the damage come first."""
    ends = [end for _, end, _ in damage.records(file.read_bytes())]
    sound, _ = damage.read_dataflash(file)

    def check(harm: Mishap, path: Path) -> list[str]:
        kept = harm.kept[0][1] if harm.kept and harm.kept[0][0] == 0 else 0
        if not (whole := sum(end <= kept for end in ends)):
            return _uncovered(harm, path)
        said, report = damage.read_dataflash(path)
        wrong = [] if said[:whole] == sound[:whole] else [f"{whole} are whole before it"]
        if len(harm.kept) == 1 and len(harm.data) not in ends and not report.losses:
            wrong.append("cut without a word")
        return wrong + _uncovered(harm, path)

    return check


def _uncovered(harm: Mishap, path: Path) -> list[str]:
    """Return what is wrong with a log without checksums: it is read to its end or refused, and says that nothing covers it."""
    del harm
    try:
        log = open_log(path)
        read = sum(1 for _ in log.messages())
        return (
            ["it does not say that no checksum covers it"]
            if read and not log.report().unchecked
            else []
        )
    except LogError:
        return []


def _apart(check: Check) -> Check:
    """Return a check of what is read by a library in C, which may hang or crash: in a process of its own."""

    def checked(harm: Mishap, path: Path) -> list[str]:
        if (child := os.fork()) == 0:
            signal.alarm(int(_MOST_S))
            # whatever is raised, the child must not go on as if it were its parent
            try:
                wrong = bool(check(harm, path))
            except BaseException:
                traceback.print_exc()
                wrong = True
            os._exit(wrong)
        _, status = os.waitpid(child, 0)
        if os.WIFSIGNALED(status):
            return [f"ended by {signal.Signals(os.WTERMSIG(status)).name}"]
        return (
            ["it does not say that no checksum covers it, or another exception than ours"]
            if os.WEXITSTATUS(status)
            else []
        )

    return checked


def _inputs(folder: Path) -> list[Subject]:
    """Return the inputs beside logs, which have no checksums: they are read, or refused by an error of ours that names them."""
    ensemble = read_ensemble(SAMPLES / "ensemble.nc", ForecastConfig())
    grid = ensemble.grid
    store, bottom = folder / "store.zarr", folder / "bottom.nc"
    with xr.open_dataset(SAMPLES / "ensemble.nc", engine="scipy") as dataset:
        dataset.to_zarr(store, mode="w", zarr_format=2, consolidated=False)
    corners = [[152.1, -40.2], [152.2, -40.2], [152.2, -40.1], [152.1, -40.2]]
    area = {"type": "Polygon", "coordinates": [corners]}
    text = " ".join(f"{x},{y},0" for x, y in corners)
    kml = (
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><name>a</name><Polygon><outerBoundaryIs><LinearRing>'
        f"<coordinates>{text}</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark></kml>"
    )
    depth = np.full((9, 9), 400.0)
    axes = {
        name: np.linspace(float(values.min()) - 0.1, float(values.max()) + 0.1, 9)
        for name, values in (("lat", grid.latitude), ("lon", grid.longitude))
    }
    xr.Dataset({"depth": (("lat", "lon"), depth, {"units": "m"})}, axes).to_netcdf(
        bottom, engine="h5netcdf"
    )
    toml = (
        b'[forecast]\nlevels = [5.0, 150.0]\n[estimator]\nmodes = 20\n[planner]\nkind = "mission"\n'
    )
    chunk = next(
        path for path in sorted(store.rglob("*")) if path.is_file() and path.name[0] != "."
    )

    def of_store(place: Path) -> Check:
        sound = place.read_bytes()

        def check(harm: Mishap, path: Path) -> list[str]:
            place.write_bytes(harm.data)
            try:
                return _refused_or_read(lambda _: read_ensemble(store, ForecastConfig()))(
                    harm, path
                )
            finally:
                place.write_bytes(sound)

        return check

    return [
        Subject(
            "areas geojson", json.dumps(area).encode(), _refused_or_read(read_areas, ".geojson")
        ),
        Subject("areas kml", kml.encode(), _refused_or_read(read_areas, ".kml")),
        Subject("toml", toml, _refused_or_read(load_config, ".toml")),
        Subject(
            "bathymetry",
            bottom.read_bytes(),
            _apart(_refused_or_read(lambda path: read_bathymetry(path, grid), ".nc")),
        ),
        *(
            Subject(f"zarr {name}", place.read_bytes(), _apart(of_store(place)))
            for name, place in (
                ("metadata", next(store.rglob("u*/.zarray"))),
                ("attributes", next(store.rglob("u*/.zattrs"))),
                ("chunk", chunk),
            )
        ),
    ]


def _refused_or_read(read: Callable[[Path], object], suffix: str = "") -> Check:
    """Return the check of an input without checksums: any exception but ours, and one of ours that does not name it, is wrong."""

    def check(harm: Mishap, path: Path) -> list[str]:
        named = path.with_name(f"damaged{suffix}")
        named.write_bytes(harm.data)
        try:
            read(named)
        except ReplayKitError as error:
            fine = error.exit_code in (2, 3) and (not suffix or named.name in str(error))
            return [] if fine else [f"refused by {error}"]
        return []

    return check


def _frames_of(path: Path) -> tuple[list[bytes], bool]:
    said, report = damage.read_frames(path)
    return said, bool(report.losses or report.undecodable)


def _pings_of(path: Path) -> tuple[list[Any], bool]:
    log = open_log(path)
    said = [
        _in_mm(message.payload["velocity"])
        for message in log.messages()
        if message.topic == "/adcp"
    ]
    return said, bool(log.report().losses or log.report().undecodable)


def _in_mm(cells: Iterable[Iterable[float | None]]) -> list[list[int | None]]:
    return [[None if value is None else round(1000 * value) for value in cell] for cell in cells]


def ensembles(data: bytes) -> list[Piece]:
    """Return the PD0 ensembles of any bytes: start, end, and velocities [mm/s]."""
    found, at = [], 0
    while (at := data.find(b"\x7f\x7f", at)) >= 0:
        size = int.from_bytes(data[at + 2 : at + 4], "little")
        body, check = data[at : at + size], data[at + size : at + size + 2]
        if size > 8 and len(check) == 2 and sum(body) & 0xFFFF == int.from_bytes(check, "little"):
            offsets = struct.unpack_from(f"<{body[5]}H", body, 6)
            blocks = {body[place : place + 2]: place for place in offsets}
            cells = body[blocks[b"\x00\x00"] + 9]
            values = np.frombuffer(body, "<i2", 4 * cells, blocks[b"\x00\x01"] + 2).reshape(
                cells, 4
            )
            found.append((at, at + size + 2, _none_if_missing(values)))
            at += size + 2
        else:
            at += 1
    return found


def bursts(data: bytes) -> list[Piece]:
    """Return the AD2CP records of any bytes: start, end, and a burst's velocities in beam coordinates [mm/s]; None of other records."""
    found, at = [], 0
    while (at := data.find(b"\xa5\x0a", at)) >= 0:
        head = data[at : at + 10]
        at += 1
        if len(head) < 10:
            break
        size, check, head_check = struct.unpack_from("<HHH", head, 4)
        body = data[at + 9 : at + 9 + size]
        if (
            raw_adcp_samples.nortek_sum(head[:8]) == head_check
            and len(body) == size
            and raw_adcp_samples.nortek_sum(body) == check
        ):
            what = None
            if head[2] == ad2cp_samples.BURST:
                cells = struct.unpack_from("<H", body, 30)[0] & 1023
                what = _none_if_missing(
                    np.frombuffer(body, "<i2", 4 * cells, 76).reshape(4, cells).T
                )
            found.append((at - 1, at + 9 + size, what))
            at += 9 + size
    return found


def _none_if_missing(values: np.ndarray) -> list[list[int | None]]:
    return [[None if value == -32768 else int(value) for value in row] for row in values.tolist()]


def _classic(path: Path) -> Path:
    """Return a NetCDF-3 file with a row for each second."""
    with netcdf_file(path, "w") as file:
        file.createDimension("time", 50)
        for name, values, units in (
            ("time", np.arange(50.0), "seconds since 2020-01-01"),
            ("speed", np.linspace(0.0, 1.0, 50), "m s-1"),
        ):
            variable = file.createVariable(name, "d", ("time",))
            variable[:] = values
            variable.units = units
    return path
