"""The faults of ``faults.py``, made in the messages of a sound log."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.message import Message
from replay_kit.measurements.checks import causes, instrument, place, profile, sensors
from replay_kit.measurements.profiles.frames import teledyne_rotation
from replay_kit.measurements.track.reach import DISPLACED

Edit = Callable[[Iterator[Message]], Iterator[Message]]


def _turn(*angles: float) -> np.ndarray:
    """Return the matrix of Teledyne's axes for heading, pitch and roll [degrees]."""
    heading, pitch, roll = (np.array([angle]) for angle in angles)
    return teledyne_rotation(heading, pitch, roll, False, np.zeros(1, bool))[0]


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


class At(NamedTuple):
    """Which of the edited messages one is, from 0; hours since the first; draws of the log."""

    number: int
    hours: float
    rng: np.random.Generator


Change = Callable[[dict[str, Any], At], dict[str, Any]]


def _edited(applies: Callable[[Message], bool], change: Change) -> Edit:
    """Return a fault of some messages: ``change`` gives the fields that become others."""

    def edit(messages: Iterator[Message]) -> Iterator[Message]:
        rng, number, start_ns = np.random.default_rng(0), 0, None
        for message in messages:
            if applies(message):
                start_ns = message.time_ns if start_ns is None else start_ns
                at = At(number, (message.time_ns - start_ns) / 3.6e12, rng)
                number += 1
                message = message._replace(
                    payload={**message.payload, **change(message.payload, at)}
                )
            yield message

    return edit


def _having(*names: str) -> Callable[[Message], bool]:
    return lambda message: all(name in message.payload for name in names)


def _fields(**changes: Callable[[Any], Any]) -> Edit:
    return _edited(_is_ping, lambda payload, at: {n: of(payload[n]) for n, of in changes.items()})


def _scaled(name: str, factor: float) -> Edit:
    return _fields(**{name: lambda value: value * factor})


def _cells(change: Callable[[list[Any], At], list[Any]]) -> Edit:
    """Return a fault of the cells of pings that have a value."""

    def changed(payload: dict[str, Any], at: At) -> dict[str, Any]:
        cells = payload["velocity"]
        return {"velocity": [c if c is None or None in c[:2] else change(c, at) for c in cells]}

    return _edited(_is_ping, changed)


def _turned(matrix: Any, *pair: Any) -> list[float]:
    return (np.array(matrix, np.float64) @ pair).tolist()


def _velocity(matrix: Any) -> Edit:
    cells = _cells(lambda c, at: [*_turned(matrix, *c[:2]), *c[2:]])

    def moved(payload: dict[str, Any], at: At) -> dict[str, Any]:
        platform = payload.get("platform_velocity")
        if not isinstance(platform, Mapping):
            return {}
        east, north = _turned(matrix, platform["east"], platform["north"])
        return {"platform_velocity": {**platform, "east": east, "north": north}}

    platforms = _edited(_is_ping, moved)
    return lambda messages: platforms(cells(messages))


def _mean_current(matrix: Any) -> Edit:
    names = "dac_eastward", "dac_northward"
    return _edited(
        _having(*names),
        lambda payload, at: dict(
            zip(names, _turned(matrix, *(payload[name] for name in names)), strict=True)
        ),
    )


def _added(velocity: Callable[[float], float]) -> Edit:
    """Return a fault that adds to the eastward velocity what a function gives for the hours since the first ping."""
    return _cells(lambda c, at: [c[0] + velocity(at.hours), *c[1:]])


def _stuck(begun: Callable[[At], bool], noise: float = 0.0) -> Edit:
    """Return a fault of an instrument that repeats a ping, with noise, from some on."""
    kept: list[Any] = []

    def change(payload: dict[str, Any], at: At) -> dict[str, Any]:
        if not begun(at):
            kept[:] = payload["velocity"]
            return {}
        draw = at.rng.standard_normal
        cells = [[one if one is None else one + noise * draw() for one in c] for c in kept]
        return {"velocity": cells}

    return _edited(_is_ping, change)


