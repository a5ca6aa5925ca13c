"""One ADCP ping (``replay_kit.AdcpPing``) to a profile of the current.

The field names and units of a ping are in ``replay_kit/README.md``. Flags and reasons are set in ``quality_ping``; nothing is deleted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from reprlib import repr as shorten
from typing import Any

import gsw
import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation import Reason, Reference

COORDINATE_SYSTEMS = ("beam", "instrument", "ship", "earth")
REFERENCES: tuple[Reference, ...] = ("earth", "platform")
ORIENTATIONS = ("down", "up")
# m/s; an error outside is no statement of one, and its square would not survive the filter's arithmetic
_STD_BELIEVED = (1e-6, 1e3)
# degrees; gravity there is the mean of the equator's and the pole's, so that a depth is off by 0.27 % at most
_LATITUDE_ASSUMED = 45.0
# of a cell; distances written with few digits are still evenly spaced
_UNEVEN = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """A ping's bins, before its position is known.

    Attributes:
        depth: shape (n,) [m], positive down.
        distance: shape (n,) [m], vertical, from the transducer to the bins' centres.
        transducer_depth: [m], positive down.
        velocity: shape (n, 2) [m/s], true east and north; NaN where missing.
        error_std: shape (n,) [m/s].
        reference: What the velocity is relative to.
    """

    depth: Array
    distance: Array
    transducer_depth: float
    velocity: Array
    error_std: Array
    reference: Reference


def depth_of_pressure(pressure_dbar: float, latitude: float | None) -> float:
    """Return the depth at a sea pressure [m]; NaN for a pressure that has none.

    Args:
        pressure_dbar: Sea pressure [dbar], 0 at the surface.
        latitude: [degrees north]; None when none is known yet, for which 45 degrees are taken.

    References:
        TEOS-10, through gsw, for standard salinity and 0 degrees Celsius.
    """
    with np.errstate(all="ignore"):
        return number(-gsw.z_from_p(pressure_dbar, _LATITUDE_ASSUMED if latitude is None else latitude))


def number(value: Any) -> float:
    """Return a payload's number; None, strings such as "NaN" and anything infinite become NaN."""
    try:
        result = float("nan") if value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        return float("nan")
    return result if np.isfinite(result) else float("nan")


