"""Reader of ArduPilot's DataFlash logs (.BIN).

A record is the bytes a3 95, its type, and the fields that the FMT record of that type declares. There is no checksum: after bad bytes a
record counts only if another record or the end of the log follows it. The field letters are in ArduPilot's
``libraries/AP_Logger/README.md``; their factors are applied, units and multipliers (UNIT, MULT, FMTU) are not.
"""

import struct
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from mmap import ACCESS_READ, mmap
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Times
from replay_kit.core.message import Message
from replay_kit.logs.blocks import ReadStatistics
from replay_kit.logs.mavlink.fit import (
    ClockFit,
    fit_clock,
    gps_to_utc,
    leap_seconds,
    spikes_note,
    without_spikes,
)
from replay_kit.logs.reader import LogFile

MAGIC = b"\xa3\x95"
_HEAD, _FMT_TYPE = 3, 0x80
# each letter as struct has it
_CODES: Mapping[str, str] = {
    **{letter: letter for letter in "bBhHiIfdqQ"},
    **{"a": "32h", "g": "e", "n": "4s", "N": "16s", "Z": "64s", "M": "B"},
    **{"c": "h", "C": "H", "e": "i", "E": "I", "L": "i"},
}
# of stored values: more exact than multiplying by a hundredth
_DIVISORS: Mapping[str, float] = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
#: A stamp of more [microseconds], three years after the start, is damage.
_MAX_BOOT_US = 10**14
_FIX_3D = 3
_GPS_TIME = ("TimeUS", "Status", "GWk", "GMS")
#: A GPS week in the year 2171, and still within int64 nanoseconds.
_MAX_WEEK = 10_000


@dataclass(frozen=True)
class Format:
    """Record type declared by FMT.

    Attributes:
        type: Type number.
        name: ``GPS``, ``BARO`` and so on.
        length: Length of a record with its header [bytes].
        letters: Type letter of each column.
        columns: Column names.
    """

    type: int
    name: str
    length: int
    letters: str
    columns: tuple[str, ...]

    @cached_property
    def layout(self) -> struct.Struct | None:
        """Struct of the fields; None if a letter is unknown or the columns or length disagree."""
        if not len(self.letters) == len(self.columns) == len(set(self.columns)):
            return None
        if not set(self.letters) <= _CODES.keys():
            return None
        layout = struct.Struct("<" + "".join(_CODES[letter] for letter in self.letters))
        return layout if self.length == _HEAD + layout.size else None

    def boot_us(self, data: mmap, at: int) -> int:
        """Return the time since boot in the record at an offset [microseconds]; -1 without one."""
        if self.layout is None or (self.columns[:1], self.letters[:1]) != (("TimeUS",), "Q"):
            return -1
        return min(int.from_bytes(data[at + _HEAD : at + _HEAD + 8], "little"), _MAX_BOOT_US + 1)

    def values(self, data: mmap | bytes, at: int) -> tuple[Any, ...]:
        """Return the stored fields of the record at an offset of a log."""
        return () if self.layout is None else self.layout.unpack_from(data, at + _HEAD)

    def payload(self, data: mmap, at: int) -> dict[str, Any]:
        """Return the fields by name, with the letters' factors applied and texts decoded; FILE data stay bytes."""
        named, fields = {}, iter(self.values(data, at))
        for name, letter in zip(self.columns, self.letters, strict=True):
            value: Any = [*islice(fields, 32)] if letter == "a" else next(fields)
            if letter in _DIVISORS:
                value = value / _DIVISORS[letter]
            elif letter in "nNZ" and not (letter == "Z" and self.name == "FILE"):
                value = _text(value)
            named[name] = value
        return named


