"""Reader of ArduPilot's DataFlash logs (.BIN): messages in the order of the file for a replay, whole columns for analysis."""

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.logs.dataflash.records import Records, read_records, scaled
from replay_kit.logs.reader import LogFile
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.clock import (
    ClockFit,
    fit_clock,
    gps_to_utc,
    leap_seconds,
    spikes_note,
    without_spikes,
)

#: A stamp of more [microseconds], three years after the start, is damage.
_MAX_BOOT_US = 10**14
_FIX_3D = 3
_GPS_TIME = ("TimeUS", "Status", "GWk", "GMS")
#: A GPS week in the year 2171, and still within int64 nanoseconds.
_MAX_WEEK = 10_000
_PREFIX = "dataflash"
Columns = dict[str, NDArray[Any]]


class DataflashReader(LogFile):
    """A DataFlash log opened for reading, in blocks. It has one clock.

    Times are UTC when the log has GPS time, fitted to the vehicle's clock over the whole log; otherwise they count from the vehicle's
    start, which the report notes.
    """

    format = "dataflash"
    without_checksum = "records of a DataFlash log"

    def messages(self) -> Iterator[Message]:
        """Yield the wanted records in the order in which the file holds them.

        ``topic`` is ``dataflash/{NAME}``, ``schema`` is ``dataflash.{NAME}``, ``position`` the ordinal of the record in the file,
        unwanted ones counted. A record without a stamp has that of the record before.

        Raises:
            LogError: The file cannot be read.
        """
        self.statistics = ReadStatistics()
        clock, stamp_us, notes = self._fit_clock()
        stamps = _Stamps(stamp_us)
        position = 0
        for records in self._read(self.statistics):
            payloads = self._payloads(records)
            boot_us = stamps.of(records)
            times = boot_us * 1000 if clock is None else clock.utc(boot_us * 1000)
            for at, (time_ns, payload) in enumerate(
                zip(times.tolist(), payloads, strict=True), position
            ):
                if payload is not None:
                    yield Message(time_ns, *payload, self.input, at)
            position += records.start.size
            self.statistics.notes = (*notes, *stamps.notes())

    def tables(self, names: frozenset[str] | None = None) -> dict[str, Columns]:
        """Return the records of each kind as columns, each of shape (n,) or, for arrays, (n, 32), with the letters' factors applied.

        Args:
            names: Kinds to read; None reads all.

        Raises:
            LogError: The file cannot be read, or declares a kind in two ways.
        """
        parts: dict[str, list[Columns]] = defaultdict(list)
        for records in self._read(ReadStatistics()):
            for form, places in records.decodable():
                if names is None or form.name in names:
                    parts[form.name].append(scaled(records.structured(form, places), form))
        for name, pieces in parts.items():
            if any(piece.keys() != pieces[0].keys() for piece in pieces):
                raise LogError(
                    f"{self.path}: {name} is declared twice, with other columns; read it with messages()"
                )
        return {
            name: {key: np.concatenate([piece[key] for piece in pieces]) for key in pieces[0]}
            for name, pieces in parts.items()
        }

    def _payloads(self, records: Records) -> list[tuple[str, str, dict[str, Any]] | None]:
        """Return (topic, schema, fields) of each record, None of those that are not wanted, and count all."""
        payloads: list[tuple[str, str, dict[str, Any]] | None] = [None] * records.start.size
        for form, places in records.kinds():
            topic, schema = self._topic(f"{_PREFIX}/{form.name}"), f"{_PREFIX}.{form.name}"
            self.statistics.read[topic] += places.size
            if not form.known:
                why = f"its format {form.letters} of {form.length} bytes does not fit the columns {','.join(form.columns)}"
                self.statistics.undecodable(topic, why, places.size)
            elif self._wanted is None or schema in self._wanted:
                columns = [
                    values.tolist()
                    for values in scaled(records.structured(form, places), form).values()
                ]
                rows = zip(*columns, strict=True) if columns else [()] * places.size
                for place, row in zip(places.tolist(), rows, strict=True):
                    payloads[place] = topic, schema, dict(zip(form.columns, row, strict=True))
        return payloads

    def _read(self, statistics: ReadStatistics) -> Iterator[Records]:
        with self._opened() as file:
            yield from read_records(file, statistics)

    def _fit_clock(self) -> tuple[ClockFit | None, int, tuple[str, ...]]:
        """Return the clock fitted to the GPS time of the whole log, the log's first stamp [microseconds], and notes on both."""
        boot, utc, first_us = [], [], None
        for records in self._read(ReadStatistics()):
            for form, places in records.decodable():
                if form.name == "GPS" and all(
                    key in form.columns and form.dtype[key].kind in "iu" for key in _GPS_TIME
                ):
                    gps = records.structured(form, places)
                    timed = (
                        (gps["Status"] >= _FIX_3D)
                        & (gps["GWk"] > 0)
                        & (gps["GWk"] < _MAX_WEEK)
                        & (gps["TimeUS"] <= _MAX_BOOT_US)
                    )
                    gps = gps[timed]
                    boot.append(gps["TimeUS"].astype(np.int64) * 1000)
                    utc.append(gps_to_utc(gps["GWk"].astype(np.int64), gps["GMS"].astype(np.int64)))
            if first_us is None:
                stated, _ = _stated(records)
                first_us = next(iter(stated[stated >= 0].tolist()), None)
        if not sum(map(len, boot)):
            return (
                None,
                first_us or 0,
                ("no GPS time: times count from the vehicle's start, as if that were 1970-01-01",),
            )
        fit = fit_clock(np.concatenate(boot), np.concatenate(utc))
        ahead = int(leap_seconds(np.array([fit.utc_ns]))[0])
        return (
            fit,
            first_us or 0,
            (f"UTC from GPS time less {ahead} leap seconds, fitted to the vehicle's clock: {fit}",),
        )


