"""One ADCP ping (``replay_kit.AdcpPing``) to a profile of the current.

The field names and units of a ping are in ``replay_kit/README.md``. Flags and reasons are set here; nothing is deleted.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gsw
import numpy as np
from numpy.typing import NDArray

from replay_kit.errors import MeasurementError
from replay_kit.types import Array, Flag, Reason, Reference

COORDINATE_SYSTEMS = ("beam", "instrument", "ship", "earth")
REFERENCES: tuple[Reference, ...] = ("earth", "platform")
ORIENTATIONS = ("down", "up")


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """A ping's bins, before its position is known.

    Attributes:
        depth: shape (n,) [m], positive down.
        velocity: shape (n, 2) [m/s], true east and north; NaN where missing.
        error_std: shape (n,) [m/s].
        reference: What the velocity is relative to.
        flags: shape (n,), QARTOD flags.
        reasons: shape (n,), bit mask of ``Reason``.
    """

    depth: Array
    velocity: Array
    error_std: Array
    reference: Reference
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]


def depth_of_pressure(pressure_dbar: float, latitude: float) -> float:
    """Return the depth [m] at a sea pressure [dbar] (TEOS-10, through gsw)."""
    return float(-gsw.z_from_p(pressure_dbar, latitude))


def number(value: Any) -> float:
    """Return a payload's number; None, strings such as "NaN" and anything infinite become NaN."""
    try:
        result = float("nan") if value is None else float(value)
    except (TypeError, ValueError):
        return float("nan")
    return result if np.isfinite(result) else float("nan")


def why_not_used(payload: Mapping[str, Any]) -> tuple[str, Reason] | None:
    """Return why a ping cannot be used as an absolute profile, in words and as a reason; None when it can.

    Raises:
        MeasurementError: ``reference`` or ``coordinate_system`` is missing or not one of the known words.
    """
    coordinate_system = _word(payload, "coordinate_system", COORDINATE_SYSTEMS)
    if _word(payload, "reference", REFERENCES) == "platform":
        return "velocity relative to the platform, whose own motion is not known", Reason.PLATFORM_REFERENCE
    if coordinate_system != "earth":
        return f"velocity in {coordinate_system} coordinates; earth coordinates are needed", Reason.NOT_EARTH_COORDINATES
    return None


def read_profile(payload: Mapping[str, Any], vehicle_depth: float, latitude: float, default_std: float) -> Profile:
    """Return the profile that an earth-coordinates ping holds.

    The transducer is at the depth of the ping's pressure, or at the vehicle's where the ping has none, plus
    ``transducer_depth``.

    Args:
        payload: Fields of the ping.
        vehicle_depth: [m], from other messages; used when the ping has no pressure.
        latitude: [degrees north], for pressure to depth.
        default_std: [m/s], for bins whose ping states no error.

    Raises:
        MeasurementError: A field is missing, of the wrong shape or not a number.
    """
    n_cells = payload.get("n_cells")
    velocity = _velocity(payload, n_cells)
    cell_size, bin0_distance = number(payload.get("cell_size")), number(payload.get("bin0_distance"))
    if not (cell_size > 0.0 and np.isfinite(bin0_distance)):
        raise MeasurementError(
            "ping: expected cell_size > 0 and a finite bin0_distance [m], "
            f"got {payload.get('cell_size')!r} and {payload.get('bin0_distance')!r}"
        )
    pressure = number(payload.get("pressure"))
    top = depth_of_pressure(pressure, latitude) if np.isfinite(pressure) else vehicle_depth
    offset = number(payload.get("transducer_depth"))
    top += offset if np.isfinite(offset) else 0.0
    away = bin0_distance + cell_size * np.arange(velocity.shape[0])
    sign = -1.0 if _word(payload, "orientation", ORIENTATIONS) == "up" else 1.0
    depth = np.asarray(top + sign * away, dtype=np.float64)
    flags, reasons = np.full(depth.size, Flag.GOOD, np.int8), np.zeros(depth.size, np.int32)
    missing, above = ~np.isfinite(velocity).all(axis=1), depth < 0.0
    reasons[missing] |= Reason.MISSING
    reasons[above] |= Reason.ABOVE_SURFACE
    flags[above] = Flag.FAIL
    flags[missing] = Flag.MISSING
    return Profile(depth, velocity, _error_std(payload, depth.size, default_std), "earth", flags, reasons)


def _word(payload: Mapping[str, Any], key: str, known: tuple[str, ...]) -> str:
    value = payload.get(key)
    if isinstance(value, int | float) and not isinstance(value, bool) and float(value).is_integer() and 0 <= value < len(known):
        return known[int(value)]
    if value not in known:
        raise MeasurementError(f"ping: expected {key} to be one of {', '.join(known)}, got {value!r}; state it in the message")
    return str(value)


def _velocity(payload: Mapping[str, Any], n_cells: Any) -> Array:
    """Return east and north, shape (n, 2); protobuf carries the cells flat."""
    raw = payload.get("velocity")
    if not isinstance(raw, list | tuple) or not isinstance(n_cells, int) or n_cells < 1:
        raise MeasurementError(
            f"ping: expected n_cells >= 1 and a list of velocities, got n_cells {n_cells!r} and velocity {type(raw).__name__}"
        )
    if raw and not isinstance(raw[0], list | tuple):
        if len(raw) % n_cells:
            raise MeasurementError(f"ping: {len(raw)} flat velocities do not divide into {n_cells} cells")
        width = len(raw) // n_cells
        raw = [raw[i * width : (i + 1) * width] for i in range(n_cells)]
    if len(raw) != n_cells or any(len(cell) < 2 for cell in raw):
        raise MeasurementError(f"ping: expected {n_cells} cells of east, north[, up], got {len(raw)} cells")
    return np.array([[number(cell[0]), number(cell[1])] for cell in raw])


def _error_std(payload: Mapping[str, Any], n: int, default_std: float) -> Array:
    raw = payload.get("velocity_std")
    values = np.array([number(v) for v in raw]) if isinstance(raw, list | tuple) else np.full(n, number(raw))
    if values.size == 1:
        values = np.full(n, values[0])
    elif values.size == 0:
        values = np.full(n, np.nan)
    if values.size != n:
        raise MeasurementError(f"ping: expected velocity_std to be a number or {n} numbers, got {values.size}")
    return np.where(values > 0.0, values, default_std)