#: The format of formats.
FMT = Format(_FMT_TYPE, "FMT", 89, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


class Log(NamedTuple):
    """Records of a file, in its order.

    Attributes:
        forms: Format of each.
        offset: Start of each [bytes], shape (n,).
        boot_us: Stated time since boot of each [microseconds], shape (n,); negative without one.
    """

    forms: Sequence[Format]
    offset: NDArray[np.int64]
    boot_us: Times


def _declared(values: tuple[Any, ...]) -> Format | None:
    """Return the format declared by an FMT record; None if the bytes are no valid declaration."""
    try:
        name, letters, columns = (part.split(b"\0", 1)[0].decode("ascii") for part in values[2:])
    except UnicodeDecodeError:
        return None
    names = tuple(columns.split(",")) if columns else ()
    plausible = (
        values[1] >= _HEAD
        and all(part.isidentifier() for part in (name, *names))
        and (letters.isalnum() or not letters)
    )
    return Format(values[0], name, values[1], letters, names) if plausible else None


def is_dataflash(head: bytes) -> bool:
    """Return whether the first bytes of a file contain the declaration of a record type."""
    at, mark = -1, MAGIC + bytes([_FMT_TYPE])
    while (at := head.find(mark, at + 1)) >= 0:
        if at + FMT.length <= len(head) and _declared(FMT.values(head, at)):
            return True
    return False


def _read(data: mmap, statistics: ReadStatistics) -> Log:
    """Return the records of a log, under the formats declared before them; bytes between them and a truncated last record are losses."""
    formats, size, at = {_FMT_TYPE: FMT}, len(data), 0
    forms, offset, boot_us = list[Format](), array("q"), array("q")

    def format_at(at: int) -> Format | None:
        """Return the format of the record at an offset; None without a whole record."""
        form = formats.get(data[at + 2]) if at + _HEAD <= size else None
        whole = form is not None and data[at : at + 2] == MAGIC and at + form.length <= size
        return form if whole else None

    def is_followed(end: int) -> bool:
        """Return whether a record or the end of the log follows at an offset; the second magic byte may be missing."""
        return MAGIC.startswith(data[end : end + 2])

    def after(first: int, last: int) -> int | None:
        """Return the offset of the next record that another record or the end of the log follows; None without one."""
        at = first - 1
        while (at := data.find(MAGIC, at + 1, min(last + 1, size))) >= 0:
            form = format_at(at)
            if form is not None and is_followed(at + form.length):
                return at
        return None

    while at < size:
        form = format_at(at)
        # the next one may be damaged, unless a sound one begins in this one
        if form is None or not (
            is_followed(at + form.length) or after(at + 1, at + form.length) is None
        ):
            following = after(at + 1, size)
            what = "bad bytes, or records of an unknown type, skipped"
            if following is None:
                what = "at the end: a truncated record or bad bytes, skipped"
            end = size if following is None else following
            statistics.lose(what, at, end - at)
            at = end
            continue
        if form is FMT and (new := _declared(form.values(data, at))) and new.type != _FMT_TYPE:
            formats[new.type] = new
        forms.append(form)
        offset.append(at)
        boot_us.append(form.boot_us(data, at))
        at += form.length
    return Log(forms, np.array(offset, np.int64), np.array(boot_us, np.int64))


class DataflashReader(LogFile):
    """Reader of a DataFlash log, which has one clock.

    Times are UTC if the log has GPS time, fitted to the vehicle's clock over the whole log; otherwise they count from boot, as the report
    notes.
    """

    format = "dataflash"

    def messages(self) -> Iterator[Message]:
        """Yield the wanted records in file order.

        ``topic`` is ``dataflash/{NAME}``, ``schema`` is ``dataflash.{NAME}``, ``position`` the ordinal among all records of the file. A
        record without a stamp takes that of the previous one.

        Raises:
            LogError: The file cannot be read.
        """
        self.statistics = ReadStatistics()
        with self._opened() as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
            log = _read(data, self.statistics)
            clock, note = _clock(log, data)
            boot_ns, notes = _steady(log)
            self.statistics.notes = note, *notes
            times = (boot_ns if clock is None else clock.utc(boot_ns)).tolist()
            offsets = log.offset.tolist()
            for position, (form, at, time_ns) in enumerate(
                zip(log.forms, offsets, times, strict=True)
            ):
                topic, schema = self._topic(f"dataflash/{form.name}"), f"dataflash.{form.name}"
                self.statistics.read[topic] += 1
                if form.layout is None:
                    why = f"its format {form.letters} of {form.length} bytes does not fit the columns {','.join(form.columns)}"
                    self.statistics.undecodable(topic, why)
                elif self._wanted is None or schema in self._wanted:
                    payload = form.payload(data, at)
                    yield Message(time_ns, topic, schema, payload, self.input, position)


def _clock(log: Log, data: mmap) -> tuple[ClockFit | None, str]:
    """Return the vehicle's clock fitted to the GPS time in a log, None without, and a note."""
    gps = []
    for form, at, boot_us in zip(log.forms, log.offset.tolist(), log.boot_us.tolist(), strict=True):
        if form.name == "GPS" and set(_GPS_TIME) <= set(form.columns) and _is_possible(boot_us):
            stated = itemgetter(*_GPS_TIME)(form.payload(data, at))
            if all(isinstance(value, int) for value in stated):
                gps.append(stated)
    boot, status, week, week_ms = np.array(gps or np.empty((0, 4)), dtype=np.int64).T
    timed = (status >= _FIX_3D) & (week > 0) & (week < _MAX_WEEK)
    if not timed.any():
        return (
            None,
            "no GPS time: times count from the vehicle's start, as if that were 1970-01-01",
        )
    fit = fit_clock(boot[timed] * 1000, gps_to_utc(week[timed], week_ms[timed]))
    ahead = int(leap_seconds(np.array([fit.utc_ns]))[0])
    note = f"UTC from GPS time less {ahead} leap seconds, fitted to the vehicle's clock: {fit}"
    return fit, note


def _is_possible(boot_us: Any) -> Any:
    return (boot_us >= 0) & (boot_us <= _MAX_BOOT_US)


def _steady(log: Log) -> tuple[Times, list[str]]:
    """Return the times since boot of all records [ns], that of the record before where none is possible, and notes on the stamps."""
    known = np.flatnonzero(_is_possible(log.boot_us))
    stamps, spikes = without_spikes(log.boot_us[known], None)
    steps = np.diff(stamps)
    back = f"stamps go backwards, by up to {-steps.min(initial=0) / 1000:.3f} ms"
    odd = "records with an impossible stamp were given the time of the record before"
    counts = {back: np.sum(steps < 0), odd: np.sum(log.boot_us > _MAX_BOOT_US)}
    notes = [f"{n} {what}" for what, n in counts.items() if n]
    # records before the first stamp have its time
    filled = np.append(stamps[:1] if stamps.size else 0, stamps)
    at = np.searchsorted(known, np.arange(log.boot_us.size), side="right")
    return filled[at] * 1000, [*notes, *([spikes_note(spikes)] if spikes else [])]


def _text(value: bytes) -> str:
    value = value.split(b"\0", 1)[0]
    try:
        return value.decode()
    except UnicodeDecodeError:
        return value.decode("latin-1")
