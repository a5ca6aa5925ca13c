"""How a vehicle flew its dives: the speed, depth and glide angle that plans assume unless they are set, and the flight model's error."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from math import atan2, degrees, hypot, isfinite, nan, radians, sin
from statistics import median
from typing import Any, Self

from replay_kit.core.errors import LogError

#: Record of a result with how its vehicle flew.
AS_FLOWN = "replay_kit.as_flown"
# m; from here on depths are given to 10 m
_DEEP = 100.0
# degrees; a steeper dive does not show how the vehicle makes its way
_STEEPEST = 75.0
# m/s; speeds through water of gliders, a thruster's included: others come of a wrong flight model, or of a vehicle that does not glide
_SLOWEST, _FASTEST = 0.04, 1.0
# standard deviation of a normal distribution over its median absolute deviation
_OF_MAD = 1.4826


@dataclass(frozen=True, slots=True)
class FlownDive:
    """A dive from surfacing to surfacing.

    Attributes:
        seconds: Between the fixes before and after it [s].
        depth: Its greatest depth [m].
        along: Horizontal speed through the water [m/s]: of the mean velocity, turns shorten it.
        vertical: Mean vertical speed, down and up alike [m/s].
        begin_ns: Time of the fix before it [ns, UTC]; 0 where it is not known.
        yos: How often it goes down and up between the two.
        radius: Of its goal [m]; NaN where none is stated.
        declination: Of the Earth's magnetic field [degrees east]; NaN where none is stated.
    """

    seconds: float
    depth: float
    along: float
    vertical: float
    begin_ns: int = 0
    yos: int = 1
    radius: float = nan
    declination: float = nan


def flown_dive(
    seconds: float,
    way: Iterable[float],
    depths: Iterable[float],
    deepest: float,
    begin_ns: int = 0,
    radius: float = nan,
    declination: float = nan,
) -> FlownDive | None:
    """Return a dive; None for one that does not show how the vehicle makes its way: its numbers are not known, or it goes up and down only.

    Args:
        seconds: Between the fixes before and after it.
        way: shape (2,) [m/s], mean horizontal velocity through the water.
        depths: shape (n,) [m], along its path.
        deepest: Its greatest depth [m], which ``depths`` need not hold.
        begin_ns: Time of the fix before it [ns, UTC]; 0 where it is not known.
        radius: Of its goal [m]; NaN where none is stated.
        declination: Of the Earth's magnetic field [degrees east]; NaN where none is stated.
    """
    depths = list(depths)
    # from the surface and back
    climbed = max(
        sum(abs(after - before) for before, after in pairwise([0.0, *depths, 0.0])), 2.0 * deepest
    )
    below = [depth > 0.5 * deepest for depth in (0.0, *depths)]
    yos = max(sum(deep and not before for before, deep in pairwise(below)), 1)
    dive = FlownDive(
        seconds, deepest, hypot(*way), climbed / seconds, begin_ns, yos, radius, declination
    )
    known = isfinite(deepest + dive.along + dive.vertical) and deepest > 0.0
    steep = degrees(atan2(dive.vertical, dive.along)) >= _STEEPEST
    return dive if known and not steep else None


@dataclass(frozen=True, slots=True)
class AsFlown:
    """How a vehicle flew: the median of its dives, rounded as displayed.

    Attributes:
        speed: Through the water, along the glide, to 1 cm/s [m/s].
        glide_angle_deg: Below the horizontal in descents, to a degree.
        depth: Greatest depth of a dive, to 10 m, or to 1 m below 100 m [m].
        duration: Of a dive, from surfacing to surfacing [s].
        dives: Their number.
        speed_std: Spread of the speed [m/s]; None, as the next two, of a single dive.
        depth_std: Spread of the depth [m].
        duration_std: Spread of the duration [s].
        surface_time: Between dives [s]; None where the log does not show it.
        longest: Of the dives [s]; None in results of earlier versions.
        yos: How often a dive goes down and up.
        radius: Of the last goal [m]; None where none is stated.
        declination: Of the last dive that states it [degrees east]; None where none does.
    """

    speed: float
    glide_angle_deg: float
    depth: float
    duration: float
    dives: int
    speed_std: float | None = None
    depth_std: float | None = None
    duration_std: float | None = None
    surface_time: float | None = None
    longest: float | None = None
    yos: int = 1
    radius: float | None = None
    declination: float | None = None

    @classmethod
    def of(cls, dives: Sequence[FlownDive]) -> Self | None:
        """Return how a vehicle flew some dives; None without any."""
        if not dives:
            return None
        along, vertical, depth = (
            median(getattr(dive, name) for dive in dives) for name in ("along", "vertical", "depth")
        )
        speeds = [hypot(dive.along, dive.vertical) for dive in dives]
        return cls(
            speed=max(round(hypot(along, vertical), 2), 0.01),
            glide_angle_deg=max(float(round(degrees(atan2(vertical, along)))), 1.0),
            depth=round(depth, -1) if depth >= _DEEP else max(float(round(depth)), 1.0),
            duration=median(dive.seconds for dive in dives),
            dives=len(dives),
            speed_std=_spread(speeds),
            depth_std=_spread([dive.depth for dive in dives]),
            duration_std=_spread([dive.seconds for dive in dives]),
            surface_time=_surface_time(dives),
            longest=max(dive.seconds for dive in dives),
            yos=int(median(dive.yos for dive in dives)),
            radius=next((dive.radius for dive in reversed(dives) if dive.radius > 0.0), None),
            declination=next(
                (dive.declination for dive in reversed(dives) if isfinite(dive.declination)), None
            ),
        )

    @property
    def vertical(self) -> float:
        """Vertical speed [m/s]."""
        return self.speed * sin(radians(self.glide_angle_deg))

    def magnetic(self, heading: float) -> float | None:
        """Return a true heading as the vehicle's compass shows it [degrees]; None where its declination is not known."""
        return None if self.declination is None else (heading - self.declination) % 360.0

    @property
    def is_plausible(self) -> bool:
        """Whether a glider flies at this speed."""
        return _SLOWEST <= self.speed <= _FASTEST

    def notes(self) -> tuple[str, ...]:
        """Return what of the dives a user of a plan should know: their number and spread, and what the log does not show."""
        if self.speed_std is None or self.depth_std is None or self.duration_std is None:
            return (
                ("the vehicle is known from a single dive: its spread is not known",)
                if self.dives == 1
                else ()
            )
        drift = (
            "is not in the log"
            if self.surface_time is None
            else f"{self.surface_time / 60.0:.0f} min"
        )
        return (
            f"{self.dives} dives: speed {self.speed:.2f} ± {self.speed_std:.2f} m/s, vertical {self.vertical:.2f} m/s, depth ± "
            f"{self.depth_std:.0f} m, {self.duration / 3600.0:.1f} ± {self.duration_std / 3600.0:.1f} h; time at the surface {drift}; "
            "energy per dive is not in the log",
        )

    def to_record(self) -> dict[str, str]:
        """Return it as results hold it."""
        return {name: str(value) for name, value in asdict(self).items() if value is not None}

    @classmethod
    def in_metadata(cls, metadata: Mapping[str, Mapping[str, str]]) -> Self | None:
        """Return how the vehicle of a result flew, from the result's records by name; None where they do not say it.

        Raises:
            LogError: The record is damaged.
        """
        if (record := metadata.get(AS_FLOWN)) is None:
            return None
        try:
            # results of earlier versions state no spread
            numbers: dict[str, Any] = {
                one.name: float(record[one.name]) for one in fields(cls) if one.name in record
            }
            whole = {name: int(numbers.get(name, 1)) for name in ("dives", "yos")}
            return cls(**numbers | whole)
        except (KeyError, TypeError, ValueError) as error:
            raise LogError(
                f"{AS_FLOWN}: expected numbers of how the vehicle flew, got {dict(record)}; replay the log again"
            ) from error


def _spread(values: Sequence[float]) -> float | None:
    """Return the standard deviation of values by their median absolute deviation; None of fewer than two."""
    if len(values) < 2:
        return None
    middle = median(values)
    return _OF_MAD * median(abs(value - middle) for value in values)


def _surface_time(dives: Sequence[FlownDive]) -> float | None:
    """Return the median time between dives that follow each other [s]; None where fixes are shared or no times are known."""
    gaps = [
        (after.begin_ns - before.begin_ns) / 1e9 - before.seconds
        for before, after in pairwise(dives)
        if before.begin_ns
    ]
    # longer ones hold dives that show nothing; a fix that ends one dive and begins the next hides the time between them
    near = [gap for gap, dive in zip(gaps, dives, strict=False) if 0.0 <= gap < 0.5 * dive.seconds]
    return (median(near) if near else 0.0) or None


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