def whole_number(value: Any) -> int | None:
    """Return an integer, which some encodings write as a float; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return int(value) if isinstance(value, int) or value.is_integer() else None


def why_not_used(payload: Mapping[str, Any]) -> tuple[str, Reason] | None:
    """Return why a ping that ``earth_referenced`` gave is no absolute profile, in words and as a reason; None when it is one.

    Raises:
        MeasurementError: ``reference`` is missing or not one of the known words.
    """
    if known_word(payload, "reference", REFERENCES) == "platform":
        return "velocity relative to the platform, whose own motion is not known", Reason.PLATFORM_REFERENCE
    return None


def read_profile(payload: Mapping[str, Any], vehicle_depth: float, latitude: float, config: MeasurementConfig) -> Profile:
    """Return the profile that an earth-coordinates ping holds.

    The transducer is at the depth of the ping's pressure, or at the vehicle's where the ping has none, plus
    ``transducer_depth``.

    Args:
        payload: Fields of the ping.
        vehicle_depth: [m], from other messages; used when the ping has no pressure. NaN when unknown.
        latitude: [degrees north], for pressure to depth.
        config: The error of bins whose ping states none.

    Raises:
        MeasurementError: A field is missing, of the wrong shape or not a number.
    """
    velocity = np.array([_cell(cell) for cell in velocity_cells(payload)])
    distance = _distance(payload, velocity.shape[0])
    sign = -1.0 if known_word(payload, "orientation", ORIENTATIONS) == "up" else 1.0
    top = _transducer_depth(payload, vehicle_depth, latitude)
    with np.errstate(over="ignore", invalid="ignore"):
        depth = top + sign * distance
    depth = np.where(np.isfinite(depth), depth, np.nan)
    reference: Reference = "platform" if known_word(payload, "reference", REFERENCES) == "platform" else "earth"
    return Profile(depth, distance, top, velocity, error_std(payload, depth.size, config.velocity_std), reference)


def _transducer_depth(payload: Mapping[str, Any], vehicle_depth: float, latitude: float) -> float:
    """Return the depth of the transducer [m]."""
    pressure, offset = number(payload.get("pressure")), number(payload.get("transducer_depth"))
    top = depth_of_pressure(pressure, latitude) if np.isfinite(pressure) else vehicle_depth
    if not np.isfinite(top):
        if not np.isfinite(pressure):
            raise MeasurementError("ping: its instrument's depth is not a number, and no earlier message gives the vehicle's depth")
        raise MeasurementError("ping: no depth has the pressure it states [dbar]")
    return top + (offset if np.isfinite(offset) else 0.0)


def _distance(payload: Mapping[str, Any], n: int) -> Array:
    """Return how far the centres of n bins are from the transducer [m]: listed, or evenly spaced."""
    listed = payload.get("cell_distances")
    if listed is not None:
        if not isinstance(listed, list | tuple) or len(listed) != n:
            raise MeasurementError(f"ping: expected cell_distances to be {n} numbers [m], got {shorten(listed)}")
        return np.array([number(value) for value in listed])
    cell_size, bin0_distance = number(payload.get("cell_size")), number(payload.get("bin0_distance"))
    if not (cell_size > 0.0 and np.isfinite(bin0_distance)):
        raise MeasurementError(
            "ping: expected cell_size > 0 and a finite bin0_distance [m], "
            f"got {shorten(payload.get('cell_size'))} and {shorten(payload.get('bin0_distance'))}"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(bin0_distance + cell_size * np.arange(n), np.float64)


def even_cells(payload: Mapping[str, Any], n: int) -> tuple[float, float]:
    """Return how far the first of n evenly spaced bins is from the transducer, at its centre, and the bins' size [m].

    Raises:
        MeasurementError: The bins are not evenly spaced outwards, or the ping does not say where they are.
    """
    centres = _distance(payload, n)
    size = number(payload.get("cell_size"))
    if payload.get("cell_distances") is not None:
        if n > 1:
            size = float(centres[-1] - centres[0]) / (n - 1)
        if not (size > 0.0 and (np.abs(centres - centres[0] - size * np.arange(n)) <= _UNEVEN * size).all()):
            raise MeasurementError(
                "ping: bins can be mapped to equal depths only where cell_distances are finite, growing and evenly spaced [m], "
                f"got {shorten(payload['cell_distances'])}; map them before, and state bin_mapped"
            )
    return float(centres[0]), size


def known_word(payload: Mapping[str, Any], key: str, known: tuple[str, ...]) -> str:
    """Return the word that a field holds, by name or by number.

    Raises:
        MeasurementError: It holds none of the known words.
    """
    value = payload.get(key)
    code = whole_number(value)
    if code is not None and 0 <= code < len(known):
        return known[code]
    if value not in known:
        raise MeasurementError(f"ping: expected {key} to be one of {', '.join(known)}, got {shorten(value)}; state it in the message")
    return str(value)


def velocity_cells(payload: Mapping[str, Any]) -> Sequence[Any]:
    """Return the cells of a ping's velocity as they came, each a list, a message or null; protobuf carries them flat.

    Raises:
        MeasurementError: They are no list, or not as many as stated.
    """
    raw, n_cells = payload.get("velocity"), whole_number(payload.get("n_cells"))
    if not isinstance(raw, list | tuple) or n_cells is None or n_cells < 1:
        raise MeasurementError(
            "ping: expected n_cells >= 1 and a list of velocities, "
            f"got n_cells {shorten(payload.get('n_cells'))} and velocity {type(raw).__name__}"
        )
    if _is_flat(raw, n_cells):
        if len(raw) % n_cells:
            raise MeasurementError(f"ping: {len(raw)} flat velocities do not divide into {n_cells} cells")
        width = len(raw) // n_cells
        raw = [raw[i * width : (i + 1) * width] for i in range(n_cells)]
    if len(raw) != n_cells:
        raise MeasurementError(f"ping: expected {n_cells} cells of east, north[, up], got {len(raw)} cells")
    return raw


def _is_flat(raw: Sequence[Any], n_cells: int) -> bool:
    """Return whether velocities come without cells; nulls alone, as many as there are cells, are missing cells."""
    if any(isinstance(item, list | tuple | Mapping) for item in raw):
        return False
    return bool(raw) and not (len(raw) == n_cells and all(item is None for item in raw))


def _cell(cell: Any) -> tuple[float, float]:
    """Return east and north of a cell: a list, a message with ``value`` or with ``east`` and ``north``, or null."""
    if isinstance(cell, Mapping):
        cell = cell.get("value", [cell.get("east"), cell.get("north")] if "east" in cell and "north" in cell else [])
    if isinstance(cell, list | tuple) and len(cell) >= 2:
        return number(cell[0]), number(cell[1])
    # null, NaN or "NaN" in the place of a cell
    if not isinstance(cell, list | tuple | Mapping) and np.isnan(number(cell)):
        return float("nan"), float("nan")
    raise MeasurementError(f"ping: expected cells of east, north[, up], got {shorten(cell)}")


def error_std(payload: Mapping[str, Any], n: int, default_std: float) -> Array:
    """Return the error that a ping states, shape (n,) [m/s]; the default where it states none.

    Raises:
        MeasurementError: It states neither one number nor n.
    """
    raw = payload.get("velocity_std")
    values = np.array([number(v) for v in raw]) if isinstance(raw, list | tuple) else np.full(n, number(raw))
    if values.size == 1:
        values = np.full(n, values[0])
    elif values.size == 0:
        values = np.full(n, np.nan)
    if values.size != n:
        raise MeasurementError(f"ping: expected velocity_std to be a number or {n} numbers, got {values.size}")
    stated = (values >= _STD_BELIEVED[0]) & (values <= _STD_BELIEVED[1])
    return np.where(stated, values, default_std)
