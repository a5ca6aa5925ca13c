"""Logs opened once, and scanned before a replay for their place and start."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, tee
from pathlib import Path

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array, Times
from replay_kit.core.errors import ConfigError, MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.observation.table import Block
from replay_kit.logs import merge, open_logs
from replay_kit.logs.merge import Merge
from replay_kit.logs.reader import LogFile
from replay_kit.logs.tables.instruments import SCHEMA
from replay_kit.logs.tables.schemas import SENDERS
from replay_kit.measurements.observed import measure_messages, new_stream
from replay_kit.results.losses import iso_time

#: What a MAVLink reader needs to decode for measurements.
MAVLINK_NAMES = SENDERS | {SCHEMA}
# Positions are kept to this fraction of a degree: a long log has millions.
_PER_DEGREE = 100
# Messages that are decoded and tested together; one with thousands of vectors, 2 MB, is the last of its block.
_BLOCK, _LARGE = 2048, "replay_kit.RadarCurrents"


def open_readers(logs: Sequence[Path], config: RunConfig) -> list[LogFile]:
    """Return the opened logs; from MAVLink and DataFlash only mapped topics and messages used by the estimator are decoded.

    Raises:
        LogError: A file is missing or is not a log.
    """
    mapped = [entry.topic.split("/") for entry in config.measurements.map]
    # a schema of DataFlash has its format's name before that of the record
    wanted = MAVLINK_NAMES | {
        ".".join(parts) if parts[0] == "dataflash" else parts[-1] for parts in mapped
    }
    return open_logs(logs, config.logs, wanted)


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Places, depth and period of logs.

    Attributes:
        places: shape (n, 2), longitude and latitude [degrees] to a hundredth, each place once.
        middle: Mean longitude and latitude of the vehicle, or else of independent observations [degrees]; None without positions.
        deepest: Greatest depth of the vehicle or of an observation [m]; None without one.
        first_ns: First time [ns, UTC]; None without a message.
        last_ns: Last time [ns, UTC].
    """

    places: Array
    middle: tuple[float, float] | None
    deepest: float | None
    first_ns: int | None
    last_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class VehicleLogs:
    """Opened logs of a vehicle.

    Attributes:
        files: The logs, numbered consecutively among those of all vehicles.
        merged: Their messages in order.
    """

    files: Sequence[LogFile]
    merged: Merge[Message]


