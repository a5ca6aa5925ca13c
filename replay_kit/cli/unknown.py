"""Unknown options, refused by their names alone: binding a hundred options takes longer than all else that precedes the message."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass
from difflib import get_close_matches
from itertools import takewhile
from typing import Any, get_args, get_type_hints

from cyclopts import Parameter

from replay_kit.core.errors import ConfigError


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
