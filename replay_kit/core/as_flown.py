"""Speed, depth and glide angle of a vehicle's dives, the defaults of a plan; and the flight-model error."""

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
    """Flight of one dive, from surfacing to surfacing.

    Attributes:
        seconds: Time between the fixes before and after it [s].
        depth: Greatest depth [m].
        along: Magnitude of the mean horizontal velocity through the water [m/s].
        vertical: Mean vertical speed, down and up alike [m/s].
        begin_ns: Time of the fix before it [ns, UTC]; 0 if unknown.
        yos: Number of yos, each a descent and an ascent.
        radius: Radius of its goal [m]; NaN if not stated.
        declination: Magnetic declination [degrees east]; NaN if not stated.
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
    """Return the flight of a dive; None if a value is unknown or the vehicle moved only vertically.

    Args:
        seconds: Time between the fixes before and after it [s].
        way: shape (2,) [m/s], mean horizontal velocity through the water.
        depths: shape (n,) [m], along its path.
        deepest: Greatest depth [m]; ``depths`` need not reach it.
        begin_ns: Time of the fix before it [ns, UTC]; 0 if unknown.
        radius: Radius of its goal [m]; NaN if not stated.
        declination: Magnetic declination [degrees east]; NaN if not stated.
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
    """Median flight parameters of a vehicle's dives, rounded as displayed.

    Attributes:
        speed: Speed through the water along the glide, to 1 cm/s [m/s].
        glide_angle_deg: Glide angle of descents below the horizontal, to a degree.
        depth: Greatest depth of a dive, to 10 m, or to 1 m below 100 m [m].
        duration: Duration of a dive [s].
        dives: Number of dives.
        speed_std: Spread of the speed [m/s]; None, as the next two, for a single dive.
        depth_std: Spread of the depth [m].
        duration_std: Spread of the duration [s].
        surface_time: Time between dives [s]; None if the log does not show it.
        longest: Duration of the longest dive [s]; None in results of earlier versions.
        yos: Number of yos in a dive.
        radius: Radius of the last goal [m]; None if not stated.
        declination: Magnetic declination at the last dive that states it [degrees east]; None if none does.
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
        """Return the flight parameters of some dives; None without dives."""
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
        """Return the magnetic heading of a true heading [degrees]; None if the declination is unknown."""
        return None if self.declination is None else (heading - self.declination) % 360.0

    @property
    def is_plausible(self) -> bool:
        """Whether the speed is plausible for a glider."""
        return _SLOWEST <= self.speed <= _FASTEST

    def notes(self) -> tuple[str, ...]:
        """Return notes for the user of a plan: number and spread of the dives, and quantities that the log does not show."""
        if self.speed_std is None or self.depth_std is None or self.duration_std is None:
            return (
                ("flight parameters from a single dive, without a spread",)
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
        """Return the flight parameters as a record of a result."""
        return {name: str(value) for name, value in asdict(self).items() if value is not None}

    @classmethod
    def in_metadata(cls, metadata: Mapping[str, Mapping[str, str]]) -> Self | None:
        """Return the flight parameters in the records of a result; None if they are absent.

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
                f"{AS_FLOWN}: expected numbers as flight parameters, got {dict(record)}; replay the log again"
            ) from error


def _spread(values: Sequence[float]) -> float | None:
    """Return the standard deviation estimated from the median absolute deviation; None for fewer than two values."""
    if len(values) < 2:
        return None
    middle = median(values)
    return _OF_MAD * median(abs(value - middle) for value in values)


def _surface_time(dives: Sequence[FlownDive]) -> float | None:
    """Return the median time between consecutive dives [s]; None if fixes are shared or times unknown."""
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
    """Flight-model correction of a log's DACs at its end.

    Attributes:
        sizes: Magnitude of the correction of each corrected and used DAC [m/s].
        along: Flight-model error along the velocity through the water, relative to it.
        across: Relative error across it, to the left.
        along_std: Standard error of ``along``.
        across_std: Standard error of ``across``.
        dives: Number of dives that determine it.
        evidence: Log evidence for the error without the most influential dive [nats].
    """

    sizes: tuple[float, ...]
    along: float
    across: float
    along_std: float
    across_std: float
    dives: int
    evidence: float
