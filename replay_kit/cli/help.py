"""The words of a command line before they are parsed (files after ``--ensemble``, unknown options), and the help of a command.

The help is laid out here for the width of the terminal, as cyclopts' own loads rich and assembles the options twice.
"""

import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from difflib import get_close_matches
from glob import has_magic
from itertools import takewhile
from pathlib import Path
from typing import Any, get_args, get_type_hints

from cyclopts import ArgumentCollection, Parameter
from cyclopts.argument import Argument

from replay_kit.config.removed import refuse_option
from replay_kit.core.errors import ConfigError

# Columns from which a description begins; longer names have a line of their own.
_NAMES = 26
# A command with more options than this shows in its help those that it requires and these, and all with --help-all.
_MANY = 16
_COMMON = {
    *(
        "--start",
        "--goal",
        "--members",
        "--levels",
        "--config",
        "--report",
        "--follow",
        "--json",
        "--overwrite",
    ),
    *(
        "--as",
        "--depth",
        "--radius",
        "--waypoints",
        "--no-go",
        "--bathymetry",
        "--depart",
        "--samples",
    ),
}
# Up to a full stop or semicolon, not one in a name such as .mcap; and the default at the end.
_FIRST_SENTENCE = re.compile(r"(.*?)(?=[.;](?:\s|$)|$).*?( \[default: [^]]*\])?$", re.DOTALL)


def layout(
    usage: str,
    about: str,
    groups: Iterable[tuple[str, Iterable[tuple[str, str]]]],
    width: int,
    more: str = "",
) -> str:
    """Return a help text no line of which is wider than the terminal.

    Args:
        usage: The form of the command line.
        about: What the command does.
        groups: Heading and entries, each the names of an option, or of a command, and its description.
        width: Columns of the terminal.
        more: Last line: where to look further.
    """
    lines = [*textwrap.wrap(usage, width, subsequent_indent="  "), "", *textwrap.wrap(about, width)]
    for heading, entries in groups:
        lines += ["", f"{heading}:"]
        for names, description in entries:
            lines += _entry(names, description, width)
    return "\n".join([*lines, "", *textwrap.wrap(more, width)] if more else lines) + "\n"


def option_groups(
    arguments: ArgumentCollection, every: bool = True
) -> tuple[list[tuple[str, list[tuple[str, str]]]], int]:
    """Return the options of a command under their headings, and how many are left out; those that must be given come first.

    Args:
        arguments: Of the command.
        every: Show all options with their whole descriptions. If not, and there are many: those needed most, each with its first sentence.
    """
    shown = [argument for argument in arguments if argument.show]
    many = len(shown) > _MANY
    groups: dict[str, list[Argument]] = {"Common options": []} if many else {}
    # the order of groups is theirs, that of options the order in which they are written
    for argument in sorted(shown, key=lambda argument: _group(argument)[0]):
        _, heading = _group(argument)
        common = many and (argument.required or not _COMMON.isdisjoint(argument.names))
        if every or not many or common:
            groups.setdefault("Common options" if common else heading, []).append(argument)
    brief = many and not every
    ordered = (
        (heading, sorted(those, key=lambda argument: not argument.required))
        for heading, those in groups.items()
    )
    entries = [
        (heading, [(_names(argument, brief), _description(argument, brief)) for argument in those])
        for heading, those in ordered
    ]
    return entries, len(shown) - sum(len(those) for those in groups.values())


def command_group(commands: Mapping[str, str]) -> tuple[str, list[tuple[str, str]]]:
    """Return commands and what they do as a group of entries."""
    return "Commands", list(commands.items())


def _group(argument: Argument) -> tuple[int, str]:
    group = argument.parameter.group[0]  # type: ignore[index]
    return group.sort_key, group.name


def _names(argument: Argument, brief: bool) -> str:
    """Return the names of an option, short ones first, with the form of its value; in brief without ``--section.key``."""
    form = argument.parameter.metavar or "|".join(argument.get_choices() or ())
    if not argument.name.startswith("-"):
        return argument.name
    if not form and bool not in (argument.hint, *getattr(argument.hint, "__args__", ())):
        form = {int: "COUNT", float: "NUMBER"}.get(argument.hint, "TEXT")
    names = [name for name in argument.names if not brief or "." not in name]
    return ", ".join(sorted(names, key=lambda name: name.startswith("--"))) + (
        f" {form}" if form else ""
    )


def _description(argument: Argument, brief: bool) -> str:
    """Return what an option does and its default; in brief the first sentence."""
    default = argument.field_info.default if argument.parameter.show_default is not False else None
    notes = [" [required]"] if argument.required else []
    if isinstance(default, int | float | str) and not isinstance(default, bool):
        notes.append(
            f" [default: {default:g}]" if isinstance(default, float) else f" [default: {default}]"
        )
    text = argument.parameter.help or ""
    if brief and not argument.required:
        text = "".join(_FIRST_SENTENCE.match(text).groups(""))  # type: ignore[union-attr]
    return f"{text}{''.join(notes)}"


