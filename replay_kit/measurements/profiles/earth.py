"""Pings rotated to true east and north, and made absolute if the platform's motion is known; and its attitudes and DVL velocities.

Steps: bins are mapped to equal depths, beams solved (three if one is missing), velocities rotated by heading, pitch and roll, and by the
declination for a magnetic heading; then the platform's velocity over ground is added, from bottom track, else as stated in the ping, else
from a DVL. Its error is common to all bins and not part of their own errors. A DVL's velocity through water is a ping of one cell.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from reprlib import repr as shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array, all_along
from replay_kit.core.observation.table import Columns, Raw, Rows, Table
from replay_kit.logs.tables.instruments import ping_tables
from replay_kit.measurements.profiles import frames
from replay_kit.measurements.step import Step
from replay_kit.measurements.track.positions import as_of, in_order

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
_NO_ERROR = "the ping has no error velocity"
_UNLIKE = "malformed: a field is missing or of the wrong kind (IndexError)"


def no_triples() -> Rows:
    """Return zero rows of three numbers: heading, pitch, roll [degrees], or velocity, east, north, and its error [m/s]."""
    return {"time": _NONE, "order": _NONE, "values": np.empty((0, 3))}


def last_triple(rows: Columns, at: Table, before: int, after: int = 0) -> Array:
    """Return the last row up to each message of a table, shape (n, 3); NaN if older than ``before`` or newer than ``after`` [ns]."""
    last = as_of(at.order, rows["order"])
    age = at.time - np.append(rows["time"], 0)[last]
    values = np.append(rows["values"], [[np.nan] * 3], axis=0)[last]
    return np.where(((age >= -after) & (age <= before))[:, None], values, np.nan)


@np.errstate(all="ignore")
def to_earth(ping: Table, attitudes: Columns, motions: Columns, config: MeasurementConfig) -> Table:
    """Return pings after all rotations, with ``why``, the reason why a ping cannot be rotated, shape (n,), else empty.

    ``velocity`` becomes (n, m, 3), true east, north and up, ``error_std`` that of the solution; ``raw`` is what the velocity was.
    ``error_size`` (n, m) is the magnitude of the error velocity, ``no_error_velocity`` the reason for a missing one, and ``error_velocity``
    (n,) its mean over cells of solved beams. ``added`` (n, 3) is the added platform velocity, east, north and error; NaN if none.
    ``absolute`` states whether a velocity is over ground. Impossible numbers become NaN, a missing bin. Values of pings that cannot be
    rotated are meaningless.

    Args:
        ping: Pings of one layout.
        attitudes: Attitudes of the vehicle, for pings without.
        motions: Velocities of the vehicle, for pings without.
        config: Declination for magnetic headings without one; greatest plausible speed.
    """
    columns, fixed, here = dict(ping.columns), ping.fixed, np.isfinite(ping["place"][:, 0])
    angles = last_triple(attitudes, ping, ATTITUDE_AGE)
    known = np.isfinite(angles[:, 0]) & ~np.isfinite(columns["heading"]) & ~here
    for k, name in enumerate(("heading", "pitch", "roll")):
        columns[name] = np.where(known, angles[:, k], columns[name])
    columns["gimbal"] = known | fixed["gimbal"]
    raw = columns["raw"] = columns["velocity"]
    vectors, relative = fixed["vectors"], fixed["reference"] == "platform"
    along_beams, gain = fixed["frame"] == "beam", 1.0
    rotation, why = _rotation({**fixed, **columns}, config)
    cells, uneven = _even_cells({**fixed, **columns})
    fault = _fault_of(vectors, raw.shape[2], along_beams) if along_beams or cells else ""
    why = np.where(why == "", fault or uneven, why)
    columns |= {"absolute": np.full(len(ping), not relative), "why": why}
    if fault:
        return replace(ping, columns=columns)
    # what the ping states, or the fourth component; the solution of beams leaves its own
    velocity = raw
    size = raw[..., 3] if raw.shape[2] == 4 else np.full(raw.shape[:2], np.nan)
    if "error_velocity" in columns:
        said = (columns["no_error_velocity"] == "")[:, None]
        size = np.where(said, columns["error_velocity"][..., 0], size)
    if along_beams or cells:
        beams = raw if along_beams else frames.beams_of(raw, vectors)
        if cells:
            beams = frames.map_bins(beams, frames.vertical_stretch(vectors, rotation), *cells)
        velocity = frames.solve_beams(beams, vectors)
        size = velocity[..., 3]
    velocity, ground = frames.to_earth_axes(velocity, rotation), columns["bottom"][:, None, :]
    if along_beams:
        gain = frames.noise_gain(vectors)
        ground = frames.solve_beams(ground[..., : len(vectors)], vectors)
    added = _plausible(np.column_stack([columns["platform"], columns["platform_std"]]), config)
    if relative:
        others = _plausible(last_triple(motions, ping, BOTTOM_AGE, BOTTOM_AGE), config)
        added = np.where((np.isnan(added[:, 0]) & ~here)[:, None], others, added)
        ground, std = -frames.to_earth_axes(ground, rotation)[:, 0, :2], columns["bottom_std"]
        std = np.where((std > 0.0) & (std <= config.max_speed), std, _BOTTOM_STD)
        seen = np.isfinite(ground).all(axis=1, keepdims=True)
        added = np.where(seen, np.column_stack([ground, std]), added)
        moves = columns["absolute"] = np.isfinite(added[:, 0])
        velocity[moves, :, :2] += added[moves, None, :2]
    known = np.isfinite(size)
    mean = np.where(known, size, 0.0).sum(axis=1) / known.sum(axis=1)
    columns |= {
        "velocity": velocity,
        "error_std": columns["error_std"] * gain,
        "added": added,
        "error_size": np.abs(size),
        "no_error_velocity": np.where(known.any(axis=1), "", _NO_ERROR).astype(object),
        "error_velocity": mean if along_beams else np.full(mean.size, np.nan),
    }
    return replace(ping, columns=columns)


def _plausible(motion: Array, config: MeasurementConfig) -> Array:
    """Return velocities with errors, shape (n, 3) [m/s]; NaN without an error or with one above the greatest speed."""
    good = all_along(np.isfinite(motion)) & (motion[:, 2] > 0.0)
    return np.where((good & (motion[:, 2] <= config.max_speed))[:, None], motion, np.nan)


def _rotation(ping: Mapping[str, Any], config: MeasurementConfig) -> tuple[Array, Words]:
    """Return the rotations to true east, north, up, shape (n, 3, 3), and the reasons of unknown ones.

    Earth coordinates are true and headings magnetic unless the ping states otherwise.
    """
    frame, convention, applied = ping["frame"], ping["convention"], ping["declination_applied"]
    stated, usual = ping["declination"], config.magnetic_declination
    declination = np.where(np.isfinite(stated), stated, np.nan if usual is None else usual)
    if applied or (applied is None and frame == "earth"):
        declination = np.zeros(stated.size)
    why = np.where(
        np.isfinite(declination),
        "",
        "heading is magnetic, declination unknown; state it in the ping or as measurements.magnetic_declination",
    ).astype(object)
    heading, pitch, roll = (ping[name] for name in ("heading", "pitch", "roll"))
    level, up = np.zeros(stated.size), ping["orientation"] == "up"
    if frame == "earth" or (frame == "ship" and ping["tilt_applied"]):
        heading, pitch, roll, up = level if frame == "earth" else heading, level, level, False
    unknown = ~np.isfinite(heading + pitch + roll) & (why == "")
    why[unknown] = f"velocity in {frame} coordinates, and heading, pitch or roll is not known"
    own_axes = frame in ("beam", "instrument")
    if own_axes and convention not in ("teledyne", "nortek"):
        why[why == ""] = (
            f"ping: expected attitude_convention to be one of teledyne, nortek, got {convention}; state it in the message"
        )
    if own_axes and convention == "nortek":
        return frames.nortek_rotation(heading + declination, pitch, roll, not up), why
    angles = heading + declination, pitch, roll
    return frames.teledyne_rotation(*angles, up, ping["gimbal"]), why


def _even_cells(ping: Mapping[str, Any]) -> tuple[Cells | None, Words | str]:
    """Return distances of first cells and cell sizes, shapes (n,) [m], for bin mapping, or the reasons against it.

    Bins are mapped for beams, or for axes with the error velocity, if the instrument did not.
    """
    frame, distance, size = ping["frame"], ping["distance"], ping["cell_size"]
    maps = frame == "beam" or (frame == "instrument" and ping["raw"].shape[2] == 4)
    if ping["bin_mapped"] or ping["vectors"] is None or not maps:
        return None, ""
    first, steps = distance[:, 0], np.arange(distance.shape[1])
    found = np.full(len(first), size)
    if steps.size > 1:
        found = (distance[:, -1] - first) / steps[-1]
    apart = np.abs(distance - first[:, None] - found[:, None] * steps)
    even = (found > 0.0) & (apart <= _UNEVEN * found[:, None]).all(axis=1)
    why = np.full(len(first), "", object)
    for k in np.flatnonzero(~even):
        why[k] = (
            "ping: bins are mapped where cell_distances are finite, growing and evenly spaced [m], "
            f"got {shorten(distance[k].tolist())}; map them before, and state bin_mapped"
        )
    return (first, found), why


def _fault_of(vectors: Array | None, components: int, along_beams: bool) -> str:
    """Return the defect of the beams' unit vectors; empty without one."""
    if vectors is None or vectors.size == 0 or not np.isfinite(vectors).all():
        return (
            "velocity in beam coordinates, and beam_unit_vectors does not hold three numbers a beam"
        )
    if not (np.abs(np.linalg.norm(vectors, axis=1) - 1.0) < _UNIT).all():
        return "beam_unit_vectors: expected vectors of length 1"
    return _UNLIKE if along_beams and components != len(vectors) else ""


