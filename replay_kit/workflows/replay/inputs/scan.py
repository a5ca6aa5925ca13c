"""Logs opened, and scanned before a replay for where and when they begin."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, MeasurementError
from replay_kit.core.message import LogReader, Message
from replay_kit.core.observation import Observation, VehicleState
from replay_kit.logs import merge, open_logs
from replay_kit.logs.tables.frames import SCHEMA
from replay_kit.logs.tables.schemas import SENDERS
from replay_kit.measurements.observed import begun, rows, taken
from replay_kit.results.losses import iso_time

#: What a MAVLink reader needs to decode for measurements.
MAVLINK_NAMES = SENDERS | {SCHEMA}
# Positions are kept to this fraction of a degree: a long log has millions.
_PER_DEGREE = 100
# Messages that are decoded and tested together; one with thousands of vectors, 2 MB, is the last of its block.
_BLOCK, _LARGE = 2048, "replay_kit.RadarCurrents"


def open_readers(logs: Sequence[Path], config: RunConfig) -> list[LogReader]:
    """Return the opened logs; of MAVLink and DataFlash only the messages that the estimator uses, and mapped topics, are decoded.

    Raises:
        LogError: A file is missing or is not a log.
    """
    mapped = [entry.topic.split("/") for entry in config.measurements.map]
    # a schema of DataFlash has its format's name before that of the record
    wanted = MAVLINK_NAMES | {
        ".".join(parts) if parts[0] == "dataflash" else parts[-1] for parts in mapped
    }
    return list(open_logs(logs, config.logs, wanted))


def look_ahead(
    logs: Sequence[Path], config: RunConfig
) -> tuple[tuple[float, float] | None, int | None]:
    """Return the mean position, when the ensemble is to be placed there, and the first time used [ns, UTC], of the chosen time span.

    Messages of topics that come once are read although they are older than the span, as in a replay, but their positions do not count.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: The ensemble is to be placed at the log, and the log holds no position in the span.
    """
    start_ns = config.logs.start_ns
    place_at, first_ns = (
        _mean_place(logs, config) if config.forecast.place else (None, _first_time(logs, config))
    )
    if first_ns is not None and start_ns is not None:
        first_ns = max(first_ns, start_ns)
    return place_at, first_ns


def _first_time(logs: Sequence[Path], config: RunConfig) -> int | None:
    firsts = (
        next(iter(merge([reader], config.logs.reorder_window)), None)
        for reader in open_readers(logs, config)
    )
    return min((message.time_ns for message in firsts if message is not None), default=None)


def positions_of(
    logs: Sequence[Path], config: RunConfig
) -> tuple[list[tuple[float, float]], int | None]:
    """Return the longitudes and latitudes that a replay would use, and the time of its first message [ns, UTC]; None without one."""
    first_ns, positions, placed = None, [], []
    for time_ns, events in _placed(logs, config):
        first_ns = time_ns if first_ns is None else first_ns
        positions += [
            (event.longitude, event.latitude) for event in events if isinstance(event, VehicleState)
        ]
        placed += [
            (event.longitude, event.latitude) for event in events if isinstance(event, Observation)
        ]
    # measurements with places of their own do not say where the vehicle is, but where to place the ensemble
    return positions or placed, first_ns


def positions_in(logs: Sequence[Path], config: RunConfig) -> list[VehicleState]:
    """Return the positions that a replay would use, in order."""
    return [
        event
        for _, events in _placed(logs, config)
        for event in events
        if isinstance(event, VehicleState)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """Where, how deep and when logs are.

    Attributes:
        places: shape (n, 2), longitude and latitude [degrees] to a hundredth, each place once.
        deepest: Greatest depth of the vehicle or of a measurement [m]; None without one.
        first_ns: First time [ns, UTC]; None without a message.
        last_ns: Last time [ns, UTC].
    """

    places: Array
    deepest: float | None
    first_ns: int | None
    last_ns: int | None


def reach_of(logs: Sequence[Path], config: RunConfig) -> Reach:
    """Return where, how deep and when a replay places the vehicle and its measurements.

    Raises:
        LogError: A log cannot be opened.
    """
    found, deepest, times = dict[tuple[int, int], None](), [0.0], list[int]()
    for time_ns, events in _placed(logs, config):
        times = [min([time_ns, *times]), max([time_ns, *times])]
        for event in events:
            found[round(event.longitude * _PER_DEGREE), round(event.latitude * _PER_DEGREE)] = None
            deepest.append(float(np.fmax.reduce(np.ravel(event.depth), initial=0.0)))
    places = np.array(list(found), dtype=np.float64).reshape(-1, 2) / _PER_DEGREE
    start_ns, end_ns = config.logs.start_ns, config.logs.end_ns
    if not times:
        return Reach(places, None, start_ns, end_ns)
    # messages that come once may be older than the span
    return Reach(places, max(deepest), max(times[0], start_ns or times[0]), times[1])


def _placed(
    logs: Sequence[Path], config: RunConfig
) -> Iterator[tuple[int, list[VehicleState | Observation]]]:
    """Yield the time of each message [ns, UTC] with the positions and placed measurements it completes, in the time span alone."""
    settings = config.logs
    stream = begun(settings.system, settings.component)
    messages = iter(
        merge(
            open_readers(logs, config), settings.reorder_window, settings.start_ns, settings.end_ns
        )
    )
    while block := next_block(messages):
        first = stream.order
        stream, found = taken(stream, block, config.measurements)
        events: dict[int, list[VehicleState | Observation]] = {}
        for due, event in zip(found.events[:, 0].tolist(), rows(found), strict=True):
            if isinstance(event, VehicleState | Observation):
                events.setdefault(due, []).append(event)
        for k, message in enumerate(block):
            counts = settings.start_ns is None or message.time_ns >= settings.start_ns
            yield message.time_ns, events.get(first + k, []) if counts else []


def next_block(messages: Iterator[Message], longest_s: float = np.inf) -> list[Message]:
    """Return the messages of the next block, which ends with the first so long after its beginning [s]; none at the end."""
    found: list[Message] = []
    for message in islice(messages, _BLOCK):
        found.append(message)
        if message.schema == _LARGE or message.time_ns - found[0].time_ns >= 1e9 * longest_s:
            break
    return found


def _mean_place(logs: Sequence[Path], config: RunConfig) -> tuple[tuple[float, float], int | None]:
    """Return the mean longitude and latitude of the positions that a replay would use, and the time of its first message."""
    settings = config.logs
    positions, first_ns = positions_of(logs, config)
    if not positions:
        between = (
            f" between {settings.start or 'their start'} and {settings.end or 'their end'}"
            if settings.start or settings.end
            else ""
        )
        raise MeasurementError(
            f"--place-ensemble moves the ensemble to the mean fix, but the logs hold no position{between}; "
            + (
                "widen --start and --end, or leave the option out"
                if between
                else "leave the option out"
            )
            + f"; replay-kit info {logs[0]} says what is in a log, and --suggest map.toml beside it maps topics of unknown types"
        )
    longitude, latitude = np.array(positions).T
    # on the unit circle, because longitudes may lie on both sides of the antimeridian
    directions = np.exp(1j * np.deg2rad(longitude))
    return (float(np.rad2deg(np.angle(directions.mean()))), float(latitude.mean())), first_ns


def check_span(logs: Sequence[Path], config: RunConfig, last_ns: int | None) -> None:
    """Raise ConfigError when the logs have messages, and none of them lies in the time span that is asked for.

    Args:
        logs: The logs.
        config: With the span.
        last_ns: Time of the last message read [ns, UTC]; those of topics that come once may be older than the span. None without one.
    """
    settings = config.logs
    asked = [
        f"--{name} {text}"
        for name, text in (("start", settings.start), ("end", settings.end))
        if text is not None
    ]
    if not asked or (last_ns is not None and last_ns >= (settings.start_ns or 0)):
        return
    times = [
        message.time_ns for reader in open_readers(logs, config) for message in reader.messages()
    ]
    if times:
        raise ConfigError(
            f"{' and '.join(asked)}: no message lies there; the log spans {iso_time(min(times), 's')} to {iso_time(max(times), 's')}"
        )
