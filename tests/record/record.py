"""What version 0.3 answers, kept as data: loading it with digests checked, and what differs from it.

``files/`` holds estimates, results and settings that 0.3 wrote, ``answers/`` what it answered, as JSON of 7 significant digits. A record has
names of its own on each level, down to a number, a text, None, or a list of these.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

_HERE = Path(__file__).parent
FILES, ANSWERS, DIGESTS = _HERE / "files", _HERE / "answers", _HERE / "digests.json"
#: How far numbers of a record may be from today's: absolute, and relative to the larger one. Either is enough.
TOLERANCES: Mapping[str, tuple[float, float]] = {
    "accuracy": (0.004, 0.0),
    "files": (1e-4, 1e-5),
    "measured": (1e-6, 1e-6),
    "faults": (0.0, 0.0),
    "missions": (5.0, 0.01),
    "paper": (2e-3, 1e-6),
}
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
    return json.loads(checked(ANSWERS / f"{name}.json").read_bytes())


def checked(path: Path) -> Path:
    """Return the path of a file of the record.

    Raises:
        ValueError: It is not the one that was kept.
    """
    name, kept = path.relative_to(_HERE).as_posix(), json.loads(DIGESTS.read_text())
    if kept.get(name) != digest(path):
        raise ValueError(f"{path}: not the file that was kept of version 0.3; restore it by git")
    return path


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def held() -> list[Path]:
    """Return the files of the record."""
    return sorted([*FILES.iterdir(), *ANSWERS.iterdir()])


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
        rows: Today's answers, with the record's names, all of them or some on each level.
    """
    return list(_differing((), load(name), rounded(rows), *TOLERANCES[name]))


def _differing(
    at: tuple[str, ...], kept: Any, today: Any, absolute: float, relative: float
) -> Iterator[Difference]:
    if isinstance(today, Mapping) and isinstance(kept, Mapping):
        for key, value in today.items():
            yield from _differing((*at, key), kept.get(key), value, absolute, relative)
    elif isinstance(today, list) and isinstance(kept, list) and len(today) == len(kept):
        for k, pair in enumerate(zip(kept, today, strict=True)):
            yield from _differing((*at, str(k)), *pair, absolute, relative)
    elif not _alike(kept, today, absolute, relative):
        yield Difference(at, kept, today)


def _alike(kept: Any, today: Any, absolute: float, relative: float) -> bool:
    if not (isinstance(kept, int | float) and isinstance(today, int | float)):
        return bool(kept == today)
    off = abs(kept - today)
    return off <= absolute or off <= relative * max(abs(kept), abs(today))
