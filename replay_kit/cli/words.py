"""Preprocessing of command-line words: options before the command, files after ``--ensemble``, logs after ``--as``."""

from collections.abc import Collection, Sequence
from glob import glob, has_magic
from itertools import takewhile
from pathlib import Path

_OPTION, _AS = "--ensemble", "--as"
_ENDINGS = (".nc", ".nc3", ".nc4", ".cdf", ".netcdf", ".zarr")


def command_first(arguments: Sequence[str], commands: Collection[str]) -> list[str]:
    """Return a command line with options before the command moved to its end."""
    words = list(arguments)
    if words and words[0].startswith("-"):
        first = next((k for k, word in enumerate(words) if word in commands), 0)
        words = words[first:] + words[:first]
    return words


def repeat_ensembles(arguments: Sequence[str]) -> list[str]:
    """Return a command line with ``--ensemble`` repeated before each of its files.

    Words that follow the option's value are files of the ensemble if they look like forecasts, and if the logs are elsewhere: before the
    options, among these words with another ending, or absent as in ``info --ensemble A.nc B.nc``. Otherwise they are logs.

    Args:
        arguments: Words after the program's name.
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
    """Return a command line with ``--as NAME=`` repeated before each of its logs, which also become logs of the command.

    Args:
        arguments: Words after the program's name.
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
        after = [*takewhile(lambda word: not word.startswith("-"), words)]
        del words[: len(after)]
        # no shell expands a pattern behind a name
        of_vehicle = [*(sorted(glob(first)) or [first]), *after]
        found += [part for log in of_vehicle for part in (_AS, f"{name}={log}")]
        logs += of_vehicle
    return [*found[:1], *logs, *found[1:]]


def _looks_like_forecast(word: str) -> bool:
    named = word.lower().endswith(_ENDINGS) or has_magic(word) or Path(word).is_dir()
    return named or "://" in word or word.startswith("cmems:")
