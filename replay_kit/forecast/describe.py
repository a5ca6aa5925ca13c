"""What the files of an ensemble hold and what comes of them, without an estimate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from replay_kit.config.run import ForecastConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.paths import Paths
from replay_kit.core.text import some_text
from replay_kit.forecast.axes import AxesCheck
from replay_kit.forecast.blocks import Collection, open_collection
from replay_kit.forecast.files import open_file
from replay_kit.forecast.members import MemberRule, parse_rule
from replay_kit.forecast.names import find_current, suffixes
from replay_kit.forecast.reader import read_members, read_selection, ways
from replay_kit.forecast.selection import select
from replay_kit.forecast.sources import find_sources


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """What an ensemble's files hold.

    Attributes:
        source: The files' names.
        grids: Files that hold no current: masks, coordinates, angles.
        rule: What a member is, as the value of ``--members``; empty where nothing says it.
        ensemble: The members, or the one field; None where no file holds a current.
        names: The velocity components in the file.
        arrangement: Grid and staggering in words.
        check: Of the axes; None without a current.
        use: What the files can be used for.
    """

    source: str
    grids: tuple[Path, ...]
    rule: str
    ensemble: Ensemble | None
    names: tuple[str, str]
    arrangement: str
    check: AxesCheck | None
    use: str


def describe_ensemble(
    path: Paths, config: ForecastConfig, near_ns: int | None = None
) -> Description:
    """Return what files hold, how they were understood, and what can be done with them.

    Args:
        path: Files, stores, folders or patterns.
        config: As for ``read_ensemble``.
        near_ns: A log's time [ns, UTC]; None without a log.

    Raises:
        ForecastError: The files cannot be read, or do not belong together; files without a current are no error.
    """
    files = find_sources(path).files
    if (variables := _without_current(files)) is not None:
        use = f"no current: a file of the grid or of other variables ({some_text(variables)}); give it beside files with velocities"
        return Description(_named(files), files, "", None, ("", ""), "", None, use)
    with open_collection(path, parse_rule(config.members)) as found:
        if found.rule is None:
            one = replace(found, rule=MemberRule("dim"))
            reading = read_selection(
                select(one, config, near_ns), config, None, found.source, found.notes
            )
            use = f"one field, which --truth takes; no ensemble{ways(found)}"
        else:
            reading = read_members(found, config, near_ns, None)
            use = f"an ensemble of {reading.ensemble.n_members} members"
        current = reading.part.current
        names = str(current.u), str(current.v)
        rule = _rule(found)
        return Description(
            _named(files),
            found.grids,
            rule,
            reading.ensemble,
            names,
            reading.layout.name,
            reading.check,
            use,
        )


def _without_current(files: Sequence[Path]) -> list[str] | None:
    """Return the variables of files of which none holds a current; None where one does."""
    variables: set[str] = set()
    for path in files:
        with open_file(path) as ds:
            if suffixes(ds) or find_current(ds, str(path)) is not None:
                return None
            variables |= {str(name) for name in ds.data_vars}
    return sorted(variables)


def _named(files: Sequence[Path]) -> str:
    return (
        str(files[0]) if len(files) == 1 else f"{len(files)} files, {files[0]} to {files[-1].name}"
    )


def _rule(found: Collection) -> str:
    rule = found.rule
    if rule is None:
        return ""
    if rule.kind == "dim":
        return f"dim:{found.blocks[0].member}"
    more = rule.name or (f"{rule.days:g}d" if rule.kind == "times" else "")
    return f"{rule.kind}:{more}" if more else rule.kind
