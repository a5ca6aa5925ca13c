"""How a vehicle flew its dives: the speed, depth and glide angle that plans assume unless they are set, and the flight model's error."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from math import atan2, degrees, hypot, isfinite
from statistics import median
from typing import Self

from replay_kit.core.errors import LogError

#: Record of a result with how its vehicle flew.
AS_FLOWN = "replay_kit.as_flown"
# m; from here on depths are given to 10 m
_DEEP = 100.0
# degrees; a steeper dive does not show how the vehicle makes its way
_STEEPEST = 75.0


@dataclass(frozen=True, slots=True)
class FlownDive:
    """A dive from surfacing to surfacing.

    Attributes:
        seconds: Between the fixes before and after it [s].
        depth: Its greatest depth [m].
        along: Horizontal speed through the water [m/s]: of the mean velocity, turns shorten it.
        vertical: Mean vertical speed, down and up alike [m/s].
    """

    seconds: float
    depth: float
    along: float
    vertical: float


def flown_dive(
    seconds: float, way: Iterable[float], depths: Iterable[float], deepest: float
) -> FlownDive | None:
    """Return a dive; None for one that does not show how the vehicle makes its way: its numbers are not known, or it goes up and down only.

    Args:
        seconds: Between the fixes before and after it.
        way: shape (2,) [m/s], mean horizontal velocity through the water.
        depths: shape (n,) [m], along its path.
        deepest: Its greatest depth [m], which ``depths`` need not hold.
    """
    # from the surface and back
    climbed = max(
        sum(abs(after - before) for before, after in pairwise([0.0, *depths, 0.0])), 2.0 * deepest
    )
    dive = FlownDive(seconds, deepest, hypot(*way), climbed / seconds)
    known = isfinite(deepest) and isfinite(dive.along) and isfinite(dive.vertical)
    return (
        dive
        if known and deepest > 0.0 and degrees(atan2(dive.vertical, dive.along)) < _STEEPEST
        else None
    )


@dataclass(frozen=True, slots=True)
class AsFlown:
    """How a vehicle flew: the median of its dives, rounded as displayed, so that plans use the displayed values.

    Attributes:
        speed: Through the water, along the glide, to 1 cm/s [m/s].
        glide_angle_deg: Below the horizontal in descents, to a degree.
        depth: Greatest depth of a dive, to 10 m, or to 1 m below 100 m [m].
        duration: Of a dive, from surfacing to surfacing [s].
        dives: Their number.
    """

    speed: float
    glide_angle_deg: float
    depth: float
    duration: float
    dives: int

    @classmethod
    def of(cls, dives: Sequence[FlownDive]) -> Self | None:
        """Return how a vehicle flew some dives; None without any."""
        if not dives:
            return None
        along, vertical, depth = (
            median(getattr(dive, name) for dive in dives) for name in ("along", "vertical", "depth")
        )
        return cls(
            speed=max(round(hypot(along, vertical), 2), 0.01),
            glide_angle_deg=max(float(round(degrees(atan2(vertical, along)))), 1.0),
            depth=round(depth, -1) if depth >= _DEEP else max(float(round(depth)), 1.0),
            duration=median(dive.seconds for dive in dives),
            dives=len(dives),
        )

    def to_record(self) -> dict[str, str]:
        """Return it as results hold it."""
        return {name: repr(value) for name, value in asdict(self).items()}

    @classmethod
    def in_metadata(cls, metadata: Mapping[str, Mapping[str, str]]) -> Self | None:
        """Return how the vehicle of a result flew, from the result's records by name; None where they do not say it.

        Raises:
            LogError: The record is damaged.
        """
        if (record := metadata.get(AS_FLOWN)) is None:
            return None
        try:
            speed, angle, depth, duration = (
                float(record[name]) for name in ("speed", "glide_angle_deg", "depth", "duration")
            )
            return cls(speed, angle, depth, duration, int(record["dives"]))
        except (KeyError, ValueError) as error:
            raise LogError(
                f"{AS_FLOWN}: expected numbers of how the vehicle flew, got {dict(record)}; replay the log again"
            ) from error


@dataclass(frozen=True, slots=True)
class FlightCorrection:
    """The correction of a log's mean currents, as its dives show it at the end.

    Attributes:
        sizes: Magnitude of the correction of each mean current that was corrected and used [m/s].
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
