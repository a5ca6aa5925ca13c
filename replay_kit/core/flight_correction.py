"""What was taken from mean currents of dives for the flight model's error."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FlightCorrection:
    """The correction of a log's mean currents, as its dives show it at the end.

    Attributes:
        sizes: Length of what was taken from each mean current that was corrected and used [m/s].
        along: Error of the flight model along the way through the water, as a share of it.
        across: The same across the way, to the left.
        along_std: Its standard deviation.
        across_std: Its standard deviation.
        dives: Number of dives from which it is known.
        evidence: Log evidence of the error over none, without the dive on which it rests most [nats].
    """

    sizes: tuple[float, ...]
    along: float
    across: float
    along_std: float
    across_std: float
    dives: int
    evidence: float