class Logs:
    """Logs of a run's vehicles, each opened once: their reach and messages.

    Attributes:
        config: The run's settings.
        all: Logs of all vehicles.
        by_vehicle: Logs of each vehicle.
    """

    def __init__(self, each: Sequence[Sequence[Path]], config: RunConfig) -> None:
        """Open the logs of each vehicle; for errors see ``open_readers``."""
        self.config, settings = config, config.logs
        self.all, self._begun = list[LogFile](), list[_Begun]()
        self.by_vehicle = list[VehicleLogs]()
        span = settings.reorder_window, settings.start_ns, settings.end_ns
        for paths in each:
            files = open_readers(paths, config)
            for number, log in enumerate(files, len(self.all)):
                log.input = number
            begun = [_Begun(log) for log in files]
            self.by_vehicle.append(VehicleLogs(files, merge(begun, *span)))
            self.all += files
            self._begun += begun

    def close(self) -> None:
        """Close the files of passes that did not end."""
        with ExitStack() as stack:
            for log in self.all:
                stack.enter_context(log)

    def ahead(self) -> tuple[tuple[float, float] | None, int | None]:
        """Return the mean position, if the ensemble is to be moved there, and the first used time [ns, UTC] in the time span.

        As in a replay, messages of one-time topics before the span are read, but not their positions.

        Raises:
            MeasurementError: The ensemble is to be moved to the log, which has no position in the span.
        """
        settings = self.config.logs
        if self.config.forecast.place:
            if self.reach.middle is None:
                start, end = settings.start, settings.end
                span = f" between {start or 'their start'} and {end or 'their end'}"
                raise MeasurementError(
                    f"--place-ensemble moves the ensemble to the mean fix, the logs hold no position{span if start or end else ''}; "
                    "widen --start and --end, or leave it out"
                )
            return self.reach.middle, self.reach.first_ns
        for log in self._begun:
            log.looked_at = True
        each = (next(iter(merge([log], settings.reorder_window)), None) for log in self._begun)
        first_ns = min((message.time_ns for message in each if message is not None), default=None)
        return None, first_ns if first_ns is None else max(first_ns, settings.start_ns or first_ns)

    @cached_property
    def reach(self) -> Reach:
        """Places, depth and period of the vehicles and observations of a replay, from one pass over all messages."""
        found, deepest, spans = dict[tuple[int, int], None](), [0.0], list[int]()
        # of positions, profiles, mean currents and radar currents
        sums = np.zeros((4, 3), np.complex128)
        for times, block in self.measured():
            spans += [int(times.min()), int(times.max())]
            sums[3] += sum(_sums(one.value_places) for one in block.linear)
            kinds = (block.position, ""), (block.ping, ""), (block.mean, "path_")
            for kind, (columns, prefix) in enumerate(kinds):
                if (rows := block.events[block.events[:, 1] == kind, 2]).size:
                    names = (f"{prefix}{name}" for name in ("longitude", "latitude", "depth"))
                    *places, depth = (columns[name][rows].ravel() for name in names)
                    known = np.array(places)[:, np.isfinite(places[0])]
                    sums[kind] += _sums(known)
                    cells = np.rint(known.T * _PER_DEGREE).astype(np.int64)
                    found |= dict.fromkeys(map(tuple, cells.tolist()))
                    deepest.append(float(np.fmax.reduce(depth, initial=0.0)))
        n, direction, latitude = next((one for one in sums if one[0]), sums[0])
        middle = (float(np.rad2deg(np.angle(direction))), float((latitude / n).real)) if n else None
        each = np.array(list(found), dtype=np.float64).reshape(-1, 2) / _PER_DEGREE
        first_ns, last_ns = self.config.logs.start_ns, self.config.logs.end_ns
        if not spans:
            return Reach(each, middle, None, first_ns, last_ns)
        # messages that come once may be older than the span
        first_ns = max(min(spans), first_ns or min(spans))
        return Reach(each, middle, max(deepest), first_ns, max(spans))

    def measured(self) -> Iterator[tuple[Times, Block]]:
        """Yield the message times of each block [ns, UTC], and its measured events within the time span."""
        settings = self.config.logs
        stream, start_ns = new_stream(settings.system, settings.component), settings.start_ns
        for log in self._begun:
            log.rest = None
        messages = iter(merge(self.all, settings.reorder_window, start_ns, settings.end_ns))
        while read := next_block(messages):
            first = stream.order
            stream, block = measure_messages(stream, read, self.config.measurements)
            times = np.array([message.time_ns for message in read])
            counts = times[block.events[:, 0] - first] >= (
                -np.inf if start_ns is None else start_ns
            )
            yield times, replace(block, events=block.events[counts])

    def check_span(self, last_ns: int | None) -> None:
        """Raise ConfigError if no message of the logs lies in the requested time span.

        Args:
            last_ns: Time of the last message read [ns, UTC]; one-time topics may precede the span. None without messages.
        """
        settings = self.config.logs
        asked = [
            f"--{name} {text}"
            for name, text in (("start", settings.start), ("end", settings.end))
            if text is not None
        ]
        if not asked or (last_ns is not None and last_ns >= (settings.start_ns or 0)):
            return
        if times := [message.time_ns for log in self.all for message in log.messages()]:
            raise ConfigError(
                f"{' and '.join(asked)}: no message lies there; the log spans {iso_time(min(times), 's')} to {iso_time(max(times), 's')}"
            )


def _sums(places: Iterable[Array]) -> Array:
    """Return the number of places, the sum of their longitudes as complex numbers of the unit circle, and of their latitudes [degrees].

    Longitudes may lie on both sides of the antimeridian.
    """
    longitude, latitude = places
    return np.array([longitude.size, np.exp(1j * np.deg2rad(longitude)).sum(), latitude.sum()])


class _Begun:
    """Log whose messages read in a first look are kept for the next pass."""

    def __init__(self, log: LogFile) -> None:
        self._log, self.looked_at = log, False
        self.rest: Iterator[Message] | None = None

    def messages(self) -> Iterator[Message]:
        """Yield all messages; those of a look are kept for the next pass, which continues from there."""
        if self.looked_at:
            self.looked_at = False
            looked, self.rest = tee(self._log.messages())
            return looked
        rest, self.rest = self.rest, None
        return rest or self._log.messages()


def next_block(messages: Iterator[Message], longest_s: float = np.inf) -> list[Message]:
    """Return the messages of the next block, up to the first one a given time after its beginning [s]; empty at the end."""
    found: list[Message] = []
    for message in islice(messages, _BLOCK):
        found.append(message)
        if message.schema == _LARGE or message.time_ns - found[0].time_ns >= 1e9 * longest_s:
            break
    return found
