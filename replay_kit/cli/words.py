"""The words of a command line before they are parsed: files after ``--ensemble``, and unknown options.

A shell makes several words of a pattern, and each of them is a file of the ensemble. Unknown options are refused by their names alone:
binding a hundred options takes longer than all else that precedes the message.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass
from difflib import get_close_matches
from glob import has_magic
from itertools import takewhile
from pathlib import Path
from typing import Any, get_args, get_type_hints

from cyclopts import Parameter

from replay_kit.core.errors import ConfigError

_OPTION = "--ensemble"
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
