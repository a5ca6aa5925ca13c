"""The faults of ``faults.py``, made in the messages of a sound log."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.core.message import Message
from replay_kit.measurements.consistency import findings

Edit = Callable[[Iterator[Message]], Iterator[Message]]


@dataclass(frozen=True)
class Fault:
    """A fault, and what may be found of it.

    Attributes:
        name: Of the fault.
        edit: Makes it.
        expected: Names of findings, any of which counts.
        vehicles: Of the logs in which something can tell.
        heading: Of the compass, where the twin makes the fault [degrees].
        asked: Number of pings, of which twice as many are asked for.
    """

    name: str
    edit: Edit
    expected: tuple[str, ...]
    vehicles: tuple[str, ...]
    asked: int
    heading: int = 0


def _pings(change: Callable[[dict[str, Any], int], None]) -> Edit:
    """Return a fault of pings: ``change`` alters a copy of a payload, given the ping's number."""

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        number = 0
        for message in messages:
            if "velocity" in message.payload and "n_cells" in message.payload:
                payload = dict(message.payload)
                change(payload, number)
                number += 1
                message = message._replace(payload=payload)
            yield message

    return edit


def _velocity(matrix: Any) -> Edit:
    turn = np.array(matrix, np.float64)

    def change(payload: dict[str, Any], number: int) -> None:
        payload["velocity"] = [
            cell
            if cell is None or cell[0] is None or cell[1] is None
            else [*(turn @ np.array(cell[:2])).tolist(), *cell[2:]]
            for cell in payload["velocity"]
        ]
        if isinstance(payload.get("platform_velocity"), Mapping):
            moved = payload["platform_velocity"]
            east, north = (turn @ np.array([moved["east"], moved["north"]])).tolist()
            payload["platform_velocity"] = {**moved, "east": east, "north": north}

    return _pings(change)


def _values(value: Callable[[int, list[Any]], list[Any]]) -> Edit:
    def change(payload: dict[str, Any], number: int) -> None:
        payload["velocity"] = value(number, payload["velocity"])

    return _pings(change)


def _stale() -> Edit:
    kept: list[Any] = []

    def value(number: int, cells: list[Any]) -> list[Any]:
        if number <= 10:
            kept[:] = cells
        return list(kept)

    return _values(value)


def _constant(cells: list[Any], value: float) -> list[Any]:
    return [
        None if cell is None or cell[0] is None else [value, -value, *cell[2:]] for cell in cells
    ]


def _mean_current(matrix: Any) -> Edit:
    turn = np.array(matrix, np.float64)

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        for message in messages:
            if "dac_eastward" in message.payload:
                east, north = (
                    turn
                    @ np.array([message.payload["dac_eastward"], message.payload["dac_northward"]])
                ).tolist()
                message = message._replace(
                    payload={**message.payload, "dac_eastward": east, "dac_northward": north}
                )
            yield message

    return edit


def _frozen(messages: Iterator[Message]) -> Iterator[Message]:
    place: dict[str, Any] = {}
    for message in messages:
        if "latitude" in message.payload and "longitude" in message.payload:
            place = place or {name: message.payload[name] for name in ("latitude", "longitude")}
            message = message._replace(payload={**message.payload, **place})
        yield message


def _depth_sign(payload: dict[str, Any], number: int) -> None:
    payload["bin0_distance"], payload["cell_distances"] = -payload["bin0_distance"], None
    n, size = payload["n_cells"], payload["cell_size"]
    payload["cell_distances"] = [payload["bin0_distance"] - size * k for k in range(n)]
    payload["pressure"] = -payload["pressure"]


def _up(payload: dict[str, Any], number: int) -> None:
    payload["orientation"] = "up"


def _same(messages: Iterator[Message]) -> Iterator[Message]:
    return messages


_SWAP, _EAST, _NORTH, _BOTH = (
    [[0, 1], [1, 0]],
    [[-1, 0], [0, 1]],
    [[1, 0], [0, -1]],
    [[-1, 0], [0, -1]],
)
_TWINS, _RELATIVE, _DIRECTION = (
    ("vessel", "glider"),
    ("glider", "seaglider"),
    (findings.CONTRADICTION, findings.COMPASS),
)
FAULTS = (
    Fault(
        "all zero",
        _values(lambda number, cells: _constant(cells, 0.0)),
        (findings.DEAD,),
        _TWINS,
        16,
    ),
    Fault(
        "constant",
        _values(lambda number, cells: _constant(cells, 0.123)),
        (findings.DEAD,),
        _TWINS,
        16,
    ),
    Fault("stale from ping 11", _stale(), (findings.DEAD,), _TWINS, 27),
    Fault("heading off by 30 degrees", _same, _DIRECTION, _TWINS, 18, 30),
    Fault("heading off by 90 degrees", _same, _DIRECTION, _TWINS, 18, 90),
    Fault("heading off by 180 degrees", _same, _DIRECTION, _TWINS, 18, 180),
    Fault("profiles: east and north exchanged", _velocity(_SWAP), _DIRECTION, _RELATIVE, 68),
    Fault("profiles: sign of east", _velocity(_EAST), _DIRECTION, _RELATIVE, 68),
    Fault("profiles: sign of north", _velocity(_NORTH), _DIRECTION, _RELATIVE, 68),
    Fault("profiles: both signs", _velocity(_BOTH), _DIRECTION, _RELATIVE, 68),
    Fault(
        "mean currents: east and north exchanged", _mean_current(_SWAP), _DIRECTION, ("glider",), 68
    ),
    Fault("mean currents: both signs", _mean_current(_BOTH), _DIRECTION, ("glider",), 68),
    Fault("cm/s", _velocity(100.0 * np.eye(2)), (findings.UNIT,), _TWINS, 30),
    Fault("mm/s", _velocity(1000.0 * np.eye(2)), (findings.UNIT,), _TWINS, 30),
    Fault("knots", _velocity(1.943844 * np.eye(2)), (findings.SCALE,), ("glider",), 101),
    Fault("sign of depth", _pings(_depth_sign), (findings.DEPTH,), _TWINS, 5),
    Fault("up for down", _pings(_up), (findings.DEPTH,), _TWINS, 5),
    Fault("frozen positions", _frozen, (findings.FROZEN,), ("glider",), 5),
)
