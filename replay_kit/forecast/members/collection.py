"""Members of an ensemble from its files: files of u and v, files of the grid, and their grouping."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import xarray as xr

from replay_kit.core.errors import ForecastError
from replay_kit.core.files.paths import Paths
from replay_kit.core.words.text import some_text
from replay_kit.forecast.field import Field, Files, field_of
from replay_kit.forecast.files import find_sources, natural_order, source_of
from replay_kit.forecast.grids.layout import U, V
from replay_kit.forecast.members.pairs import pair_files
from replay_kit.forecast.members.rules import (
    WARNING,
    MemberRule,
    is_background,
    label_files,
    usual_labels,
)
from replay_kit.forecast.members.times import rule_of, runs_of, start_of
from replay_kit.forecast.names import (
    MEMBER_NAMES,
    Axes,
    Current,
    NoCurrentError,
    find_current,
    find_member,
    find_time,
    sizes_text,
    suffixes,
)

#: What xarray, HDF5, pyproj and numpy raise on contents that are none of a forecast.
_FOREIGN = (
    OSError,
    # of decoders in C
    SystemError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    RuntimeError,
    ArithmeticError,
    MemoryError,
)


Notes = tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Collection:
    """Opened files of an ensemble, in order.

    Attributes:
        rule: Definition of a member; without a kind if undefined, with a single field.
        members: Fields of each member, or of members read together, in order of time.
        background: State to which anomaly members are added; empty for members that are states, or without one.
        grids: Files without velocities.
        source: Names of the files, for messages.
        notes: Exclusions and assumptions.
    """

    rule: MemberRule
    members: tuple[tuple[Field, ...], ...]
    background: tuple[Field, ...]
    grids: tuple[Path, ...]
    source: str
    notes: Notes


@contextmanager
def open_collection(given: "Paths | Collection", rule: MemberRule) -> Iterator[Collection]:
    """Give an ensemble's files in order; each is opened when used.

    Args:
        given: Files, stores, folders, patterns.
        rule: Definition of a member; without a kind it is detected.

    Raises:
        ForecastError: Files are missing, unreadable, hold no current, or do not belong together.
    """
    if isinstance(given, Collection):
        yield given
        return
    sources = find_sources(given)
    try:
        with ExitStack() as stack:
            files = Files(stack)
            looked = [
                files.field(path, number)
                for number, argument in enumerate(sources.arguments)
                for path in argument
            ]
            fields, rule = _identified(looked, rule)
            of_suffix = looked if rule.kind == "suffix" else ()
            alone = [f"{file.names}: {name}" for file in of_suffix for name in suffixes(file.ds)[1]]
            notes = sources.notes
            if alone:
                excluded = f"members with only one component were excluded: {some_text(alone)}"
                notes += (f"{WARNING}{excluded}; add the other",)
            yield _collected(fields, rule, notes)
    # values of unexpected kinds and damaged data blocks are found where they are used
    except _FOREIGN as error:
        names, words = ", ".join(map(str, sources.files[:3])), " ".join(str(error).split())[:200]
        raise ForecastError(
            f"{names}: cannot be used as a forecast: {type(error).__name__}: {words}; is it whole?"
        ) from error


def _identified(files: Sequence[Field], rule: MemberRule) -> tuple[list[Field], MemberRule]:
    """Return the files with the names of their components; one field for each suffix if suffixes are members."""
    found: list[Field] = []
    if not rule.kind and files and all(len(suffixes(file.like)[0]) > 1 for file in files):
        rule = MemberRule("suffix")
    currents = dict[int, Current | None]()
    for file in files:
        if rule.kind == "suffix":
            whole = file.load()[0]
            found += [
                replace(
                    file, current=Current(u, v, _axes_of(whole, u), f"suffix {label}"), label=label
                )
                for label, (u, v) in suffixes(whole)[0].items()
            ] or [file]
            continue
        form = id(file.like)
        if form not in currents:
            currents[form] = find_current(file.like, file.where)
        identified = replace(file, current=currents[form])
        found += _runs(identified) if rule.kind == "lags" else [identified]
    return found, rule


def _runs(file: Field) -> list[Field]:
    """Return the runs of a file with dimensions of starts and leads; otherwise the file itself."""
    if file.current is None or file.lead is None:
        return [file]
    runs = runs_of(file.ds, file.dims)
    return [
        replace(field_of(file.paths[0], run, file.argument), current=file.current) for run in runs
    ]


def _axes_of(ds: xr.Dataset, name: str) -> Axes | None:
    one = ds[[name]].rename({name: name.partition("_")[0]})
    current = find_current(one, name)
    return None if current is None else current.axes


def _collected(files: Sequence[Field], rule: MemberRule, notes: Notes) -> Collection:
    grids = [file for file in files if file.current is None]
    holders = [file for file in files if file.current is not None]
    if not holders:
        if rule.kind == "suffix":
            raise ForecastError(
                f"{files[0].where}: --members suffix, but no variables differ by a suffix alone, as uo_glor and uo_oras do"
            )
        datasets = [file.like for file in files]
        raise NoCurrentError(datasets, ", ".join(file.where for file in files))
    states = [file for file in holders if is_background(file.paths[0])]
    if not rule.kind and find_member(holders[0].like, holders[0].dims) is not None:
        rule = MemberRule("dim")
    others = [file.paths[0] for file in holders if file not in states]
    if not rule.kind and usual_labels(others) is not None:
        rule = MemberRule("files")
    if not rule.kind:
        rule, more = rule_of(holders)
        notes += more
    background = states if rule.kind == "files" else []
    holders = _labelled([file for file in holders if file not in background], rule)
    members: list[tuple[Field, ...]] = []
    for label in dict.fromkeys(file.label for file in holders):
        fields = pair_files([file for file in holders if file.label == label], grids)
        members += _members(fields, rule)
    about = pair_files([replace(file, label="background") for file in background], grids)
    source = source_of([*dict.fromkeys(file.paths[0] for file in files)])
    return Collection(
        rule, tuple(members), about, tuple(file.paths[0] for file in grids), source, notes
    )


def _labelled(holders: list[Field], rule: MemberRule) -> list[Field]:
    """Return the files labelled with their members."""
    if rule.kind == "files":
        labels = label_files([file.paths[0] for file in holders], rule.name)
        us, vs = (
            sorted((file.paths[0] for file in holders if file.holds == one), key=natural_order)
            for one in ((True, False), (False, True))
        )
        if len(set(labels.values())) == len(us) + len(vs) == len(holders):
            # a file of u and one of v to each member, whose names say no member: paired in their order
            labels |= dict(zip([*us, *vs], [u.name for u in us] * 2, strict=False))
        return sorted(
            (replace(file, label=labels[file.paths[0]]) for file in holders),
            key=lambda file: natural_order(Path(file.label)),
        )
    if rule.kind == "lags":
        return sorted(
            (replace(file, label=start_of(file)) for file in holders), key=lambda file: file.label
        )
    if rule.kind == "models":
        several = len({file.argument for file in holders}) > 1
        return [
            replace(file, label=f"model {file.argument}" if several else file.names)
            for file in holders
        ]
    return holders


def _members(fields: tuple[Field, ...], rule: MemberRule) -> list[tuple[Field, ...]]:
    """Return the members of files: those along a dimension are read together, files of several times share theirs."""
    if rule.kind != "dim":
        return [fields]
    found = []
    for field in fields:
        current = field.current
        assert current is not None
        # one file has the dimensions of its form, two have them when they are joined
        ds, u, v = field.like, current.u, current.v
        if len(field.paths) > 1:
            ds, u, v = field.load()[0], U, V
        dims = ds[u].dims
        member = rule.name or find_member(ds, dims)
        if member is None or member not in dims:
            raise ForecastError(
                f"{field.where}: no member dimension{' ' + rule.name if rule.name else ''}; expected one of "
                f"{', '.join(MEMBER_NAMES)}, got dimensions {sizes_text(ds[u])}"
            )
        if member not in ds[v].dims:
            raise ForecastError(
                f"{field.paths[-1]}: its members are not those of {field.where}: {current.u} has {sizes_text(ds[u])}, {current.v} has "
                f"{sizes_text(ds[v])}; give the same members"
            )
        found.append(replace(field, member=str(member), label=field.names))
    over_time = {tuple(field.times) for field in fields}
    of_times = rule.name and find_time(fields[0].like, (rule.name,)) == rule.name
    if not of_times and 1 < len(fields) == len(over_time):
        return [tuple(replace(field, label=found[0].label) for field in found)]
    return [(field,) for field in found]
