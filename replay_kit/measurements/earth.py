"""Pings as their instruments gave them, turned to true east and north, and made absolute where the platform's motion is known.

In this order: bins are mapped to equal depths, beams solved (three where one is missing), velocities turned by heading, pitch and roll, and
by the declination where the heading is magnetic; then the platform's velocity over the ground is added: minus the bottom track where the
ping has it, else what the ping states, else a DVL's. That velocity's error is one for all bins, so it does not enter the bins' own.
"""

from reprlib import repr as shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array, Mask
from replay_kit.core.table import Columns, Table
from replay_kit.measurements import frames
from replay_kit.measurements.positions import Rows, as_of

_CONVENTIONS = ("teledyne", "nortek")
# m/s; of a bottom-track ping that states none: makers state 3 to 30 mm/s for a single one
_BOTTOM_STD = 0.03
# ns; of a DVL's velocity, as a vehicle may turn and stop in more, and of an attitude
BOTTOM_AGE, ATTITUDE_AGE = 3_000_000_000, 1_000_000_000
# vectors written with three digits are still unit vectors, and distances written with few digits evenly spaced
_UNIT, _UNEVEN = 0.01, 0.01
_NONE = np.empty(0, np.int64)
# of pings, distances of first cells and sizes of cells [m]
Cells = tuple[Array, Array]
Words = NDArray[np.object_]
NO_DECLINATION = "heading is magnetic, declination unknown; state it in the ping or as measurements.magnetic_declination"
_NO_VECTORS = (
    "velocity in beam coordinates, and beam_unit_vectors does not hold three numbers a beam"
)
_NO_UNIT_VECTORS = "beam_unit_vectors: expected vectors of length 1"
_UNLIKE = "malformed: a field is missing or of the wrong kind (IndexError)"


def no_triples() -> Rows:
    """Return no rows of three numbers: heading, pitch, roll [degrees], or a velocity, east, north and its error [m/s]."""
    return {"time": _NONE, "order": _NONE, "values": np.empty((0, 3))}


def last_triple(rows: Columns, at: Table, before: int, after: int = 0) -> Array:
    """Return the last row up to each message of a table, shape (n, 3); NaN where it is more than so much [ns] before or after that."""
    last = as_of(at.order, rows["order"])
    age = at.time - np.append(rows["time"], 0)[last]
    values = np.append(rows["values"], [[np.nan] * 3], axis=0)[last]
    return np.where(((age >= -after) & (age <= before))[:, None], values, np.nan)


@np.errstate(all="ignore")
def to_earth(
    ping: Table, attitudes: Columns, motions: Columns, config: MeasurementConfig
) -> tuple[Rows, Words]:
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
    columns, fixed = dict(ping.columns), ping.fixed
    columns["gimbal"] = _with_attitude(columns, ping, attitudes)
    raw = columns["raw"] = columns["velocity"]
    frame, vectors, relative = fixed["frame"], fixed["vectors"], fixed["reference"] == "platform"
    along_beams = frame == "beam"
    # one beam of four may be missing, but no axis
    axes = 2 if frame in ("ship", "earth") else 3
    seen = np.isfinite(columns["bottom"])
    bottom = seen.sum(axis=1) >= 3 if along_beams else seen[:, :axes].all(axis=1)
    motion = np.column_stack([columns["platform"], columns["platform_std"]])
    motion = _believed(motion, config.max_speed)
    if relative:
        silent = ~bottom & np.isnan(motion[:, 0]) & np.isnan(columns["place"][:, 0])
        others = last_triple(motions, ping, BOTTOM_AGE, BOTTOM_AGE)
        motion = _believed(np.where(silent[:, None], others, motion), config.max_speed)
    moves = relative & (bottom | np.isfinite(motion[:, 0]))
    declination = _declination(columns["declination"], fixed, config)
    stays = ~moves & (frame == "earth") & (declination == 0.0)
    absolute = columns["absolute"] = moves | (not relative)
    added = np.where(absolute[:, None], motion, np.nan)
    rotation, why = _rotation(columns, fixed, declination)
    cells, uneven = _even_cells(columns, fixed)
    fault = _fault_of(vectors, raw.shape[2], along_beams) if along_beams or cells else ""
    for words in (fault, uneven):
        why = np.where(why == "", words, why)
    why[stays] = ""
    ok, turns = (why == "") & ~stays, (not fault) and not stays.all()
    velocity, error, gain = raw[..., :3], None, 1.0
    if turns and along_beams:
        gain = frames.noise_gain(vectors)
    if turns:
        velocity = np.where(ok[:, None, None], raw, np.nan)
        velocity, error = _solved(velocity, rotation, vectors, cells, along_beams)
    if turns and relative:
        ground = columns["bottom"][:, None, :]
        if along_beams:
            ground = frames.solve_beams(ground[..., : len(vectors)], vectors)
        std = columns["bottom_std"]
        std = np.where((std > 0.0) & (std <= config.max_speed), std, _BOTTOM_STD)
        ground = np.column_stack([-frames.turned(ground, rotation)[:, 0, :2], std])
        added = np.where((bottom & moves)[:, None], ground, added)
        whole = velocity[..., :2] + added[:, None, :2]
        velocity[..., :2] = np.where((moves & ok)[:, None, None], whole, velocity[..., :2])
    columns["added"] = added
    columns["error_std"] = np.where(ok[:, None], columns["error_std"] * gain, columns["error_std"])
    columns["velocity"] = np.where(stays[:, None, None], raw[..., :3], velocity)
    return _with_error(columns, error, stays), why


