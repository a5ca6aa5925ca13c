"""Small sound logs of every format, and what must come of each when it is damaged at random.

Every piece of a log that a checksum covers, and that is whole in the damaged file, must come; nothing may come that no checksum of the
damaged file covers, save where the report counts it as unchecked; a loss is told. The oracles walk the files by the formats' own rules.
"""

import json
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from replay_kit.config.run import ForecastConfig, load_config
from replay_kit.core.errors import LogError, ReplayKitError
from replay_kit.core.message import LogReport
from replay_kit.forecast import read_ensemble
from replay_kit.logs import open_log
from replay_kit.workflows.planning.areas import read_areas
from replay_kit.workflows.planning.bathymetry import read_bathymetry
from tests.fuzz import damage
from tests.fuzz.mishap import Mishap, mishap
from tests.logs.adcp.raw_adcp_samples import Survey, pd0
from tests.logs.log_samples import json_mcap, record_offsets
from tests.logs.slocum import slocum_samples
from tests.logs.sound import SOUND
from tests.places import SAMPLES

#: More seconds than this for a log of some kilobytes are a hang.
_MOST_S = 10.0
#: Says what is wrong with what was made of a damaged file.
Check = Callable[[Mishap, Path], list[str]]
#: What our reader makes of a file.
Read = Callable[[Path], tuple[list, LogReport]]


@dataclass(frozen=True)
class Subject:
    """A sound log, or another input.

    Attributes:
        name: For a person; of a log its format comes first.
        data: The file.
        check: Says what is wrong with what was made of a damaged one.
        in_c: Whether a library in C reads it.
    """

    name: str
    data: bytes
    check: Check
    in_c: bool = False

    @property
    def format(self) -> str:
        """The name of its format."""
        return self.name.split()[0]


def sweep(
    count: int, seed: int, folder: Path, names: Sequence[str] = ()
) -> Iterator[tuple[str, list[str]]]:
    """Yield name and what is wrong for each of many random damages.

    Args:
        count: How many damages; each subject has its share.
        seed: Of the random numbers.
        folder: Where the damaged files are written.
        names: Of their formats; all when empty.
    """
    chosen = [subject for subject in subjects(folder) if not names or subject.format in names]
    for k, subject in enumerate(chosen):
        numbers = range(len(range(k, count, len(chosen))))
        found = map(partial(damaged, subject, seed=seed, folder=folder), numbers)
        for wrong in _apart(subject, found, folder) if subject.in_c else found:
            yield subject.name, wrong


def _apart(subject: Subject, found: Iterator[list[str]], folder: Path) -> Iterator[list[str]]:
    """Yield what is found of what a library in C reads, which may hang or crash: in a process of its own."""
    said = folder / "said"
    if (child := os.fork()) == 0:
        # whatever is raised, the child must not go on as if it were its parent
        try:
            with said.open("w") as file:
                signal.alarm(int(_MOST_S))
                for wrong in found:
                    print(" / ".join(wrong), file=file, flush=True)
                    signal.alarm(int(_MOST_S))
            os._exit(0)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    lines = said.read_text().splitlines()
    yield from ([line] if line else [] for line in lines)
    if ended := os.waitstatus_to_exitcode(status):
        yield [f"{subject.name} {len(lines)}: its process ended by {ended}"]


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
    return Subject(str(path), data, _CHECKS[path.suffix.lower().strip(".")](data, path))


def subjects(folder: Path) -> list[Subject]:
    """Return a sound log of every format and of its variants, and other inputs; some are made in a folder."""
    times = range(1000, 1000 + 60 * 10**7, 10**7)
    files = {
        "mcap zstd": json_mcap(times, CompressionType.ZSTD),
        "mcap lz4": json_mcap(times, CompressionType.LZ4),
        "mcap one chunk": json_mcap(times, chunk_size=1 << 20),
        "mcap unchunked": json_mcap(times, use_chunking=False, enable_data_crcs=True),
        **{name: make(folder) for name, make in SOUND.items()},
        "netcdf 3": _classic(folder / "classic").read_bytes(),
    }
    files |= {
        f"{name} without end": files[name][: record_offsets(files[name], Opcode.DATA_END)[0]]
        for name in ("mcap", "mcap zstd", "mcap unchunked")
    }
    files["pd0 changed"] = files["pd0"] + pd0(Survey(n=4, cells=4, cell=2.0, system="earth"))
    files["slocum compressed"] = slocum_samples.compressed(files["slocum"])
    found = []
    for name, data in files.items():
        (folder / "sound").write_bytes(data)
        make = _CHECKS.get(name.split()[0], lambda *_: _uncovered)
        check = make(data, folder / "sound")
        found.append(Subject(name, data, check, name.startswith("netcdf")))
    return found + _inputs(folder)


