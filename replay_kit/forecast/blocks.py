"""Files of an ensemble to blocks of members: which files hold u and v, which hold the grid, which belong together."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import Paths
from replay_kit.core.text import some_text
from replay_kit.forecast.files import find_sources, natural, opened_file
from replay_kit.forecast.layout import U, V
from replay_kit.forecast.members import (
    WARNING,
    MemberRule,
    is_background,
    kind_of,
    label_files,
    usual_labels,
)
from replay_kit.forecast.names import (
    MEMBER_NAMES,
    Axes,
    Current,
    find_current,
    find_member,
    find_time,
    no_current,
    sizes_text,
    suffixes,
    without_partner,
)
from replay_kit.forecast.pairs import OpenedFile, Part, pair_files, without_repeats
from replay_kit.forecast.times import rule_of, runs_of, start_of

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


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Members that are read together.

    Attributes:
        parts: The same members at several times, in order of time.
        member: Dimension of the members; None for one member.
        label: Of the member, or of all.
    """

    parts: tuple[Part, ...]
    member: str | None
    label: str

    @property
    def count(self) -> int:
        """Number of members."""
        return 1 if self.member is None else self.parts[0].ds.sizes[self.member]


@dataclass(frozen=True, slots=True, eq=False)
class Collection:
    """An ensemble's files, opened and put in order.

    Attributes:
        rule: What a member is; None where nothing says it, and the blocks hold one member.
        blocks: The members.
        background: The state that anomaly members are about; None for members that are states, or without one.
        grids: Files without velocities.
        source: The files' names, for messages.
        notes: What was left out or assumed.
    """

    rule: MemberRule | None
    blocks: tuple[Block, ...]
    background: Block | None
    grids: tuple[Path, ...]
    source: str
    notes: tuple[str, ...]


@contextmanager
def open_collection(given: "Paths | Collection", rule: MemberRule | None) -> Iterator[Collection]:
    """Give an ensemble's files, opened, as they may be given.

    Args:
        given: Files, stores, folders, patterns.
        rule: What a member is; None finds out.

    Raises:
        ForecastError: Files are missing, unreadable, hold no current, or do not belong together.
    """
    if isinstance(given, Collection):
        yield given
        return
    sources = find_sources(given)
    try:
        with ExitStack() as stack:
            opened = [
                (number, path, stack.enter_context(opened_file(path)))
                for number, argument in enumerate(sources.arguments)
                for path in argument
            ]
            files, rule = _identified(opened, rule)
            of_suffix = opened if kind_of(rule) == "suffix" else ()
            alone = [
                f"{path.name}: {name}" for _, path, ds in of_suffix for name in without_partner(ds)
            ]
            notes = sources.notes
            if alone:
                excluded = f"members with only one component were excluded: {some_text(alone)}"
                notes += (f"{WARNING}{excluded}; add the other",)
            yield _collected(files, rule, notes)
    # values of unexpected kinds and damaged data blocks are found where they are used
    except _FOREIGN as error:
        names, words = ", ".join(map(str, sources.files[:3])), " ".join(str(error).split())[:200]
        raise ForecastError(
            f"{names}: cannot be used as a forecast: {type(error).__name__}: {words}; is it whole?"
        ) from error


def _identified(
    opened: Sequence[tuple[int, Path, xr.Dataset]], rule: MemberRule | None
) -> tuple[list[OpenedFile], MemberRule | None]:
    """Return the files with the names of their components; one for each suffix where suffixes are the members."""
    found: list[OpenedFile] = []
    if rule is None and all(len(suffixes(ds)) > 1 for _, _, ds in opened) and opened:
        rule = MemberRule("suffix")
    by_suffix = kind_of(rule) == "suffix"
    for number, path, ds in opened:
        pairs = suffixes(ds) if by_suffix else {}
        for label, (u, v) in pairs.items():
            current = Current(u, v, _axes_of(ds, u), f"suffix {label}")
            found.append(OpenedFile(path, ds, current, number, label))
        if not pairs:
            whole = None if by_suffix else find_current(ds, str(path))
            runs = [ds]
            if whole is not None and kind_of(rule) == "lags":
                runs = runs_of(ds, ds[whole.u or whole.v].dims)
            found += [OpenedFile(path, run, whole, number) for run in runs]
    return found, rule


def _axes_of(ds: xr.Dataset, name: str) -> Axes | None:
    one = ds[[name]].rename({name: name.partition("_")[0]})
    current = find_current(one, name)
    return None if current is None else current.axes


