"""The faults of ``faults.py``, made in the messages of a sound log."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.message import Message
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.ping.frames import teledyne_rotation

Edit = Callable[[Iterator[Message]], Iterator[Message]]


@dataclass(frozen=True)
class Fault:
    """A fault, and what may be found of it.

    Attributes:
        name: Of the fault.
        edit: Makes it.
        expected: Names of findings, any of which counts.
        vehicles: Of the logs in which something can tell.
        asked: Number of pings, of which twice as many are asked for.
        heading: Of the compass, where the twin makes the fault [degrees].
        from_hour: When the heading becomes wrong [h since the first message].
    """

    name: str
    edit: Edit
    expected: tuple[str, ...]
    vehicles: tuple[str, ...]
    asked: int
    heading: int = 0
    from_hour: float = 0.0


def _is_ping(message: Message) -> bool:
    return "velocity" in message.payload and "n_cells" in message.payload


def _pings(change: Callable[[dict[str, Any], int], None]) -> Edit:
    """Return a fault of pings: ``change`` alters a copy of a payload, given the ping's number."""

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        number = 0
        for message in messages:
            if _is_ping(message):
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


def _added(velocity: Callable[[float], float]) -> Edit:
    """Return a fault that adds to the eastward velocity what a function gives for the hours since the first ping."""

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        start_ns = None
        for message in messages:
            if _is_ping(message):
                start_ns = message.time_ns if start_ns is None else start_ns
                more = velocity((message.time_ns - start_ns) / 3.6e12)
                cells = [
                    cell if cell is None or cell[0] is None else [cell[0] + more, *cell[1:]]
                    for cell in message.payload["velocity"]
                ]
                message = message._replace(payload={**message.payload, "velocity": cells})
            yield message

    return edit


def _scaled(name: str, factor: float) -> Edit:
    def change(payload: dict[str, Any], number: int) -> None:
        payload[name] = payload[name] * factor

    return _pings(change)


def _stuck_pressure(payload: dict[str, Any], number: int) -> None:
    payload["pressure"] = 120.0


def _stuck_vehicle(messages: Iterator[Message]) -> Iterator[Message]:
    for message in messages:
        if "latitude" in message.payload and "metadata" in message.payload:
            fields = [
                {**field, "value": "120.0"} if field["key"] == "depth" else field
                for field in message.payload["metadata"]
            ]
            message = message._replace(payload={**message.payload, "metadata": fields})
        yield message


def _late(seconds: float) -> Edit:
    """Return a clock of the instrument that is ahead."""

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        late_ns = int(seconds * 1e9)
        moved = [
            message._replace(time_ns=message.time_ns + late_ns) if _is_ping(message) else message
            for message in messages
        ]
        yield from sorted(moved, key=lambda message: message.time_ns)

    return edit


def _stuck_with_noise(messages: Iterator[Message]) -> Iterator[Message]:
    rng, start_ns, kept = np.random.default_rng(0), None, []
    for message in messages:
        if _is_ping(message):
            start_ns = message.time_ns if start_ns is None else start_ns
            if message.time_ns - start_ns < 10 * 3.6e12:
                kept = message.payload["velocity"]
            else:
                cells = [
                    [one if one is None else one + 0.02 * rng.standard_normal() for one in cell]
                    for cell in kept
                ]
                message = message._replace(payload={**message.payload, "velocity": cells})
        yield message


def _twice(messages: Iterator[Message]) -> Iterator[Message]:
    for message in messages:
        yield message
        yield message


def _displaced(messages: Iterator[Message]) -> Iterator[Message]:
    """Every fifth fix is 1 to 50 km off, in any direction."""
    rng, number = np.random.default_rng(0), 0
    for message in messages:
        if "latitude" in message.payload and message.topic == "/vehicle/fix":
            number += 1
            if number % 5 == 0:
                far, angle = 1e3 * 50.0 ** rng.uniform(), rng.uniform(0.0, 2.0 * np.pi)
                message = _moved(message, far * np.cos(angle), far * np.sin(angle))
        yield message


def _moved(message: Message, east: float, north: float) -> Message:
    here = Projection(message.payload["longitude"], message.payload["latitude"])
    longitude, latitude = to_geographic(here, east, north)
    place = {"longitude": float(longitude), "latitude": float(latitude)}
    return message._replace(payload={**message.payload, **place})


def _moved_later(messages: Iterator[Message]) -> Iterator[Message]:
    """All positions are 30 km off from hour 20 on."""
    start_ns = None
    for message in messages:
        start_ns = message.time_ns if start_ns is None else start_ns
        if "latitude" in message.payload and message.time_ns - start_ns >= 20 * 3.6e12:
            message = _moved(message, 30e3, 0.0)
        yield message


_TILT, _DECLINATION, _ROLL = np.radians(25.0), 25.0, 8.0
_BEAMS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]) * np.sin(_TILT)
_VECTORS = np.column_stack([-_BEAMS, np.full(4, np.cos(_TILT))])