def _mcap(data: bytes, _: Path) -> Check:
    sound = damage.sound_messages(data)
    # of a channel whose record is lost the topic is not known
    every, covered = Counter(one.said[1:] for one in sound), any(one.checked for one in sound)
    # behind opcode and length numbers of messages, often under no checksum
    stating = (Opcode.STATISTICS, Opcode.MESSAGE_INDEX)
    counts = [(at, at + 17) for code in stating for at in record_offsets(data, code)]

    def check(harm: Mishap, path: Path) -> list[str]:
        try:
            said, report = damage.read_raw(path)
        except LogError:
            magic = harm.data[:8] == data[:8]
            return ["refused although the magic bytes are there"] if magic else []
        came = Counter(message[1:] for message in said)
        whole = Counter(one.said[1:] for one in sound if harm.keeps(one.start, one.end))
        lost, missing = (every - came).total(), (whole - came).total()
        new = sum(count for message, count in came.items() if message not in every)
        # of a chunk without a checksum any message may be wrong
        chunks = "chunks without a checksum" in report.unchecked
        unchecked = every.total() if chunks else sum(report.unchecked.values())
        wrong = list[str]()
        if covered and missing:
            wrong.append(f"{missing} messages that are whole under a checksum did not come")
        if new > unchecked:
            wrong.append(f"{new} messages came wrong, {unchecked} are said to be unchecked")
        if lost > unchecked and not (report.losses or report.undecodable):
            wrong.append(f"{lost} messages went without a word")
        stated = [loss.messages for loss in report.losses]
        known = stated and None not in stated and not new and not report.undecodable
        if covered and known and sum(stated) != lost and all(harm.keeps(*at) for at in counts):
            wrong.append(f"{sum(stated)} messages are said to be lost, {lost} are")
        return wrong

    return check


def _covered(walk: Callable[[bytes], list[damage.Piece]], read: Read, needed: int = 0) -> Callable:
    """Return what makes the check of a format whose pieces have checksums.

    Args:
        walk: Finds the pieces of any file.
        read: What our reader makes of a file.
        needed: Number of pieces at the beginning without which the file may be refused; they say nothing themselves.
    """

    def make(data: bytes, _: Path) -> Check:
        sound = walk(data)
        every = Counter(repr(what) for _, _, what in sound if what is not None)

        def check(harm: Mishap, path: Path) -> list[str]:
            found = walk(harm.data)
            here = {repr(what) for _, _, what in found}
            try:
                said, report = read(path)
            except LogError:
                kept = all(harm.keeps(start, end) for start, end, _ in sound[:needed])
                sayers = any(what is not None for _, _, what in found[needed:])
                return ["refused although a whole piece is in it"] if kept and sayers else []
            came, wrong = Counter(map(repr, said)), []
            whole = Counter(
                repr(what)
                for start, end, what in sound
                if what is not None and harm.keeps(start, end)
            )
            if missing := whole - came:
                wrong.append(f"{missing.total()} whole pieces did not come")
            if foreign := came.keys() - here:
                wrong.append(
                    f"{len(foreign)} pieces came that no checksum covers: {[*foreign][:1]}"
                )
            # bytes that make whole pieces again, one after another but for stamps of 8 bytes, leave no trace
            taken = sum(end - start for start, end, _ in found)
            traceless = len(harm.data) - taken <= 8 * len(found)
            told = report.losses or report.undecodable or traceless
            if (lost := every - came) and not told:
                wrong.append(f"{lost.total()} pieces went without a word")
            return wrong

        return check

    return make


def _dataflash(data: bytes, path: Path) -> Check:
    """Return the check of a log without checksums whose records are known: those before the damage come first."""
    ends = [end for _, end, _ in damage.records(data)]
    sound, _ = damage.read_messages(path)

    def check(harm: Mishap, path: Path) -> list[str]:
        kept = harm.kept[0][1] if harm.kept and harm.kept[0][0] == 0 else 0
        if not (whole := sum(end <= kept for end in ends)):
            return _uncovered(harm, path)
        said, report = damage.read_messages(path)
        wrong = [] if said[:whole] == sound[:whole] else [f"{whole} are whole before it"]
        if len(harm.kept) == 1 and len(harm.data) not in ends and not report.losses:
            wrong.append("cut without a word")
        return wrong + _uncovered(harm, path)

    return check