_KEPT = "attitude: kept for pings without their own"


def attitudes_of(before: Columns, tables: Sequence[Table], step: Step) -> Rows:
    """Return the last earlier attitude and those of a block, and note the messages that state only attitudes."""
    parts = [before]
    for table in tables:
        if table.kind == "attitude":
            step.note(table, _KEPT)
        if table.kind == "attitude" or table.fixed.get("oriented"):
            angles = frames.attitude_of(table["quaternion"], table["ned"].astype(bool))
            parts.append({"time": table.time, "order": table.order, "values": angles})
    return in_order(*parts)


def motions_of(
    before: Columns, tables: Sequence[Table], attitudes: Columns, step: Step
) -> tuple[Rows, list[Table]]:
    """Return the last earlier velocity over ground and those of a block, and velocities through water as pings.

    Args:
        before: Last earlier velocity.
        tables: Tables of DVLs.
        attitudes: Attitudes of the vehicle.
        step: Block.
    """
    parts, water = [before], list[Table]()
    for table in tables:
        values, why = velocity_of(table, attitudes, step.config)
        table = step.kept(replace(table, columns={**table.columns, "values": values}), why)
        bottom = table["bottom"].astype(bool)
        ground, rest = table.rows(bottom), table.rows(~bottom)
        step.note(ground)
        parts.append({"time": ground.time, "order": ground.order, "values": ground["values"]})
        if step.config.water_track_distance is not None:
            water.append(rest)
        else:
            words = "DVL water track does not state its layer depth; set measurements.water_track_distance"
            step.note(rest, words)
    motions, found = in_order(*parts), list[Table]()
    for table in water:
        known = np.isfinite(last_triple(motions, table, BOTTOM_AGE, BOTTOM_AGE)[:, 0])
        why = np.where(known, "", "DVL water track without a bottom track gives no current")
        found += _pings(step.kept(table, why), step)
    return motions, found


