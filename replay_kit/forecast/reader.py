"""Reader of ensembles and truths (CF and native NetCDF, Zarr) as ``Ensemble`` values."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Times
from replay_kit.core.errors import Caveat, ForecastError
from replay_kit.core.files.paths import Paths
from replay_kit.core.grid import Ensemble
from replay_kit.core.words.text import place_text
from replay_kit.forecast.field import Field
from replay_kit.forecast.gather import in_groups, layout_of, members_together
from replay_kit.forecast.grids.axes import AxesCheck, check_axes
from replay_kit.forecast.grids.horizontal import local_grid, projection_of
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
from replay_kit.forecast.variables import precision
from replay_kit.forecast.window import check_claims, read_window


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Ensembles and the interpretation of their files.

    Attributes:
        series: Members at each time.
        layout: Layout of the first file.
        check: Test of the axes.
        field: First file.
    """

    series: tuple[Ensemble, ...]
    layout: Layout
    check: AxesCheck
    field: Field


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
        return without_copies(read_members(found, config, near_ns, place_at).series)[0]


def read_members(
    found: Collection,
    config: ForecastConfig,
    near_ns: int | None,
    place_at: tuple[float, float] | None,
    dates: Times | None = None,
) -> Reading:
    """Return the chosen part of an opened ensemble at one time or at some dates [ns, UTC]; see ``read_ensemble``.

    Raises:
        ForecastError: See ``read_ensemble``.
    """
    if not found.rule.kind:
        first = found.members[0][0]
        raise ForecastError(
            f"{first.where}: no member dimension; expected one of {', '.join(MEMBER_NAMES)}, got dimensions {sizes_text(first.ds[U])}"
            f"{ways_text(found)}"
        )
    selections = select_each(found, config, near_ns, dates)
    count = sum(len(field.labels) for field in selections[0].fields if not field.extra)
    if count < 2:
        raise ForecastError(
            f"{found.source}: an ensemble needs at least 2 members, got {count}{ways_text(found)}"
        )
    reading = read_selections(selections, config, place_at, found.source, found.notes)
    made_from = found.rule.kind if found.rule.kind in MADE else ""
    series = tuple(replace(part, made_from=made_from) for part in reading.series)
    return replace(reading, series=series)


def select_each(
    found: Collection, config: ForecastConfig, near_ns: int | None, dates: Times | None
) -> list[Selection]:
    """Return the selected fields at each date [ns, UTC]; at the chosen or nearest time without dates."""
    if dates is None:
        return [select(found, config, near_ns)]
    times = (str(np.datetime64(int(date), "ns")) for date in dates)
    return [select(found, config.model_copy(update={"time": time}), None) for time in times]


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
    with open_collection(Path(spec.partition("#")[0]), MemberRule("")) as found:
        selection = truth_in(found, spec)
        selections = [select(selection, config, near_ns)]
        return read_selections(selections, config, place_at, spec, found.notes).series[0]


def truth_in(found: Collection, spec: str) -> Collection:
    """Return an opened file with the truth as its member; see ``read_truth``."""
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
    rule = found.rule if found.rule.kind else MemberRule("dim")
    return replace(found, members=(fields,), rule=rule, background=())


def ways_text(found: Collection) -> str:
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
    chosen = ds.isel({dim: [labels.index(label)]})
    return replace(field, load=lambda: (chosen, notes))


def read_selections(
    selections: Sequence[Selection],
    config: ForecastConfig,
    place_at: tuple[float, float] | None,
    source: str,
    earlier: tuple[str, ...],
) -> Reading:
    """Return the fields of selections, each of one time, as members on the grid of the first.

    Raises:
        ForecastError: See ``read_ensemble``; or land differs between times.
    """
    first = selections[0].fields[0]
    layout = layout_of(first, config).within(config.region, first.where)
    check_claims([field for selection in selections for field in selection.fields], layout)
    counts = [
        sum(1 if field.extra else len(field.labels) for field in selection.fields)
        for selection in selections
    ]
    by_time = [
        [part for field in selection.fields for part in in_groups(field, layout)]
        for selection in selections
    ]
    fields = [field for each in by_time for field in each]
    window = read_window(fields[0], layout, config)
    projection = projection_of(window.longitude, window.latitude)
    # what is made of members is computed in double precision, however many they are
    made = selections[0].change is not None
    dtype = precision(fields[0].ds[U], 0 if made else counts[0] * window.velocity[0, 0].size)
    velocity, more = members_together(fields, layout, window, projection, config, dtype)
    # the members are in memory once
    window = replace(window, velocity=velocity[:0])
    placed = []
    if place_at is not None:
        centre = f"its centre is at {place_text(*place_at)}"
        placed = [Caveat(f"the ensemble was moved: not a forecast for this region; {centre}")]
    series, filled = list[Ensemble](), 0
    for selection, each, count in zip(selections, by_time, counts, strict=True):
        members = velocity[filled : filled + count]
        filled += count
        if selection.change is not None:
            members, changed = selection.change(members)
            more += changed
        labels = tuple(label for field in each if not field.extra for label in field.labels)
        members, wet, holes = common_water(members, labels, source)
        if series and not np.array_equal(wet, series[0].grid.wet):
            raise ForecastError(
                f"{source}: land is not the same at all times of the forecast; choose one with --lead or forecast.time, or mend its mask"
            )
        if series:
            series.append(
                replace(series[0], velocity=members, time_ns=selection.time_ns, members=labels)
            )
            continue
        check = check_axes(window, layout, members, wet, projection)
        # axes that were stated need no check
        doubts = check.notes if config.axes == "auto" else ()
        grid = local_grid(window.longitude, window.latitude, window.levels, wet, place_at)
        notes = (
            *selection.notes,
            *more,
            *placed,
            *window.notes,
            *holes,
            *unusual_members(members, labels, source),
            *doubts,
            *earlier,
            *(note for field in each for note in field.load()[1]),
        )
        error = check.residual_std if doubts else 0.0
        series.append(
            Ensemble(
                grid, members, selection.time_ns, source, tuple(dict.fromkeys(notes)), labels, error
            )
        )
    return Reading(tuple(series), layout, check, fields[0])
