"""Pings as their instruments gave them, turned to true east and north, and made absolute where the platform's motion is known.

In this order: bins are mapped to equal depths, beams solved (three where one is missing), velocities turned by heading, pitch and roll, and
by the declination where the heading is magnetic; then the platform's velocity over the ground is added: minus the bottom track where the
ping has it, else what the ping states, else a DVL's. That velocity's error is one for all bins, so it does not enter the bins' own.
"""

from dataclasses import dataclass, field
from reprlib import repr as shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.table import Integers, Table
from replay_kit.measurements import frames
from replay_kit.measurements.positions import as_of

_CONVENTIONS = ("teledyne", "nortek")
# m/s; of a bottom-track ping that states none: makers state 3 to 30 mm/s for a single one
_BOTTOM_STD = 0.03
# ns; of a DVL's velocity, as a vehicle may turn and stop in more, and of an attitude
_BOTTOM_AGE, _ATTITUDE_AGE = 3_000_000_000, 1_000_000_000
# vectors written with three digits are still unit vectors, and distances written with few digits evenly spaced
_UNIT, _UNEVEN = 0.01, 0.01
NO_DECLINATION = "heading is magnetic, declination unknown; state it in the ping or as measurements.magnetic_declination"
_NO_VECTORS = (
    "velocity in beam coordinates, and beam_unit_vectors does not hold three numbers a beam"
)
_NO_UNIT_VECTORS = "beam_unit_vectors: expected vectors of length 1"
_UNLIKE = "malformed: a field is missing or of the wrong kind (IndexError)"


