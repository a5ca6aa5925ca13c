"""The bottom around a region, as results hold it."""

from dataclasses import dataclass

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Seabed:
    """Depth of the bottom on a regular grid of the local frame.

    Attributes:
        east: shape (I,) [m], cell centres, evenly spaced.
        north: shape (J,) [m], cell centres, evenly spaced.
        depth: shape (J, I) [m], positive down; land is 0 or less, NaN where it is unknown.
    """

    east: Array
    north: Array
    depth: Array
