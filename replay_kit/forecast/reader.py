"""Reader of ensembles and truths (CF and native NetCDF, Zarr) as ``Ensemble`` values."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble, Projection
from replay_kit.core.paths import Paths
from replay_kit.core.text import place_text
from replay_kit.forecast.field import Field
from replay_kit.forecast.gather import in_groups, is_alike, layout_of, together
from replay_kit.forecast.grids.axes import AxesCheck, check_axes
from replay_kit.forecast.grids.horizontal import local_grid, projection_of, turn_to_local
from replay_kit.forecast.grids.layout import Layout, U
from replay_kit.forecast.members.collection import Collection, open_collection
from replay_kit.forecast.members.rules import (
    MADE,
    MemberRule,
    common_water,
    parse_rule,
    unusual_members,
    without_copies,
)
from replay_kit.forecast.members.selection import Selection, select
from replay_kit.forecast.names import MEMBER_NAMES, sizes_text
from replay_kit.forecast.window import Window, check_claim, read_window


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Ensemble and the interpretation of its files.

    Attributes:
        ensemble: Members.
        layout: Layout of the first file.
        check: Test of the axes.
        field: First file.
        window: Window read of it, without velocities.
        projection: Local frame of the velocities.
        turn: Rotation from the file's axes to the local ones, shape (J, I).
    """

    ensemble: Ensemble
    layout: Layout
    check: AxesCheck
    field: Field
    window: Window
    projection: Projection
    turn: NDArray[np.complex128]


def read_ensemble(
    path: Paths | Collection,
    config: ForecastConfig,
    *,
    near_ns: int | None = None,
    place_at: tuple[float, float] | None = None,
) -> Ensemble:
    """Return the chosen part of an ensemble forecast in its local frame.

    Args:
        path: NetCDF files, Zarr stores, folders or patterns.
        config: Definition of a member, region, levels, lead, time and axes.
        near_ns: Middle time of the log [ns, UTC]; by default the nearest time of the forecast is read.
        place_at: New (longitude, latitude) of the ensemble's centre.

    Raises:
        ForecastError: A file is missing or unreadable, members are undefined, the current or its coordinates are missing, or the
            region holds no point.
    """
    with open_collection(path, parse_rule(config.members)) as found:
        return without_copies((read_members(found, config, near_ns, place_at).ensemble,))[0]


def read_members(
    found: Collection,
    config: ForecastConfig,
    near_ns: int | None,
    place_at: tuple[float, float] | None,
    times: int = 1,
    first: Reading | None = None,
) -> Reading:
    """Return the chosen part of an opened ensemble, and the interpretation of its files; see ``read_ensemble``.

    Args:
        found: Opened files.
        config: See ``read_ensemble``.
        near_ns: See ``read_ensemble``.
        place_at: See ``read_ensemble``.
        times: Number of times to be read, including this one.
        first: Reading of the first time, with the grid and axes for the others.

    Raises:
        ForecastError: See ``read_ensemble``.
    """
    if found.rule is None:
        raise _nothing_says(found)
    selection = select(found, config, near_ns)
    count = sum(len(field.labels) for field in selection.fields if not field.extra)
    if count < 2:
        raise ForecastError(
            f"{found.source}: an ensemble needs at least 2 members, got {count}{ways(found)}"
        )
    reading = read_selection(selection, config, place_at, found.source, found.notes, times, first)
    made_from = found.rule.kind if found.rule.kind in MADE else ""
    return replace(reading, ensemble=replace(reading.ensemble, made_from=made_from))


def read_truth(
    spec: str,
    config: ForecastConfig,
    *,
    near_ns: int | None = None,
    place_at: tuple[float, float] | None = None,
) -> Ensemble:
    """Return a truth, an ensemble of one member, from ``PATH`` or ``PATH#MEMBER``.

    Args:
        spec: Path; the part after ``#`` is a member's label, or its position from 0 in a file without labels.
        config: See ``read_ensemble``.
        near_ns: See ``read_ensemble``.
        place_at: See ``read_ensemble``.

    Raises:
        ForecastError: See ``read_ensemble``; or the member is absent, or required but not named.
    """
    with open_collection(Path(spec.partition("#")[0]), None) as found:
        return truth_in(found, spec, config, near_ns, place_at)