def _collected(
    files: Sequence[OpenedFile], rule: MemberRule | None, notes: tuple[str, ...]
) -> Collection:
    grids = [file for file in files if file.current is None]
    holders = [file for file in files if file.current is not None]
    if not holders:
        if kind_of(rule) == "suffix":
            raise ForecastError(
                f"{files[0].path}: --members suffix, but no variables differ by a suffix alone, as uo_glor and uo_oras do"
            )
        raise no_current(files[0].ds, ", ".join(str(file.path) for file in files))
    states = [file for file in holders if is_background(file.path)]
    if rule is None and find_member(holders[0].ds, holders[0].dims) is not None:
        rule = MemberRule("dim")
    others = [file.path for file in holders if file not in states]
    if rule is None and usual_labels(others) is not None:
        rule = MemberRule("files")
    if rule is None:
        rule, more = rule_of(holders)
        notes += more
    background = states if kind_of(rule) == "files" else []
    holders = _labelled([file for file in holders if file not in background], rule)
    blocks: list[Block] = []
    for label in dict.fromkeys(file.label for file in holders):
        parts, more = pair_files([file for file in holders if file.label == label], grids)
        notes += more
        once = [without_repeats(part) for part in parts]
        parts = tuple(part for part, _ in once)
        notes += tuple(note for _, of in once for note in of)
        blocks += _blocks(parts, rule, label)
    about = None
    if background:
        about = Block(pair_files(background, grids)[0], None, "background")
    source = (
        str(holders[0].path)
        if len({file.path for file in files}) == 1
        else f"{len(files)} files ({holders[0].path.name} ...)"
    )
    return Collection(
        rule,
        tuple(blocks),
        about,
        tuple(file.path for file in grids),
        source,
        tuple(dict.fromkeys(notes)),
    )


def _labelled(holders: list[OpenedFile], rule: MemberRule | None) -> list[OpenedFile]:
    """Return the files with the members that they belong to."""
    kind = kind_of(rule)
    if rule is not None and kind == "files":
        labels = label_files([file.path for file in holders], rule.name)
        whole = any(
            file.current is not None and file.current.u and file.current.v for file in holders
        )
        if len(set(labels.values())) == len(holders) and not whole:
            # a file of u and one of v to each member, whose names say no member: paired in their order
            us, vs = (
                sorted(
                    (
                        file.path
                        for file in holders
                        if file.current and bool(file.current.u) is first
                    ),
                    key=natural,
                )
                for first in (True, False)
            )
            labels |= {v: u.name for u, v in zip(us, vs, strict=False)} | {u: u.name for u in us}
        return sorted(
            (replace(file, label=labels[file.path]) for file in holders),
            key=lambda file: natural(Path(file.label)),
        )
    if kind == "lags":
        return sorted(
            (replace(file, label=start_of(file)) for file in holders), key=lambda file: file.label
        )
    if kind == "models":
        several = len({file.argument for file in holders}) > 1
        return [
            replace(file, label=f"model {file.argument}" if several else file.path.name)
            for file in holders
        ]
    return holders


def _blocks(parts: tuple[Part, ...], rule: MemberRule | None, label: str) -> list[Block]:
    """Return the blocks of files that belong together."""
    if rule is None or rule.kind != "dim":
        return [Block(parts, None, label)]
    found = []
    for part in parts:
        dims = part.ds[U].dims
        member = rule.name or find_member(part.ds, dims)
        if member is None or member not in dims:
            raise ForecastError(
                f"{part.paths[0]}: no member dimension{' ' + rule.name if rule.name else ''}; expected one of "
                f"{', '.join(MEMBER_NAMES)}, got dimensions {sizes_text(part.ds[U])}"
            )
        if (of_v := f"{member}_of_v") in part.ds[V].dims:
            sizes = f"{part.ds.sizes[member]} of {part.current.u} and {part.ds.sizes[of_v]} of {part.current.v} along {member}"
            raise ForecastError(
                f"{part.paths[-1]}: its members are not those of {part.paths[0]}: {sizes}; give files with the same members"
            )
        if member not in part.ds[V].dims:
            raise ForecastError(
                f"{part.paths[-1]}: {part.current.v} has no dimension {member}, which {part.current.u} has; mend the file"
            )
        found.append(Block((part,), str(member), part.names))
    over_time = {tuple(part.times.astype(np.int64)) for part in parts}
    if rule.name and find_time(parts[0].ds, (rule.name,)) == rule.name:
        return found
    if len(parts) > 1 and len(over_time) == len(parts):
        return [Block(parts, found[0].member, found[0].label)]
    return found
