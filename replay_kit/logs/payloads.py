"""Payloads: parts of messages converted from other formats (stamps, fixes, missing numbers, notes), and messages as JSON."""

import base64
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from replay_kit.core.arrays import Indices, Times
from replay_kit.core.errors import LogError
from replay_kit.core.message import Message, RawChannel, RawMessage

PING, FIX = "replay_kit.AdcpPing", "foxglove.LocationFix"
#: Schema of the mean current of a dive.
DIVE_MEAN = "replay_kit.DepthAveragedCurrent"
_NS = 1_000_000_000
# rows of which messages are made at once
_ROWS = 4096
#: A message before it has a position: time [ns], topic, schema, payload.
Entry = tuple[int, str, str, dict[str, Any]]


def stamp(time_ns: int) -> dict[str, int]:
    """Return a time [ns, UTC] as seconds and nanoseconds."""
    return {"sec": time_ns // _NS, "nsec": time_ns % _NS}


def number(value: float) -> float | None:
    """Return a number, or None if it is not finite, as JSON has no NaN."""
    return value if math.isfinite(value) else None


def numbers(values: NDArray[Any]) -> Any:
    """Return an array as nested lists, or a number, with None for values that are not finite."""
    values = np.asarray(values, dtype=np.float64)
    plain: NDArray[Any] = values.astype(object)
    plain[~np.isfinite(values)] = None
    return plain.tolist()


def location_fix(
    time_ns: int, longitude: float, latitude: float, depth: float, dead_reckoned: bool, error: float
) -> dict[str, Any]:
    """Return a ``foxglove.LocationFix``.

    Args:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down.
        dead_reckoned: Whether the position was dead-reckoned.
        error: Standard error of each horizontal component [m]; NaN or 0 if unknown.
    """
    stated = error > 0.0
    variance = float(error) ** 2 if stated else 0.0
    return {
        "timestamp": stamp(time_ns),
        "frame_id": "vehicle",
        "latitude": float(latitude),
        "longitude": float(longitude),
        "altitude": -float(depth),
        "position_covariance": [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 0.0],
        "position_covariance_type": 1 if stated else 0,
        "metadata": [
            {"key": "depth", "value": f"{depth:.3f}"},
            {"key": "dead_reckoned", "value": "true" if dead_reckoned else "false"},
        ],
    }


def fix_entries(columns: Mapping[str, NDArray[Any]]) -> Iterator[Entry]:
    """Yield time, topic, schema and payload of each fix at the surface.

    Args:
        columns: ``time`` [ns, UTC], ``longitude``, ``latitude`` [degrees], ``error`` of each component [m], NaN if unknown; shape (n,).
    """
    held = (columns[name].tolist() for name in ("time", "longitude", "latitude", "error"))
    for time_ns, longitude, latitude, error in zip(*held, strict=True):
        fix = location_fix(time_ns, longitude, latitude, 0.0, False, error)
        yield time_ns, "/vehicle/fix", FIX, fix


def entries(
    kind: tuple[str, str],
    time_ns: Times,
    columns: Mapping[str, NDArray[Any]],
    rows: Indices,
    common: Mapping[str, Any],
    stamped: bool = True,
) -> Iterator[Entry]:
    """Yield a message for each of some rows of a table: common fields and its columns, null where not finite.

    Args:
        kind: Topic and schema of the messages.
        time_ns: Times of the rows, shape (n,) [ns, UTC].
        columns: Columns, shape (n, ...); that of the times themselves is left out.
        rows: Indices of the rows, in the order of the messages.
        common: Fields of all messages.
        stamped: Whether the messages have their time as ``stamp``.
    """
    others = {key: column for key, column in columns.items() if column is not time_ns}
    # some rows at once, to limit memory
    for some in np.split(rows, range(_ROWS, rows.size, _ROWS)):
        parts = [column[some] for column in others.values()]
        held = [numbers(part) if part.dtype.kind == "f" else part.tolist() for part in parts]
        for time, *row in zip(time_ns[some].tolist(), *held, strict=True):
            payload = {**common, **dict(zip(others, row, strict=True))}
            yield time, *kind, {"stamp": stamp(time)} | payload if stamped else payload


# not within names, such as VelocityBeam1
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w])")
_READ_AS = "read as "


