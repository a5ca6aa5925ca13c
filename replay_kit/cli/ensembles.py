"""Files after ``--ensemble``: a shell makes several words of a pattern, and each of them is a file of the ensemble."""

from collections.abc import Sequence
from glob import has_magic
from itertools import takewhile
from pathlib import Path

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
    return word.lower().endswith(_ENDINGS) or has_magic(word) or Path(word).is_dir()
