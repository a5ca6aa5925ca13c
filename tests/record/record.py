"""What version 0.3 answers, kept as data whose digests the budget names: loading it, and what differs from it.

``files/`` holds estimates, results and settings that 0.3 wrote, ``answers/`` what it answered, as packed JSON of 7 significant digits. A
record has names on each level, down to a number, a text, None, or a list of these.
"""

import hashlib
import json
import lzma
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tests.budget import BUDGET

_HERE = Path(__file__).parent
FILES, ANSWERS = _HERE / "files", _HERE / "answers"
#: How far numbers may be from those of a record, or of one name in it: absolute, and relative to the larger one. Either is enough; of
#: integers, such as times, the absolute one counts.
TOLERANCES: Mapping[str, tuple[float, float]] = {
    "accuracy.relative_error": (0.004, 0.0),
    "accuracy.coverage_90": (0.02, 0.0),
    "accuracy.coverage_by_level": (0.05, 0.0),
    "accuracy": (0.0, 0.02),
    "files": (1e-4, 1e-5),
    "measured": (1e-6, 1e-6),
    "measured.longitude": (1.0, 0.0),  # 1e-6 degrees
    "measured.latitude": (1.0, 0.0),
    "faults": (0.0, 0.0),
    "missions": (5.0, 0.0),  # m
    "missions.hours": (0.0, 0.01),
    "missions.legs": (1.0, 0.0),
    "paper": (1e-6, 1e-6),
    "paper.glides": (2.0, 0.0),  # m
}
# On how many levels, from the outermost on, answers may be some of the record's.
_CHOSEN = {"accuracy": 3, "missions": 2, "paper": 2}
_DIGITS = 7


class Difference(NamedTuple):
    """Something that is not answered as it was.

    Attributes:
        at: Its names, from the outermost on.
        kept: In the record; None where it has nothing.
        today: Answered now.
    """

    at: tuple[str, ...]
    kept: Any
    today: Any


def load(name: str) -> Any:
    """Return a record.

    Raises:
        ValueError: Its file is not the one that was kept.
    """
    return unpacked(ANSWERS / f"{name}.json.xz")


def unpacked(path: Path) -> Any:
    """Return what a file of packed JSON holds; errors as of ``checked``."""
    return json.loads(lzma.decompress(checked(path).read_bytes()))


def checked(path: Path) -> Path:
    """Return the path of a file of the record.

    Raises:
        ValueError: It is not the one that was kept.
    """
    kept = BUDGET["binary"].get(f"tests/record/{path.relative_to(_HERE).as_posix()}")
    if kept not in (None, hashlib.sha256(path.read_bytes()).hexdigest()):
        raise ValueError(f"{path}: not the file that was kept of version 0.3; restore it by git")
    return path


def rounded(value: Any) -> Any:
    """Return what JSON can hold of an answer, numbers with 7 significant digits."""
    if isinstance(value, Mapping):
        return {str(key): rounded(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(each) for each in value]
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    return value


def difference(name: str, rows: Mapping[str, Any]) -> list[Difference]:
    """Return what of some answers differs from a record by more than its tolerance.

    Args:
        name: Of the record.
        rows: Today's answers, with the record's names: all of a record, or some of its sets, of which everything is compared.
    """
    return list(_differing(name, (), load(name), rounded(rows)))


def _differing(name: str, at: tuple[str, ...], kept: Any, today: Any) -> Iterator[Difference]:
    if isinstance(today, Mapping) and isinstance(kept, Mapping):
        some = len(at) < _CHOSEN.get(name, 1)
        for key in today if some else {**kept, **today}:
            yield from _differing(name, (*at, key), kept.get(key), today.get(key))
    elif isinstance(today, list) and isinstance(kept, list) and len(today) == len(kept):
        for k, pair in enumerate(zip(kept, today, strict=True)):
            yield from _differing(name, (*at, str(k)), *pair)
    else:
        named = (TOLERANCES.get(f"{name}.{part}") for part in at)
        absolute, relative = next(filter(None, named), TOLERANCES[name])
        if not _alike(kept, today, absolute, relative):
            yield Difference(at, kept, today)


def _alike(kept: Any, today: Any, absolute: float, relative: float) -> bool:
    if not (isinstance(kept, int | float) and isinstance(today, int | float)):
        return bool(kept == today)
    off, whole = abs(kept - today), isinstance(kept, int) and isinstance(today, int)
    return off <= absolute or (not whole and off <= relative * max(abs(kept), abs(today)))
