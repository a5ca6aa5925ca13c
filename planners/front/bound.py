"""What no vehicle of a given speed can do better."""

from dataclasses import dataclass
from typing import Literal

Limit = Literal["", "legs", "duration", "ways", "current"]


@dataclass(frozen=True, slots=True)
class Bound:
    """What no vehicle of a mission's speed can do better.

    Attributes:
        time: Earliest arrival within the tolerance of the last goal, all others passed [s]; infinite when it is out of reach.
        is_tight: Whether it is near to what such a vehicle can do. Where a current within reach is about as fast as the vehicle, nothing
            better is known than the straight way in the fastest current of all, and what is out of reach of the lattice may be reached.
        most: The longest time considered [s].
        goal: Number of the first goal out of reach, from 0; -1 when there is none.
        nearest: How near one can come to that goal [m].
        when: At which time [s].
        limit: What keeps it out of reach: fewer ``legs`` than the way takes; the longest ``duration``, which the way takes longer than in
            still water; the ``ways``, none of which is open; or the ``current``. Empty when none is out of reach.
    """

    time: float
    most: float
    goal: int = -1
    nearest: float = 0.0
    when: float = 0.0
    is_tight: bool = True
    limit: Limit = ""