def merged_notes(notes: Iterable[str]) -> Mapping[str, list[str]]:
    """Return notes with their occurrences in order of the first; notes that differ only in numbers are merged with ranges."""
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(note if note.startswith(_READ_AS) else _NUMBER.sub("#", note), []).append(
            note
        )
    return {_with_ranges(same): same for same in alike.values()}


def by_variable(notes: Iterable[str]) -> list[str]:
    """Return notes with equal texts on several variables merged."""
    names: dict[str, list[str]] = {}
    for note in notes:
        name, _, said = note.partition(": ")
        if not said or " " in name:
            name, said = "", note
        names.setdefault(said, []).append(name)
    return [
        f"{', '.join(variables)}: {said}" if variables[0] else said
        for said, variables in names.items()
    ]


def short_note(note: str) -> str:
    """Return a note for a summary, with the number of variables instead of their names."""
    if not note.startswith(_READ_AS):
        return note
    return f"{note.count(': ')} variables were read by their names, which replay-kit info lists"


def _with_ranges(same: list[str]) -> str:
    """Return notes that differ in numbers as one, with the range of each number."""
    numbers = [_NUMBER.findall(note) for note in same]
    columns = iter([list(dict.fromkeys(column)) for column in zip(*numbers, strict=True)])

    def one(match: re.Match[str]) -> str:
        found = sorted(next(columns), key=float)
        return found[0] if len(found) == 1 else f"{found[0]} to {found[-1]}"

    return same[0] if len(set(same)) == 1 else _NUMBER.sub(one, same[0])


_TYPES = {str: "string", bool: "boolean", int: "number", float: "number"}


class JsonChannels:
    """Converter of messages to JSON, with a channel per topic and schema and sequence numbers per topic."""

    def __init__(self) -> None:
        self._channels: dict[tuple[str, str], RawChannel] = {}
        self._sent: Counter[str] = Counter()

    def raw(self, message: Message) -> RawMessage:
        """Return a message with a JSON payload; NaN and infinities become null, bytes become base64.

        Raises:
            LogError: The payload has no JSON form.
        """
        try:
            data = orjson.dumps(
                message.payload,
                default=_plain,
                option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS,
            )
        except (orjson.JSONEncodeError, TypeError) as error:
            raise LogError(
                f"{message.topic} at {message.time_ns} ns: expected a payload that JSON can hold: {error}"
            ) from error
        time_ns, sequence = message.time_ns, self._sent[message.topic]
        self._sent[message.topic] += 1
        return RawMessage(
            time_ns,
            message.input,
            message.position,
            self._channel(message.topic, message.schema, data),
            sequence,
            time_ns,
            time_ns,
            data,
        )

    def _channel(self, topic: str, schema: str, data: bytes) -> RawChannel:
        """Return the channel of a topic and schema, whose first message has these data."""
        channel = self._channels.get((topic, schema))
        if channel is None:
            text = orjson.dumps(_described(orjson.loads(data)))
            # a message without a schema's name keeps it that way
            definition = (schema, "jsonschema", text) if schema else None
            channel = self._channels[topic, schema] = RawChannel(0, topic, "json", (), definition)
        return channel


def _described(value: Any) -> dict[str, Any]:
    """Return the JSON schema of a value, without fields that are null and lists of lists, for which viewers have no type."""
    if isinstance(value, dict):
        fields = {name: found for name, one in value.items() if (found := _described(one))}
        return {"type": "object", "properties": fields}
    if isinstance(value, list):
        items = _described(value[0]) if value else {}
        return {"type": "array", "items": items} if items.get("type", "array") != "array" else {}
    return {"type": _TYPES[type(value)]} if type(value) in _TYPES else {}


def _plain(value: Any) -> Any:
    if isinstance(value, bytes | bytearray | memoryview):
        return base64.b64encode(value).decode()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, int):
        # beyond 64 bits
        return str(value)
    if hasattr(value, "__iter__"):
        return list(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")