def truth_in(
    found: Collection,
    spec: str,
    config: ForecastConfig,
    near_ns: int | None = None,
    place_at: tuple[float, float] | None = None,
) -> Ensemble:
    """Return a truth of an opened file; see ``read_truth``."""
    name, _, label = spec.partition("#")
    field, *_ = fields = found.members[0]
    if field.member is None and label:
        raise ForecastError(
            f"{name}: member '{label}' asked for, but the file has no member dimension; leave out '#{label}'"
        )
    if field.member is not None and not label and field.count > 1:
        raise ForecastError(
            f"{name}: {field.count} members; name the one that is the truth as '{name}#MEMBER'"
        )
    if label:
        fields = tuple(_one_member(field, label) for field in fields)
    rule = found.rule or MemberRule("dim")
    one = replace(found, members=(fields,), rule=rule, background=())
    return read_selection(
        select(one, config, near_ns), config, place_at, spec, found.notes
    ).ensemble


def _nothing_says(found: Collection) -> ForecastError:
    field = found.members[0][0]
    sizes = sizes_text(field.ds[U])
    return ForecastError(
        f"{field.where}: no member dimension; expected one of {', '.join(MEMBER_NAMES)}, got dimensions {sizes}{ways(found)}"
    )


def ways(found: Collection) -> str:
    """Return the clause of a message with values of --members that suit the files."""
    fields = [field for member in found.members for field in member]
    times = sum(field.times.size for field in fields)
    ways = [f"--members files: {len(fields)} files, each a member"] if len(fields) > 1 else []
    if times > 1:
        ways.append(f"--members times:15d: the {times} fields of other times, about the forecast")
    if times > 1 and len(fields) > 1:
        ways.append("--members lags: forecasts of several starts, valid at one time")
    ways += ["--members models: files of several products"] if len(fields) > 1 else []
    if ways:
        return f"; these can make members: {'; '.join(ways)}"
    return "; give several files, of other times, starts or members, with --ensemble"


def _one_member(field: Field, label: str) -> Field:
    """Return the field of the member with a label."""
    (ds, notes), dim = field.load(), field.member
    labels = (
        [str(value) for value in ds[dim].values]
        if dim in ds.coords
        else [str(i) for i in range(field.count)]
    )
    if label not in labels:
        raise ForecastError(
            f"{field.where}: no member '{label}'; the file has {labels[0]} to {labels[-1]} ({len(labels)} members)"
        )
    one = ds.isel({dim: [labels.index(label)]})
    return replace(field, load=lambda: (one, notes))


def read_selection(
    selection: Selection,
    config: ForecastConfig,
    place_at: tuple[float, float] | None,
    source: str,
    earlier: tuple[str, ...],
    times: int = 1,
    before: Reading | None = None,
) -> Reading:
    """Return the fields of a selection as members on the grid of the first; for ``times`` see ``read_members``.

    Raises:
        ForecastError: See ``read_ensemble``.
    """
    field, where = selection.fields[0], selection.fields[0].where
    layout = layout_of(field, config).within(config.region, where)
    for one in {each.paths: each for each in selection.fields}.values():
        check_claim(one, layout, times)
    fields = [part for field in selection.fields for part in in_groups(field, layout)]
    first = fields[0]
    window = read_window(first, layout, config)
    if before is None or not is_alike(window, before.window):
        before = None
        projection = projection_of(window.longitude, window.latitude)
        turn = turn_to_local(projection, window.longitude, window.latitude, window.axes)
    else:
        projection, turn = before.projection, before.turn
    velocity, more = together(fields, layout, window, turn, projection, config, selection.change)
    # the members are in memory once
    window = replace(window, velocity=velocity[:0])
    labels = tuple(label for field in fields if not field.extra for label in field.labels)
    velocity, wet, holes = common_water(velocity, labels, source)
    check = before.check if before else check_axes(window, layout, velocity, wet, projection)
    # axes that were stated need no check
    doubts = check.notes if config.axes == "auto" else ()
    grid = (
        replace(before.ensemble.grid, levels=window.levels, wet=wet)
        if before
        else local_grid(window.longitude, window.latitude, window.levels, wet, place_at)
    )
    in_order = (
        *selection.notes,
        *more,
        *_placed(place_at),
        *window.notes,
        *holes,
        *unusual_members(velocity, labels, source),
        *doubts,
        *earlier,
        *(note for field in fields for note in field.load()[1]),
    )
    notes = tuple(dict.fromkeys(in_order))
    error_std = check.residual_std if doubts else 0.0
    ensemble = Ensemble(grid, velocity, selection.time_ns, source, notes, labels, error_std)
    return Reading(ensemble, layout, check, first, window, projection, turn)


def _placed(place_at: tuple[float, float] | None) -> tuple[str, ...]:
    if place_at is None:
        return ()
    return (
        f"the ensemble was moved: not a forecast for this region; its centre is at {place_text(*place_at)}",
    )