def _stuck_cells(payload: dict[str, Any], at: At) -> dict[str, Any]:
    cells = payload["velocity"]
    return {
        "velocity": [c if k < len(cells) // 2 else [0.3, -0.2, *c[2:]] for k, c in enumerate(cells)]
    }


def _frozen() -> Edit:
    first: dict[str, Any] = {}

    def change(payload: dict[str, Any], at: At) -> dict[str, Any]:
        if not at.number:
            first.update({name: payload[name] for name in ("latitude", "longitude")})
        return first

    return _edited(_having("latitude", "longitude"), change)


def _depth_sign(payload: dict[str, Any], at: At) -> dict[str, Any]:
    first, size, n = -payload["bin0_distance"], payload["cell_size"], payload["n_cells"]
    distances = [first - size * k for k in range(n)]
    return {"bin0_distance": first, "cell_distances": distances, "pressure": -payload["pressure"]}


def _stuck_vehicle(payload: dict[str, Any], at: At) -> dict[str, Any]:
    fields = payload["metadata"]
    return {
        "metadata": [{**one, "value": "120.0"} if one["key"] == "depth" else one for one in fields]
    }


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


def _twice(messages: Iterator[Message]) -> Iterator[Message]:
    for message in messages:
        yield message
        yield message


def _moved(payload: dict[str, Any], east: float, north: float) -> dict[str, Any]:
    here = Projection(payload["longitude"], payload["latitude"])
    longitude, latitude = to_geographic(here, east, north)
    return {"longitude": float(longitude), "latitude": float(latitude)}


def _displaced(payload: dict[str, Any], at: At) -> dict[str, Any]:
    """Every fifth fix is 1 to 50 km off, in any direction."""
    if at.number % 5 < 4:
        return {}
    far, angle = 1e3 * 50.0 ** at.rng.uniform(), at.rng.uniform(0.0, 2.0 * np.pi)
    return _moved(payload, far * np.cos(angle), far * np.sin(angle))


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
            turn = _turn(payload["heading"], pitch, roll)
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


_SWAP = [[0, 1], [1, 0]]
_EAST = [[-1, 0], [0, 1]]
_NORTH = [[1, 0], [0, -1]]
_BOTH = [[-1, 0], [0, -1]]
_GLIDER, _IN_BEAMS = ("glider",), ("beams",)
_TWINS, _RELATIVE = ("vessel", "glider"), ("glider", "seaglider")
_DIRECTION = (causes.CONTRADICTION, causes.COMPASS)
_FAULTS: dict[tuple[tuple[str, ...], int], dict[tuple[str, ...], dict[str, Edit]]] = {
    ((instrument.DEAD,), 16): {
        _TWINS: {
            "all zero": _cells(lambda c, at: [0.0, 0.0, *c[2:]]),
            "constant": _cells(lambda c, at: [0.123, -0.123, *c[2:]]),
        }
    },
    ((instrument.DEAD,), 27): {_TWINS: {"stale from ping 11": _stuck(lambda at: at.number > 10)}},
    ((instrument.DEAD,), 76): {
        _TWINS: {"stuck with noise from hour 10": _stuck(lambda at: at.hours >= 10.0, 0.02)}
    },
    (_DIRECTION, 68): {
        _RELATIVE: {
            "profiles: east and north exchanged": _velocity(_SWAP),
            "profiles: sign of east": _velocity(_EAST),
            "profiles: sign of north": _velocity(_NORTH),
            "profiles: both signs": _velocity(_BOTH),
        },
        _GLIDER: {
            "mean currents: east and north exchanged": _mean_current(_SWAP),
            "mean currents: both signs": _mean_current(_BOTH),
        },
        _IN_BEAMS: {
            "beams 1 and 2 exchanged": _cells(lambda c, at: [c[1], c[0], *c[2:]]),
            "declination of 25 degrees twice": _fields(heading=lambda h: h + _DECLINATION),
            "sign of roll": _fields(roll=lambda r: -r),
            "heading in radians": _fields(heading=lambda h: float(np.radians(h % 360.0))),
        },
    },
    ((profile.UNIT,), 30): {
        _TWINS: {"cm/s": _velocity(100.0 * np.eye(2)), "mm/s": _velocity(1000.0 * np.eye(2))}
    },
    ((causes.SCALE,), 101): {_GLIDER: {"knots": _velocity(1.943844 * np.eye(2))}},
    ((causes.SCALE,), 85): {
        _GLIDER: {"km/h": _velocity(3.6 * np.eye(2)), "ft/s": _velocity(np.eye(2) / 0.3048)}
    },
    ((profile.SURFACE,), 5): {
        _TWINS: {
            "sign of depth": _edited(_is_ping, _depth_sign),
            "up for down": _fields(orientation=lambda _: "up"),
        }
    },
    ((causes.OFFSET,), 85): {_GLIDER: {"profiles: 0.3 m/s east": _added(lambda hours: 0.3)}},
    ((causes.DRIFT,), 85): {
        _GLIDER: {"profiles: drift 0.02 m/s an hour": _added(lambda hours: 0.02 * hours)}
    },
    ((sensors.DEPTHS,), 20): {
        _GLIDER: {
            "pressure x 0.1": _scaled("pressure", 0.1),
            "pressure x 10": _scaled("pressure", 10.0),
            "depth of pings in feet": _scaled("pressure", 1.0 / 0.3048),
            "depth of pings stuck": _fields(pressure=lambda _: 120.0),
            "depth of the vehicle stuck": _edited(_having("latitude", "metadata"), _stuck_vehicle),
        }
    },
    ((sensors.CLOCK,), 50): {
        (own,): {
            f"clock of a {own} {name} ahead": _late(seconds)
            for name, seconds in (("18 s", 18), ("2 min", 120), ("1 h", 3600), ("12 h", 43_200))
        }
        for own in _TWINS
    },
    ((instrument.DUPLICATES,), 20): {_TWINS: {"every message twice": _twice}},
    ((causes.SCALE,), 120): {
        _GLIDER: {
            **{f"profiles x {factor}": _velocity(factor * np.eye(2)) for factor in (0.5, 0.7, 1.3)},
            **{
                f"mean currents x {factor}": _mean_current(factor * np.eye(2))
                for factor in (0.7, 1.3)
            },
        }
    },
    ((instrument.STUCK,), 30): {
        _TWINS: {"cells of the lower half stuck": _edited(_is_ping, _stuck_cells)}
    },
    ((causes.SCALE, causes.MEANS), 85): {
        _GLIDER: {
            f"mean currents x {factor}": _mean_current(factor * np.eye(2))
            for factor in (0.0, 0.5, 1.94, 100.0)
        }
    },
    ((profile.ERRORS,), 30): {
        _TWINS: {
            "stated errors x 100": _scaled("velocity_std", 100.0),
            "stated errors / 10": _scaled("velocity_std", 0.1),
        }
    },
    ((DISPLACED,), 85): {
        _GLIDER: {
            "one fix in five 1 to 50 km off": _edited(
                lambda m: "latitude" in m.payload and m.topic == "/vehicle/fix", _displaced
            ),
            "the twentieth position 42 km off": _edited(
                _having("latitude"), lambda p, at: _moved(p, 42e3, 0.0) if at.number == 20 else {}
            ),
        }
    },
    ((DISPLACED,), 135): {
        _GLIDER: {
            "positions 30 km off from hour 20": _edited(
                _having("latitude"), lambda p, at: _moved(p, 30e3, 0.0) if at.hours >= 20.0 else {}
            )
        }
    },
    ((instrument.BEAM,), 68): {
        _IN_BEAMS: {"beams 1 and 3 exchanged": _cells(lambda c, at: [c[2], c[1], c[0], c[3]])}
    },
    ((instrument.BEAM,), 30): {
        _IN_BEAMS: {
            "a beam of noise": _cells(lambda c, at: [c[0] + at.rng.standard_normal(), *c[1:]]),
            "a beam at zero": _cells(lambda c, at: [c[0], 0.0, *c[2:]]),
        }
    },
    ((place.FROZEN,), 5): {_GLIDER: {"frozen positions": _frozen()}},
}
FAULTS = (
    *(
        Fault(name, edit, expected, vehicles, asked)
        for (expected, asked), by_vehicle in _FAULTS.items()
        for vehicles, edits in by_vehicle.items()
        for name, edit in edits.items()
    ),
    *(
        Fault(f"heading off by {turn} degrees", iter, _DIRECTION, _TWINS, 18, turn)
        for turn in (25, 30, 60, 90, 180)
    ),
    Fault("heading off by 60 degrees from hour 20", iter, _DIRECTION, _TWINS, 154, 60, 20.0),
)