def _uncovered(_: Mishap, path: Path) -> list[str]:
    """Return what is wrong with a log without checksums: it is read to its end or refused, and says that nothing covers it."""
    try:
        log = open_log(path)
        read = sum(1 for _ in log.messages())
    except LogError:
        return []
    return ["it does not say that no checksum covers it"] * bool(
        read and not log.report().unchecked
    )


_CHECKS = {
    "mcap": _mcap,
    "tlog": _covered(damage.frames, damage.read_frames),
    "dataflash": _dataflash,
    "bin": _dataflash,
    "pd0": _covered(damage.ensembles, damage.read_pings),
    "ad2cp": _covered(damage.bursts, damage.read_pings, 1),
}


def _inputs(folder: Path) -> list[Subject]:
    """Return the inputs beside logs, which have no checksums: they are read, or refused by an error of ours that names them."""
    grid = read_ensemble(SAMPLES / "ensemble.nc", ForecastConfig()).grid
    store, bottom = folder / "store.zarr", folder / "bottom.nc"
    with xr.open_dataset(SAMPLES / "ensemble.nc", engine="scipy") as dataset:
        dataset.to_zarr(store, mode="w", zarr_format=2, consolidated=False)
    corners = [[152.1, -40.2], [152.2, -40.2], [152.2, -40.1], [152.1, -40.2]]
    area = json.dumps({"type": "Polygon", "coordinates": [corners]}).encode()
    text = " ".join(f"{x},{y},0" for x, y in corners)
    kml = (
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><name>a</name><Polygon><outerBoundaryIs><LinearRing>'
        f"<coordinates>{text}</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark></kml>"
    ).encode()
    axes = {
        name: np.linspace(float(values.min()) - 0.1, float(values.max()) + 0.1, 9)
        for name, values in (("lat", grid.latitude), ("lon", grid.longitude))
    }
    depth = (("lat", "lon"), np.full((9, 9), 400.0), {"units": "m"})
    xr.Dataset({"depth": depth}, axes).to_netcdf(bottom, engine="h5netcdf")
    toml = (
        b'[forecast]\nlevels = [5.0, 150.0]\n[estimator]\nmodes = 20\n[planner]\nkind = "mission"\n'
    )
    parts = {
        "metadata": next(store.rglob("u*/.zarray")),
        "attributes": next(store.rglob("u*/.zattrs")),
        "chunk": next(path for path in sorted(store.rglob("[0-9]*")) if path.is_file()),
    }
    read_bottom = _refused_or_read(lambda path: read_bathymetry(path, grid), "damaged.nc")
    return [
        Subject("areas geojson", area, _refused_or_read(read_areas, "damaged.geojson")),
        Subject("areas kml", kml, _refused_or_read(read_areas, "damaged.kml")),
        Subject("toml", toml, _refused_or_read(load_config, "damaged.toml")),
        Subject("bathymetry", bottom.read_bytes(), read_bottom, True),
        *(
            Subject(f"zarr {name}", place.read_bytes(), _of_store(store, place), True)
            for name, place in parts.items()
        ),
    ]


def _of_store(store: Path, place: Path) -> Check:
    """Return the check of one file of a forecast's store, which is sound again after it."""
    sound = place.read_bytes()

    def check(harm: Mishap, _: Path) -> list[str]:
        try:
            return _refused_or_read(lambda _: read_ensemble(store, ForecastConfig()), "")(
                harm, place
            )
        finally:
            place.write_bytes(sound)

    return check


def _refused_or_read(read: Callable[[Path], object], name: str) -> Check:
    """Return the check of an input without checksums: any exception but ours, and one of ours that does not name it, is wrong."""

    def check(harm: Mishap, path: Path) -> list[str]:
        named = path.with_name(name) if name else path
        named.write_bytes(harm.data)
        try:
            read(named)
        except ReplayKitError as error:
            fine = error.exit_code in (2, 3) and name in str(error)
            return [] if fine else [f"refused by {error}"]
        return []

    return check


def _classic(path: Path) -> Path:
    """Return a NetCDF-3 file with a row for each second."""
    speed = "time", np.linspace(0.0, 1.0, 50), {"units": "m s-1"}
    time = "time", np.arange(50.0), {"units": "seconds since 2020-01-01"}
    xr.Dataset({"speed": speed}, {"time": time}).to_netcdf(path, engine="scipy")
    return path
