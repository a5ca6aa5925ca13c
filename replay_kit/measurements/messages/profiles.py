"""Current profiles in other packages' messages, rewritten as the payload of a ``replay_kit.AdcpPing``.

What a message does not state stays out: ``reference`` above all, which the configuration may give. Definitions read:
``ds_sensor_msgs/Adcp`` (Field-Robotics-Lab/ds_msgs), the Nortek Nucleus driver's ``CurrentProfile`` (NortekSupport/nucleus_driver),
``CurrentProfile`` of IMC (LSTS/imc, messages 1014 to 1016).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from replay_kit.core.observation import RawValues
from replay_kit.measurements.messages.adcp_ping import COORDINATE_SYSTEMS
from replay_kit.measurements.messages.fields import number, whole_number
from replay_kit.measurements.messages.vehicle import Position, checked
from replay_kit.measurements.ping.adcp_ping import AdcpPing

_NUCLEUS_BEAMS = 3
_MM_PER_M = 1000.0
_INT16_MISSING = -32768
_UINT16_WHOLE_METRES = (
    "cell_depth is 0: this message holds whole metres only, so that the size of cells below 1 m is lost; "
    "state it with a [[measurements.map]] entry for the topic"
)
# of the coordinate systems of IMC: by number and by name, ours, and where in a cell east, north and up are, with their signs
_ENU, _NED = ((0, 1.0), (1, 1.0), (2, 1.0)), ((1, 1.0), (0, 1.0), (2, -1.0))
_IMC_SYSTEMS = {1: "XYZ", 2: "NED", 4: "BEAMS", 8: "ENU"}
_IMC_COORDINATES = {
    "XYZ": ("instrument", None),
    "BEAMS": ("beam", None),
    "NED": ("earth", _NED),
    "ENU": ("earth", _ENU),
}


@dataclass(frozen=True, slots=True)
class StatedPing:
    """A profile of the current.

    Attributes:
        payload: Fields of a ``replay_kit.AdcpPing``.
        position: Where the vehicle was, when the same message says so.
        place: Where a mooring or a drifter measured, which tells nothing of the vehicle; None of a vehicle's own profile.
        read: The ping and what is remembered of its velocities, or why it cannot be used; None before the payload was read.
    """

    payload: Mapping[str, Any]
    position: Position | None = None
    place: Position | None = None
    read: tuple[AdcpPing, RawValues] | str | None = None


def adcp_ping(payload: Mapping[str, Any]) -> StatedPing | str:
    """Return our own ping as it is; with ``place``, which tells nothing of a vehicle, or why that is no place, or holds no profile."""
    if payload.get("n_cells") == 0 and payload.get("bottom_track"):
        return "bottom track alone: how the vehicle moves, and no current"
    if not isinstance(stated := payload.get("place"), Mapping):
        return StatedPing(payload)
    place = checked(stated.get("lon"), stated.get("lat"), 0.0, False)
    return place if isinstance(place, str) else StatedPing(payload, place=place)


def ds_adcp(payload: Mapping[str, Any]) -> StatedPing | str:
    """Return the profile of a ``ds_sensor_msgs/Adcp``, or why there is none.

    A cell holds one vector, or in beam coordinates one vector along each beam; zeros mean no solution. The message does not say
    what the velocities are relative to, nor whether the instrument looks up: down is taken, as a DVL's water track does.
    """
    mode, cells = whole_number(payload.get("coordinate_mode")), payload["vel_bin_beams"]
    if mode is None or not 0 <= mode < len(COORDINATE_SYSTEMS):
        return "coordinate_mode is none of 0 (beam), 1 (instrument), 2 (ship), 3 (earth)"
    cell_size = number(payload.get("cell_depth"))
    if cell_size == 0.0:
        return _UINT16_WHOLE_METRES
    directions = [_vector(unit) for unit in payload["beam_unit_vec"]]
    read = _along_beams if COORDINATE_SYSTEMS[mode] == "beam" else _first_vector
    return StatedPing(
        {
            "coordinate_system": COORDINATE_SYSTEMS[mode],
            "orientation": "down",
            "n_cells": len(cells),
            "cell_size": cell_size,
            "bin0_distance": payload.get("bin0_distance"),
            "beam_unit_vectors": directions,
            "velocity": [
                read([_vector(item) for item in cell["velocity_bin_beam"]], directions)
                for cell in cells
            ],
        }
    )


def current_profile(payload: Mapping[str, Any]) -> StatedPing | str:
    """Return the profile of a ``CurrentProfile``, of Nortek's Nucleus or of IMC by what it holds, or why there is none."""
    if "velocity_data" in payload:
        return _nucleus(payload)
    if isinstance(payload.get("profile"), list | tuple):
        return _imc(payload)
    return "CurrentProfile has neither velocity_data (Nortek Nucleus) nor profile (IMC)"


