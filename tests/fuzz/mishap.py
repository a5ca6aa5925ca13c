"""Random damage to a file, and which parts of the sound file are whole in the damaged one.

Four kinds: the end cut off, single bits flipped, a part repeated, a part spliced (left out, or replaced by other bytes).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

KINDS = ("cut", "flip", "repeat", "splice")


@dataclass(frozen=True, slots=True)
class Mishap:
    """A damaged file.

    Attributes:
        what: The kind of damage and where it is, for a person.
        data: The damaged file.
        kept: Parts of the sound file [start, end) that are whole in it, in order.
    """

    what: str
    data: bytes
    kept: tuple[tuple[int, int], ...]

    def keeps(self, start: int, end: int) -> bool:
        """Return whether these bytes of the sound file are in the damaged one, together."""
        return any(first <= start and end <= last for first, last in self.kept)


def mishap(data: bytes, number: int, seed: int) -> Mishap:
    """Return a damaged file: the kinds take turns, places and sizes are by chance.

    Args:
        data: The sound file.
        number: Which damage; the same number, seed and file give the same.
        seed: Of the random numbers.
    """
    rng = np.random.default_rng([seed, number])
    kind, size = KINDS[number % len(KINDS)], len(data)
    if kind == "cut":
        place = int(rng.integers(size))
        return Mishap(f"cut at {place}", data[:place], ((0, place),))
    if kind == "flip":
        return _flipped(
            data, sorted(set(rng.integers(0, size, int(rng.integers(1, 4))).tolist())), rng
        )
    start = int(rng.integers(size))
    # from single bytes to a third of the file
    end = min(size, start + 1 + int(size / 3 * rng.random() ** 4))
    if kind == "repeat":
        return Mishap(
            f"{start} to {end} repeated", data[:end] + data[start:], ((0, end), (start, size))
        )
    other = int(rng.integers(3))
    filling = (b"", bytes(end - start), rng.bytes(end - start))[other]
    how = ("left out", "zeros", "noise")[other]
    return Mishap(
        f"{start} to {end} {how}", data[:start] + filling + data[end:], ((0, start), (end, size))
    )


def _flipped(data: bytes, places: list[int], rng: np.random.Generator) -> Mishap:
    damaged = bytearray(data)
    for place in places:
        damaged[place] ^= 1 << int(rng.integers(8))
    edges = [-1, *places, len(data)]
    kept = tuple((first + 1, last) for first, last in pairwise(edges))
    return Mishap(f"bits flipped in {places}", bytes(damaged), kept)
