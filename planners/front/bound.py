"""What no vehicle of a given speed can do better."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Bound:
    """What no vehicle of a mission's speed can do better.

    Attributes:
        time: Earliest arrival within the tolerance of the last goal, all others passed [s]; infinite when it is out of reach.
        most: The longest time considered [s].
        goal: Number of the first goal out of reach, from 0; -1 when there is none.
        nearest: How near one can come to that goal [m].
        when: At which time [s].
    """

    time: float
    most: float
    goal: int = -1
    nearest: float = 0.0
    when: float = 0.0
