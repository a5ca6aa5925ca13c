"""Notes of readers brought together, so that a person reads each once."""

import re
from collections.abc import Iterable, Mapping

# not within names, such as VelocityBeam1
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w])")
_READ_AS = "read as "


def gather(notes: Iterable[str]) -> Mapping[str, list[str]]:
    """Return each note with its occurrences, in the order of the first; those that differ in numbers alone are one, with the ranges."""
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(note if note.startswith(_READ_AS) else _NUMBER.sub("#", note), []).append(
            note
        )
    return {_with_ranges(same): same for same in alike.values()}


def by_variable(notes: Iterable[str]) -> list[str]:
    """Return notes with those that say the same of several variables as one, after the names of all."""
    names: dict[str, list[str]] = {}
    for note in notes:
        name, _, said = note.partition(": ")
        if not said or " " in name:
            name, said = "", note
        names.setdefault(said, []).append(name)
    return [f"{', '.join(of)}: {said}" if of[0] else said for said, of in names.items()]


def short(note: str) -> str:
    """Return a note for a summary, with the number of the variables read in place of their names."""
    if not note.startswith(_READ_AS):
        return note
    return f"{note.count(': ')} variables were read by their names, which replay-kit info lists"


def _with_ranges(same: list[str]) -> str:
    """Return notes that differ in numbers as one, with the least and the largest of each number that differs."""
    numbers = [_NUMBER.findall(note) for note in same]
    columns = iter([list(dict.fromkeys(column)) for column in zip(*numbers, strict=True)])

    def one(match: re.Match[str]) -> str:
        found = sorted(next(columns), key=float)
        return found[0] if len(found) == 1 else f"{found[0]} to {found[-1]}"

    return same[0] if len(set(same)) == 1 else _NUMBER.sub(one, same[0])