def in_beams(messages: Iterator[Message]) -> Iterator[Message]:
    """Yield messages with pings in beam coordinates, of a magnetic compass, on a vehicle that rolls."""
    for number, message in enumerate(messages):
        if _is_ping(message):
            payload = message.payload
            heading, pitch = payload["heading"] - _DECLINATION, payload["pitch"]
            roll = _ROLL * np.sin(number)
            turn = teledyne_rotation(payload["heading"], pitch, roll)
            up = -0.1 * np.sign(pitch)
            cells = [
                [None] * 4
                if cell[0] is None
                else (_VECTORS @ turn.T @ np.array([cell[0], cell[1], up])).tolist()
                for cell in payload["velocity"]
            ]
            more = {
                "coordinate_system": "beam",
                "attitude_convention": "teledyne",
                "beam_unit_vectors": _VECTORS.tolist(),
                "velocity": cells,
                "heading": heading,
                "roll": roll,
                "magnetic_declination": _DECLINATION,
                "declination_applied": False,
                "velocity_std": 0.4 * payload["velocity_std"],
            }
            message = message._replace(payload={**payload, **more})
        yield message


def _beams(change: Callable[[list[float], np.random.Generator], list[float]]) -> Edit:
    rng = np.random.default_rng(0)
    return _values(lambda number, cells: [c if c[0] is None else change(c, rng) for c in cells])


def _attitude(**changes: Callable[[float], float]) -> Edit:
    def change(payload: dict[str, Any], number: int) -> None:
        payload |= {name: of(payload[name]) for name, of in changes.items()}

    return _pings(change)


_SWAP, _EAST, _NORTH, _BOTH = (
    [[0, 1], [1, 0]],
    [[-1, 0], [0, 1]],
    [[1, 0], [0, -1]],
    [[-1, 0], [0, -1]],
)
_GLIDER, _IN_BEAMS = ("glider",), ("beams",)
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
    Fault("profiles: 0.3 m/s east", _added(lambda hours: 0.3), (findings.OFFSET,), _GLIDER, 85),
    Fault(
        "profiles: drift 0.02 m/s an hour",
        _added(lambda h: 0.02 * h),
        (findings.DRIFT,),
        _GLIDER,
        85,
    ),
    Fault("km/h", _velocity(3.6 * np.eye(2)), (findings.SCALE,), _GLIDER, 85),
    Fault("ft/s", _velocity(np.eye(2) / 0.3048), (findings.SCALE,), _GLIDER, 85),
    Fault("pressure x 0.1", _scaled("pressure", 0.1), (findings.DEPTHS,), _GLIDER, 20),
    Fault("pressure x 10", _scaled("pressure", 10.0), (findings.DEPTHS,), _GLIDER, 20),
    Fault(
        "depth of pings in feet", _scaled("pressure", 1.0 / 0.3048), (findings.DEPTHS,), _GLIDER, 20
    ),
    Fault("depth of pings stuck", _pings(_stuck_pressure), (findings.DEPTHS,), _GLIDER, 20),
    Fault("depth of the vehicle stuck", _stuck_vehicle, (findings.DEPTHS,), _GLIDER, 20),
    *(
        Fault(f"clock of a {own} {name} ahead", _late(seconds), (findings.CLOCK,), (own,), 50)
        for own in ("glider", "vessel")
        for name, seconds in (("18 s", 18.0), ("2 min", 120.0), ("1 h", 3600.0), ("12 h", 43_200.0))
    ),
    Fault("heading off by 60 degrees from hour 20", _same, _DIRECTION, _TWINS, 154, 60, 20.0),
    Fault("stuck with noise from hour 10", _stuck_with_noise, (findings.DEAD,), _TWINS, 76),
    Fault("every message twice", _twice, (findings.DUPLICATES,), _TWINS, 20),
    *(
        Fault(
            f"mean currents x {factor}",
            _mean_current(factor * np.eye(2)),
            (findings.SCALE, findings.MEANS),
            _GLIDER,
            85,
        )
        for factor in (0.0, 0.5, 1.94, 100.0)
    ),
    Fault("stated errors x 100", _scaled("velocity_std", 100.0), (findings.ERRORS,), _TWINS, 30),
    Fault("stated errors / 10", _scaled("velocity_std", 0.1), (findings.ERRORS,), _TWINS, 30),
    Fault("one fix in five 1 to 50 km off", _displaced, (findings.DISPLACED,), _GLIDER, 85),
    Fault("positions 30 km off from hour 20", _moved_later, (findings.DISPLACED,), _GLIDER, 135),
    Fault(
        "beams 1 and 2 exchanged",
        _beams(lambda c, rng: [c[1], c[0], *c[2:]]),
        _DIRECTION,
        _IN_BEAMS,
        68,
    ),
    Fault(
        "beams 1 and 3 exchanged",
        _beams(lambda c, rng: [c[2], c[1], c[0], c[3]]),
        (findings.BEAM,),
        _IN_BEAMS,
        68,
    ),
    Fault(
        "a beam of noise",
        _beams(lambda c, rng: [c[0] + rng.standard_normal(), *c[1:]]),
        (findings.BEAM,),
        _IN_BEAMS,
        30,
    ),
    Fault(
        "a beam at zero",
        _beams(lambda c, rng: [c[0], 0.0, *c[2:]]),
        (findings.BEAM,),
        _IN_BEAMS,
        30,
    ),
    Fault(
        "declination of 25 degrees twice",
        _attitude(heading=lambda h: h + _DECLINATION),
        _DIRECTION,
        _IN_BEAMS,
        68,
    ),
    Fault("sign of roll", _attitude(roll=lambda r: -r), _DIRECTION, _IN_BEAMS, 68),
    Fault(
        "heading in radians",
        _attitude(heading=lambda h: float(np.radians(h % 360.0))),
        _DIRECTION,
        _IN_BEAMS,
        68,
    ),
    Fault("frozen positions", _frozen, (findings.FROZEN,), ("glider",), 5),
)