def velocity_of(table: Table, attitudes: Columns, config: MeasurementConfig) -> tuple[Array, Words]:
    """Return true east, true north and error of velocities, shape (n, 3) [m/s], and the reasons of unknown ones."""
    heading, pitch, roll = last_triple(attitudes, table, ATTITUDE_AGE).T
    declination, axes = config.magnetic_declination, config.dvl_axes
    why = np.where(np.isfinite(heading), "", "DVL: no attitude within 1 s").astype(object)
    if declination is None:
        declination = np.nan
        why[why == ""] = (
            "DVL heading: true or magnetic north unknown; set measurements.magnetic_declination (0 for true north)"
        )
    left_up = table["axes"] == 2 if axes is None else np.array(axes == "forward-left-up")
    body = table["velocity"] * np.where(left_up[..., None], (1.0, -1.0, -1.0), 1.0)
    # Nortek's angles are those of an attitude: nose up, starboard down
    rotation = frames.nortek_rotation(heading + declination, pitch, roll, True)
    ground = frames.to_earth_axes(body[:, None], rotation)[:, 0, :2]
    return np.column_stack([ground, table["error_std"]]), why


def _pings(table: Table, step: Step) -> list[Table]:
    """Return velocities through a layer of water as pings of one cell with the opposite velocity."""
    fixed = {
        "coordinate_system": "earth",
        "reference": "platform",
        "orientation": "down",
        "n_cells": 1,
        "cell_distances": [step.config.water_track_distance],
        "declination_applied": True,
    }
    payloads = [
        {**fixed, "velocity": [[-east, -north]], "velocity_std": std}
        for east, north, std in table["values"].tolist()
    ]
    raw = Raw(table.topic, "", table.input, table.time, table.order, table.position, payloads)
    # a DVL states its own unit
    return ping_tables(raw, payloads, step.config.model_copy(update={"velocity_unit": None}))