def _entry(names: str, description: str, width: int) -> Iterator[str]:
    margin = " " * _NAMES
    # what a word is, is not what it looks like: a list of values without spaces may be wider than the column
    lines = textwrap.wrap(
        description, width, initial_indent=margin, subsequent_indent=margin, break_on_hyphens=False
    ) or [""]
    if len(names) <= _NAMES - 4:
        lines[0] = f"  {names}".ljust(_NAMES) + lines[0][_NAMES:]
    else:
        yield from textwrap.wrap(
            names, width, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False
        )
    yield from lines


_OPTION, _AS = "--ensemble", "--as"
_ENDINGS = (".nc", ".nc3", ".nc4", ".cdf", ".netcdf", ".zarr")


def repeat_ensembles(arguments: Sequence[str]) -> list[str]:
    """Return a command line in which each file after ``--ensemble`` has the option before it.

    Words that follow the option's value are files of the ensemble if they look like forecasts, and if the logs stand elsewhere: before the
    options, among these words under another ending, or nowhere as in ``info --ensemble A.nc B.nc``. Else they are logs.

    Args:
        arguments: What follows the program's name.
    """
    words, found, position = list(arguments), list[str](), 0
    logs_first = len(words) > 1 and not words[1].startswith("-")
    while position < len(words):
        word = words[position]
        position += 1
        found.append(word)
        if word == _OPTION and position < len(words):
            found.append(words[position])
            position += 1
        elif not word.startswith(f"{_OPTION}="):
            continue
        after = list(takewhile(lambda word: not word.startswith("-"), words[position:]))
        forecasts = [_looks_like_forecast(word) for word in after]
        if logs_first or words[0] == "info" or not all(forecasts):
            for word, forecast in zip(after, forecasts, strict=True):
                found += [_OPTION, word] if forecast else [word]
            position += len(after)
    return found


def spread_vehicles(arguments: Sequence[str]) -> list[str]:
    """Return a command line in which each log after ``--as NAME=`` has the option before it, and is one of the command's logs too.

    Args:
        arguments: What follows the program's name.
    """
    found, logs, words = list[str](), list[str](), list(arguments)
    while words:
        word = words.pop(0)
        option, equals, value = word.partition("=")
        if option != _AS or not (equals or words):
            found.append(word)
            continue
        name, named, first = (value if equals else words.pop(0)).partition("=")
        if not named:
            found += [_AS, name]
            continue
        own = [first, *takewhile(lambda word: not word.startswith("-"), words)]
        del words[: len(own) - 1]
        found += [part for log in own for part in (_AS, f"{name}={log}")]
        logs += own
    return [*found[:1], *logs, *found[1:]]


def _looks_like_forecast(word: str) -> bool:
    named = word.lower().endswith(_ENDINGS) or has_magic(word) or Path(word).is_dir()
    return named or "://" in word or word.startswith("cmems:")


def refuse_unknown(
    command: Callable[..., object],
    words: Sequence[str],
    everywhere: Sequence[str],
    chain: Sequence[str],
) -> None:
    """Raise ConfigError for the first long option that a command does not have.

    Args:
        command: The command's function; its annotations name its options.
        words: The command line.
        everywhere: Options that every command has.
        chain: Names of the command.
    """
    given = [
        word.partition("=")[0]
        for word in takewhile(lambda word: word != "--", words)
        if word.startswith("--")
    ]
    known = {*option_names(command), *everywhere}
    # an underscore is the same as a hyphen
    unknown = next((name for name in given if name.replace("_", "-") not in known), None)
    if unknown is not None:
        refuse_option(" ".join(chain), unknown.replace("_", "-"))
        nearest = "".join(
            f" Did you mean {name}?" for name in get_close_matches(unknown, sorted(known), n=1)
        )
        raise ConfigError(
            f"Unknown option: {unknown}.{nearest} See {' '.join(('replay-kit', *chain))} --help."
        )


def option_names(owner: Any) -> Iterator[str]:
    """Yield the names that annotations state: of a command's options and arguments, and of those in its groups of values.

    Args:
        owner: A function, or the class of a group.
    """
    for annotation in get_type_hints(owner, include_extras=True).values():
        kind, *marks = get_args(annotation) or (annotation,)
        for mark in marks:
            if isinstance(mark, Parameter):
                yield from mark.name or ()
                yield from mark.negative or ()
        if is_dataclass(kind):
            yield from option_names(kind)