class _Stamps:
    """Times since the vehicle's start of consecutive records, with counts of implausible stamps; mutable, as blocks are streamed."""

    def __init__(self, first_us: int) -> None:
        """Begin with the stamp for records before the first that has one [microseconds]."""
        self._last = first_us
        self._backward = 0
        self._most_us = 0
        self._impossible = 0
        self._spikes = 0

    def of(self, records: Records) -> NDArray[np.int64]:
        """Return the stamp of each of the next records [microseconds]; one without a stamp has that of the record before."""
        stated, impossible = _stated(records)
        known = np.flatnonzero(stated >= 0)
        stated[known], spikes = without_spikes(stated[known], self._last)
        self._spikes += spikes
        steps = np.diff(stated[known], prepend=self._last)
        self._impossible += impossible
        self._backward += int(np.count_nonzero(steps < 0))
        self._most_us = max(self._most_us, -int(steps.min(initial=0)))
        before = np.searchsorted(known, np.arange(stated.size), side="right")
        filled = np.concatenate([[self._last], stated[known]])[before]
        self._last = int(filled[-1]) if filled.size else self._last
        return filled

    def notes(self) -> tuple[str, ...]:
        """Return what a user should know."""
        notes = (
            (
                self._backward,
                f"{self._backward} stamps go backwards, by up to {self._most_us / 1000:.3f} ms",
            ),
            (
                self._impossible,
                f"{self._impossible} records with an impossible stamp were given the time of the record before",
            ),
            (self._spikes, spikes_note(self._spikes)),
        )
        return tuple(note for count, note in notes if count)


def _stated(records: Records) -> tuple[NDArray[np.int64], int]:
    """Return the stamp of each record [microseconds], -1 where it states none, and how many state an impossible one."""
    stated, impossible = np.full(records.start.size, -1, dtype=np.int64), 0
    for form, places in records.decodable():
        for name, letters, factor in (("TimeUS", "Q", 1), ("TimeMS", "I", 1000)):
            if (name, letters) in zip(form.columns, form.letters, strict=True):
                values = records.structured(form, places)[name]
                possible = values <= _MAX_BOOT_US // factor
                stated[places[possible]] = values[possible].astype(np.int64) * factor
                impossible += int(np.count_nonzero(~possible))
                break
    return stated, impossible
