"""The help of a command, laid out for the width of the terminal; cyclopts' own loads rich and assembles the options twice."""

import textwrap
from collections.abc import Iterable, Iterator, Mapping

from cyclopts import ArgumentCollection
from cyclopts.argument import Argument

# Columns from which a description begins; longer names have a line of their own.
_NAMES = 26
# What a command with more options than this shows first: what it requires, and these.
_MANY = 30
_COMMON = {"--goal", "--start", "--end", "--region", "--levels", "--modes", "--place-ensemble", "--config", "--json", "--overwrite"}


def layout(usage: str, about: str, groups: Iterable[tuple[str, Iterable[tuple[str, str]]]], width: int) -> str:
    """Return a help text no line of which is wider than the terminal.

    Args:
        usage: The form of the command line.
        about: What the command does.
        groups: Heading and entries, each the names of an option, or of a command, and its description.
        width: Columns of the terminal.
    """
    lines = [*textwrap.wrap(usage, width, subsequent_indent="  "), "", *textwrap.wrap(about, width)]
    for heading, entries in groups:
        lines += ["", f"{heading}:"]
        for names, description in entries:
            lines += _entry(names, description, width)
    return "\n".join(lines) + "\n"


def option_groups(arguments: ArgumentCollection) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return the options of a command under their headings, those that must be given first; of many options the common ones first."""
    shown = [argument for argument in arguments if argument.show]
    groups: dict[str, list[Argument]] = {"Common options": []} if len(shown) > _MANY else {}
    # the order of groups is theirs, that of options the order in which they are written
    for argument in sorted(shown, key=lambda argument: _group(argument)[0]):
        common = "Common options" in groups and (argument.required or not _COMMON.isdisjoint(argument.names))
        groups.setdefault("Common options" if common else _group(argument)[1], []).append(argument)
    ordered = ((heading, sorted(those, key=lambda argument: not argument.required)) for heading, those in groups.items())
    return [(heading, [(_names(argument), _description(argument)) for argument in those]) for heading, those in ordered]


def command_group(commands: Mapping[str, str]) -> tuple[str, list[tuple[str, str]]]:
    """Return commands and what they do as a group of entries."""
    return "Commands", list(commands.items())


def _group(argument: Argument) -> tuple[int, str]:
    group = argument.parameter.group[0]  # type: ignore[index]
    return group.sort_key, group.name


def _names(argument: Argument) -> str:
    """Return the names of an option, short ones first, with the form of its value."""
    form = argument.parameter.metavar or "|".join(argument.get_choices() or ())
    if not argument.name.startswith("-"):
        return argument.name
    if not form and bool not in (argument.hint, *getattr(argument.hint, "__args__", ())):
        form = {int: "COUNT", float: "NUMBER"}.get(argument.hint, "TEXT")
    return ", ".join(sorted(argument.names, key=lambda name: name.startswith("--"))) + (f" {form}" if form else "")


def _description(argument: Argument) -> str:
    default = argument.field_info.default if argument.parameter.show_default is not False else None
    notes = [" [required]"] if argument.required else []
    if isinstance(default, int | float | str) and not isinstance(default, bool):
        notes.append(f" [default: {default:g}]" if isinstance(default, float) else f" [default: {default}]")
    return f"{argument.parameter.help or ''}{''.join(notes)}"


def _entry(names: str, description: str, width: int) -> Iterator[str]:
    margin = " " * _NAMES
    # what a word is, is not what it looks like: a list of values without spaces may be wider than the column
    lines = textwrap.wrap(description, width, initial_indent=margin, subsequent_indent=margin, break_on_hyphens=False) or [""]
    if len(names) <= _NAMES - 4:
        lines[0] = f"  {names}".ljust(_NAMES) + lines[0][_NAMES:]
    else:
        yield from textwrap.wrap(names, width, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False)
    yield from lines