@dataclass(frozen=True, slots=True, eq=False)
class Attitudes:
    """Attitudes of the vehicle by other messages than pings, in order; one row is carried from block to block.

    Attributes:
        time: shape (n,) [ns, UTC].
        order: shape (n,), places in the stream.
        quaternion: shape (n, 4), as of ``frames.attitude_of``.
        ned: shape (n,).
    """

    time: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    order: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    quaternion: Array = field(default_factory=lambda: np.empty((0, 4)))
    ned: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))

    def part(self, at: NDArray[Any] | slice) -> "Attitudes":
        """Return some of them."""
        return Attitudes(self.time[at], self.order[at], self.quaternion[at], self.ned[at])

    def at(self, time: Integers, order: Integers) -> Array:
        """Return heading, pitch and roll at messages, shape (n, 3) [degrees]; NaN without an attitude in the second before."""
        if not self.time.size:
            return np.full((time.size, 3), np.nan)
        at = as_of(order, self.order)
        age = time - self.time[at]
        near = (at >= 0) & (age >= 0) & (age <= _ATTITUDE_AGE)
        angles = frames.attitude_of(self.quaternion[at], self.ned[at])
        return np.where(near[:, None], angles, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """Velocities over the ground by a DVL, in order; one row is carried from block to block.

    Attributes:
        time: shape (n,) [ns, UTC].
        order: shape (n,), places in the stream.
        velocity: shape (n, 3) [m/s], true east, true north and the error of each.
    """

    time: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    order: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    velocity: Array = field(default_factory=lambda: np.empty((0, 3)))

    def part(self, at: NDArray[Any] | slice) -> "Motions":
        """Return some of them."""
        return Motions(self.time[at], self.order[at], self.velocity[at])

    def at(self, time: Integers, order: Integers) -> Array:
        """Return the velocity at messages, shape (n, 3) [m/s]; NaN without one within three seconds."""
        if not self.time.size:
            return np.full((time.size, 3), np.nan)
        at = as_of(order, self.order)
        near = (at >= 0) & (np.abs(time - self.time[at]) <= _BOTTOM_AGE)
        return np.where(near[:, None], self.velocity[at], np.nan)


@np.errstate(all="ignore")
def to_earth(
    ping: Table, attitudes: Attitudes, motions: Motions, config: MeasurementConfig
) -> tuple[dict[str, NDArray[Any]], NDArray[np.object_]]:
    """Return the columns of pings after all rotations, and in words why a ping cannot be turned, shape (n,), empty for the others.

    ``velocity`` becomes (n, m, 3), true east, north and up, ``error_velocity`` and ``error_std`` those of the solution; ``raw`` is what the
    velocity was. ``added`` (n, 3) is the platform's velocity, east, north and error, that was added; NaN where none was. ``absolute`` says
    whether a velocity is over the ground. Numbers that no instrument gives become NaN, which is a missing bin.

    Args:
        ping: The pings, of one layout.
        attitudes: Of the vehicle, for pings that state none.
        motions: Of the vehicle, for pings that state none.
        config: The declination of a ping whose heading is magnetic and that states none; the fastest motion that is believed.
    """
    columns, fixed, n = dict(ping.columns), ping.fixed, len(ping)
    columns["gimbal"] = _with_attitude(columns, ping, attitudes)
    columns["raw"] = columns["velocity"]
    relative = fixed["reference"] == "platform"
    bottom = _found_bottom(columns["bottom"], fixed["frame"])
    motion = _stated_motion(columns, config.max_speed)
    if relative:
        silent = ~bottom & np.isnan(motion[:, 0]) & np.isnan(columns["place"][:, 0])
        motion[silent] = motions.at(ping.time, ping.order)[silent]
        motion = _believed(motion, config.max_speed)
    moves = relative & (bottom | np.isfinite(motion[:, 0]))
    declination = _declination(columns["declination"], fixed, config)
    stays = ~moves & (fixed["frame"] == "earth") & (declination == 0.0)
    columns["added"] = np.where((moves | (not relative))[:, None], motion, np.nan)
    columns["absolute"] = moves | (not relative)
    if stays.all():
        columns["velocity"] = columns["raw"][..., :3]
        return _with_error(columns, None, stays), np.full(n, "", object)
    rotation, why = _rotation(columns, fixed, declination)
    along_beams, vectors = fixed["frame"] == "beam", fixed["vectors"]
    cells, uneven = _even_cells(columns, fixed)
    fault = ""
    if along_beams or cells is not None:
        fault = _fault_of(vectors, columns["raw"].shape[2] if along_beams else None)
    for words in (fault, uneven):
        why = np.where(why == "", words, why)
    why[stays] = ""
    ok = (why == "") & ~stays
    velocity = np.where(ok[:, None, None], columns["raw"], np.nan)
    velocity, error = _solved(velocity, rotation, vectors, cells, along_beams)
    if bottom.any() and relative:
        ground = _turned_bottom(columns["bottom"], rotation, vectors, along_beams)
        std = columns["bottom_std"]
        std = np.where((std > 0.0) & (std <= config.max_speed), std, _BOTTOM_STD)
        added = np.column_stack([-ground[:, :2], std])
        columns["added"] = np.where((bottom & moves)[:, None], added, columns["added"])
    add = (moves & ok)[:, None]
    velocity[..., :2] = np.where(
        add[..., None], velocity[..., :2] + columns["added"][:, None, :2], velocity[..., :2]
    )
    gain = frames.noise_gain(vectors) if along_beams and vectors is not None and ok.any() else 1.0
    columns["error_std"] = np.where(ok[:, None], columns["error_std"] * gain, columns["error_std"])
    columns["velocity"] = np.where(stays[:, None, None], columns["raw"][..., :3], velocity)
    return _with_error(columns, error, stays), why


def _with_error(
    columns: dict[str, NDArray[Any]], error: Array | None, stays: NDArray[np.bool_]
) -> dict[str, NDArray[Any]]:
    """Return columns with the size of the error velocity, shape (n, m) [m/s], and in words why a ping has none.

    It is what the solution leaves, else what the ping states, else the fourth component of a velocity that was not turned.
    """
    raw, why = columns["raw"], columns["no_error_velocity"]
    n, m, k = raw.shape
    stated = columns.get("error_velocity", np.full((n, m, 1), np.nan))
    stated = np.where((why == "")[:, None, None], stated, np.nan)
    solved = np.zeros(n, np.bool_) if error is None else ~stays
    if error is not None:
        stated = np.where(solved[:, None, None], error, stated)
    columns["error_velocities"] = stated
    size = np.abs(stated[..., 0])
    known = np.isfinite(stated).any(axis=(1, 2))
    if k == 4:
        fourth = ~known & ~solved & stays & np.isfinite(raw).any(axis=(1, 2))
        size, known = np.where(fourth[:, None], np.abs(raw[..., 3]), size), known | fourth
    columns["error_size"] = size
    columns["no_error_velocity"] = np.where(known, "", "the ping has no error velocity").astype(
        object
    )
    return columns


def _with_attitude(
    columns: dict[str, NDArray[Any]], ping: Table, attitudes: Attitudes
) -> NDArray[np.bool_]:
    """Take the vehicle's attitude for pings that state none; return whether the pitch of each is that of a gimbal."""
    lacks = ~np.isfinite(columns["heading"])
    gimbal = np.full(len(ping), ping.fixed["gimbal"], np.bool_)
    if not lacks.any():
        return gimbal
    angles = attitudes.at(ping.time, ping.order)
    known = lacks & np.isfinite(angles[:, 0]) & np.isnan(columns["place"][:, 0])
    for k, name in enumerate(("heading", "pitch", "roll")):
        columns[name] = np.where(known, angles[:, k], columns[name])
    return np.asarray(gimbal | known)


def _found_bottom(velocity: Array, frame: str) -> NDArray[np.bool_]:
    """Return which bottom tracks give a velocity: one beam of four may be missing, but no axis."""
    if frame == "beam":
        return np.asarray(np.isfinite(velocity).sum(axis=1) >= 3)
    axes = 2 if frame in ("ship", "earth") else 3
    return np.asarray(np.isfinite(velocity[:, :axes]).all(axis=1))


def _stated_motion(columns: dict[str, NDArray[Any]], max_speed: float) -> Array:
    """Return the platform's velocity that pings state, shape (n, 3) [m/s]."""
    return _believed(np.column_stack([columns["platform"], columns["platform_std"]]), max_speed)


def _believed(motion: Array, max_speed: float) -> Array:
    """Return velocities with errors, shape (n, 3) [m/s]; NaN without one, or with an error above the fastest motion."""
    good = (
        np.isfinite(motion[:, :2]).all(axis=1) & (motion[:, 2] > 0.0) & (motion[:, 2] <= max_speed)
    )
    return np.where(good[:, None], motion, np.nan)


def _declination(stated: Array, fixed: Any, config: MeasurementConfig) -> Array:
    """Return the angles still to be added to headings, shape (n,) [degrees]; NaN where they are not known.

    Velocities in earth coordinates are true ones unless the ping says that they are not; a heading is magnetic unless it says so.
    """
    applied = fixed["declination_applied"]
    if applied or (applied is None and fixed["frame"] == "earth"):
        return np.zeros(stated.size)
    usual = config.magnetic_declination
    return np.where(np.isfinite(stated), stated, np.nan if usual is None else usual)


def _rotation(
    columns: dict[str, NDArray[Any]], fixed: Any, declination: Array
) -> tuple[Array, NDArray[np.object_]]:
    """Return what turns velocities to true east, north, up, shape (n, 3, 3), and in words why that is not known."""
    frame, n = fixed["frame"], declination.size
    why = np.where(np.isfinite(declination), "", NO_DECLINATION).astype(object)
    level = np.zeros(n)
    everyone = np.ones(n, np.bool_)
    if frame == "earth":
        return frames.teledyne_rotation(declination, level, level, False, everyone), why
    is_level = frame == "ship" and fixed["tilt_applied"]
    pitch, roll = (level, level) if is_level else (columns["pitch"], columns["roll"])
    unknown = ~np.isfinite(columns["heading"] + pitch + roll)
    why[unknown & (why == "")] = (
        f"velocity in {frame} coordinates, and heading, pitch or roll is not known"
    )
    heading, convention = columns["heading"] + declination, fixed["convention"]
    if frame != "ship" and convention not in _CONVENTIONS:
        why[why == ""] = (
            f"ping: expected attitude_convention to be one of {', '.join(_CONVENTIONS)}, got {convention}; state it in the message"
        )
    if frame != "ship" and convention == "nortek":
        return frames.nortek_rotation(heading, pitch, roll, fixed["orientation"] == "down"), why
    up = fixed["orientation"] == "up" and not is_level
    return frames.teledyne_rotation(heading, pitch, roll, up, columns["gimbal"]), why


def _even_cells(
    columns: dict[str, NDArray[Any]], fixed: Any
) -> tuple[tuple[Array, Array] | None, NDArray[np.object_] | str]:
    """Return distances of first cells and sizes, shapes (n,) [m], where bins are to be mapped, and in words where they cannot be.

    Bins are mapped of beams, or of axes with the error velocity beside them, that the instrument did not map.
    """
    frame, distance = fixed["frame"], columns["distance"]
    maps = frame == "beam" or (frame == "instrument" and columns["raw"].shape[2] == 4)
    if fixed["bin_mapped"] or fixed["vectors"] is None or not maps:
        return None, ""
    m, size = distance.shape[1], fixed["cell_size"]
    first, steps = distance[:, 0], np.arange(m)
    plain = (size > 0.0) & (distance == first[:, None] + size * steps).all(axis=1)
    found = (distance[:, -1] - first) / (m - 1) if m > 1 else np.full(len(distance), size)
    found = np.where(plain, size, found)
    apart = np.abs(distance - first[:, None] - found[:, None] * steps)
    bad = ~plain & ~((found > 0.0) & (apart <= _UNEVEN * found[:, None]).all(axis=1))
    why = np.full(len(distance), "", object)
    for k in np.flatnonzero(bad):
        why[k] = (
            "ping: bins can be mapped to equal depths only where cell_distances are finite, growing and evenly spaced [m], "
            f"got {shorten(distance[k].tolist())}; map them before, and state bin_mapped"
        )
    return (first, found), why


def _fault_of(vectors: Array | None, beams: int | None) -> str:
    """Return what is wrong with the beams' unit vectors; empty where nothing is."""
    if vectors is None or vectors.size == 0 or not np.isfinite(vectors).all():
        return _NO_VECTORS
    if not (np.abs(np.linalg.norm(vectors, axis=1) - 1.0) < _UNIT).all():
        return _NO_UNIT_VECTORS
    return _UNLIKE if beams is not None and beams != len(vectors) else ""


def _solved(
    velocity: Array,
    rotation: Array,
    vectors: Array | None,
    cells: tuple[Array, Array] | None,
    along_beams: bool,
) -> tuple[Array, Array | None]:
    """Return velocities along true east, north, up, shape (n, m, 3), and the error velocity, (n, m, 1), if there is one.

    A solution from three beams has no error velocity: NaN.
    """
    error = None
    solves = vectors is not None and vectors.size > 0 and (along_beams or cells is not None)
    if vectors is not None and solves and (not along_beams or velocity.shape[2] == len(vectors)):
        beams = velocity if along_beams else frames.beams_of(velocity, vectors)
        if cells is not None:
            beams = frames.map_bins(beams, frames.vertical_stretch(vectors, rotation), *cells)
        velocity = frames.solve_beams(beams, vectors)
    if velocity.shape[2] == 4:
        error = velocity[..., 3:]
    return frames.turned(velocity, rotation), error


def _turned_bottom(
    bottom: Array, rotation: Array, vectors: Array | None, along_beams: bool
) -> Array:
    """Return the ground's velocity relative to the platform, true east and north, shape (n, 2) [m/s]."""
    velocity = bottom[:, None, :]
    if along_beams and vectors is not None:
        velocity = frames.solve_beams(velocity[..., : len(vectors)], vectors)
    return frames.turned(velocity, rotation)[:, 0, :2]


def horizontal(
    velocity: Array, angles: Array, declination: float, left_up: NDArray[np.bool_]
) -> Array:
    """Return the velocities of a DVL along true east and north, shape (n, 2) [m/s].

    Args:
        velocity: shape (n, 3) [m/s], along the vehicle's axes.
        angles: shape (n, 3) [degrees], heading, pitch and roll of the vehicle.
        declination: To be added to its heading [degrees east].
        left_up: shape (n,), whether the axes are forward, left, up; else forward, starboard, down.
    """
    signs = np.where(left_up[:, None], (1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
    # Nortek's angles are those of an attitude: nose up, starboard down
    turn = frames.nortek_rotation(angles[:, 0] + declination, angles[:, 1], angles[:, 2], True)
    return frames.turned((velocity * signs)[:, None], turn)[:, 0, :2]