def _with_error(columns: Rows, error: Array | None, stays: Mask) -> Rows:
    """Return columns with the size of the error velocity, shape (n, m) [m/s], and in words why a ping has none.

    It is what the solution leaves, else what the ping states, else the fourth component of a velocity that was not turned.
    """
    raw, said = columns["raw"], columns["no_error_velocity"] == ""
    stated = columns.get("error_velocity", np.full((*raw.shape[:2], 1), np.nan))
    stated = np.where(said[:, None, None], stated, np.nan)
    solved = np.full(len(raw), error is not None) & ~stays
    stated = stated if error is None else np.where(solved[:, None, None], error, stated)
    size, known = np.abs(stated[..., 0]), np.isfinite(stated).any(axis=(1, 2))
    if raw.shape[2] == 4:
        fourth = ~known & stays & np.isfinite(raw).any(axis=(1, 2))
        size, known = np.where(fourth[:, None], np.abs(raw[..., 3]), size), known | fourth
    none = np.where(known, "", "the ping has no error velocity").astype(object)
    return columns | {
        "error_velocities": stated,
        "error_size": size,
        "no_error_velocity": none,
    }


def _with_attitude(columns: Rows, ping: Table, attitudes: Columns) -> Mask:
    """Take the vehicle's attitude for pings that state none; return whether the pitch of each is that of a gimbal."""
    angles = last_triple(attitudes, ping, ATTITUDE_AGE)
    known = np.isfinite(angles[:, 0]) & ~np.isfinite(columns["heading"])
    known &= np.isnan(columns["place"][:, 0])
    for k, name in enumerate(("heading", "pitch", "roll")):
        columns[name] = np.where(known, angles[:, k], columns[name])
    return np.asarray(known | ping.fixed["gimbal"])


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


def _rotation(columns: Rows, fixed: Any, declination: Array) -> tuple[Array, Words]:
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


def _even_cells(columns: Rows, fixed: Any) -> tuple[Cells | None, Words | str]:
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


def _fault_of(vectors: Array | None, components: int, along_beams: bool) -> str:
    """Return what is wrong with the beams' unit vectors; empty where nothing is."""
    if vectors is None or vectors.size == 0 or not np.isfinite(vectors).all():
        return _NO_VECTORS
    if not (np.abs(np.linalg.norm(vectors, axis=1) - 1.0) < _UNIT).all():
        return _NO_UNIT_VECTORS
    return _UNLIKE if along_beams and components != len(vectors) else ""


def _solved(
    velocity: Array,
    rotation: Array,
    vectors: Array,
    cells: Cells | None,
    along_beams: bool,
) -> tuple[Array, Array | None]:
    """Return velocities along true east, north, up, shape (n, m, 3), and the error velocity, (n, m, 1), if there is one.

    A solution from three beams has no error velocity: NaN.
    """
    if along_beams or cells:
        beams = velocity if along_beams else frames.beams_of(velocity, vectors)
        if cells:
            beams = frames.map_bins(beams, frames.vertical_stretch(vectors, rotation), *cells)
        velocity = frames.solve_beams(beams, vectors)
    error = velocity[..., 3:] if velocity.shape[2] == 4 else None
    return frames.turned(velocity, rotation), error


def horizontal(velocity: Array, angles: Array, declination: float, left_up: Mask) -> Array:
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