def _nucleus(payload: Mapping[str, Any]) -> StatedPing | str:
    """Return the profile of a Nucleus: int16 [mm/s] along three beams, cell after cell, -32768 for none.

    Its pressure is left out, because the message does not state the unit; the vehicle's depth is used.
    """
    n, flat = whole_number(payload.get("number_of_cells")), list(payload["velocity_data"])
    if n is None or n * _NUCLEUS_BEAMS != len(flat):
        return "velocity_data does not hold three beams for each of number_of_cells"
    values = [None if value == _INT16_MISSING else number(value) / _MM_PER_M for value in flat]
    cell_size = number(payload.get("cell_size"))
    return StatedPing(
        {
            "coordinate_system": "beam",
            "reference": "platform",
            "orientation": "down",
            "n_cells": n,
            "cell_size": cell_size,
            # blanking ends where the first cell begins
            "bin0_distance": number(payload.get("blanking")) + 0.5 * cell_size,
            "velocity": [
                values[i : i + _NUCLEUS_BEAMS] for i in range(0, len(values), _NUCLEUS_BEAMS)
            ],
            "amplitude": _rows(payload.get("amplitude_data"), _NUCLEUS_BEAMS),
            "correlation": _rows(payload.get("correlation_data"), _NUCLEUS_BEAMS),
            "sound_speed": payload.get("sound_velocity"),
            "temperature": payload.get("temperature"),
        }
    )


def _imc(payload: Mapping[str, Any]) -> StatedPing | str:
    """Return the profile of an IMC message in JSON: velocities relative to the vehicle, cells at stated distances."""
    code = payload.get("coord_sys")
    name = _IMC_SYSTEMS.get(whole_number(code) or 0, str(code).upper())
    if name not in _IMC_COORDINATES:
        return "coord_sys is none of XYZ, NED, BEAMS, ENU"
    system, axes = _IMC_COORDINATES[name]
    cells = [[number(beam.get("vel")) for beam in cell["beams"]] for cell in payload["profile"]]
    if axes is not None:
        if any(len(cell) < len(axes) for cell in cells):
            return f"fewer than three components in a cell of {name} coordinates"
        cells = [[sign * cell[at] for at, sign in axes] for cell in cells]
    return StatedPing(
        {
            "coordinate_system": system,
            "reference": "platform",
            "orientation": "down",
            "n_cells": len(cells),
            "cell_distances": [
                abs(number(cell.get("cell_position"))) for cell in payload["profile"]
            ],
            "velocity": cells,
            "amplitude": [
                [beam.get("amp") for beam in cell["beams"]] for cell in payload["profile"]
            ],
            "correlation": [
                [beam.get("cor") for beam in cell["beams"]] for cell in payload["profile"]
            ],
        }
    )


def _vector(value: Mapping[str, Any]) -> tuple[float, float, float]:
    return number(value.get("x")), number(value.get("y")), number(value.get("z"))


def _first_vector(
    vectors: list[tuple[float, float, float]], _: list[tuple[float, float, float]]
) -> list[float | None]:
    """Return a cell's only vector; zeros are no solution."""
    return list(vectors[0]) if vectors and any(vectors[0]) else [None, None, None]


def _along_beams(
    vectors: list[tuple[float, float, float]], directions: list[tuple[float, float, float]]
) -> list[float | None]:
    """Return the velocity along each beam; zeros are no solution."""
    pairs = zip(vectors, directions, strict=True)
    return [
        sum(v * d for v, d in zip(vector, unit, strict=True)) if any(vector) else None
        for vector, unit in pairs
    ]


def _rows(values: Any, width: int) -> list[list[Any]] | None:
    """Return a flat list cut into rows; None for what is no list."""
    return (
        [list(values[i : i + width]) for i in range(0, len(values), width)]
        if isinstance(values, list | tuple | bytes)
        else None
    )
