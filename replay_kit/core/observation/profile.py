"""Profiles of the current, and measurements that a user states."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Times
from replay_kit.core.errors import ConfigError
from replay_kit.core.observation.linear import Fix, Label, LinearMeasurement, PathMean
from replay_kit.core.observation.quality import Flag, Reason, Source
from replay_kit.core.words.quantities import measured_at
from replay_kit.core.words.text import place_text, span_text, time_text

Reference = Literal["earth", "platform"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Observation:
    """Profile of the horizontal current: n bins at one position.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        depth: shape (n,) [m], positive down.
        velocity: shape (n, 2) [m/s], true east and true north; NaN where missing.
        error_std: shape (n,) [m/s], instrument error of each component.
        reference: Reference of the velocity.
        flags: shape (n,), QARTOD flags.
        reasons: shape (n,), bit mask of ``Reason``.
        dive: Number of the dive, from 1; 0 before the first dive or for a surface vessel.
        source: Message of the profile.
        common_std: Error common to all bins [m/s], from the platform's velocity; inf if that is unknown and ``velocity`` relative to it.
        correlation_depth: e-folding depth of the correlation of the bins' errors [m]; 0 if independent.
        platform_velocity: Velocity added to that measured relative to the platform, true east and north [m/s]; None if unknown.
        position_std: Standard error of the position, interpolated between positions far apart in time [m]; else 0.
    """

    time_ns: int
    longitude: float
    latitude: float
    depth: Array
    velocity: Array
    error_std: Array
    reference: Reference
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]
    dive: int
    source: Source
    common_std: float = 0.0
    correlation_depth: float = 0.0
    platform_velocity: tuple[float, float] | None = None
    position_std: float = 0.0

    @property
    def linear(self) -> LinearMeasurement:
        """Linear measurement of the profile: one point per bin, all at one position."""
        return LinearMeasurement(
            self.time_ns,
            None,
            np.array([self.longitude]),
            np.array([self.latitude]),
            self.depth,
            None,
            self.velocity,
            self.error_std,
            self.flags,
            self.reasons,
            Label(self.dive, self.source),
            self.common_std,
            self.correlation_depth,
            self.platform_velocity,
        )

    @staticmethod
    def profile(
        time: Any, lon: float, lat: float, depth: Any, u: Any, v: Any, error: Any
    ) -> "Observation":
        """Return a profile of the current, of one depth or more.

        Args:
            time: ISO 8601 text, datetime64, datetime or integer nanoseconds (UTC).
            lon: [degrees east].
            lat: [degrees north].
            depth: shape (n,) [m], positive down.
            u: shape (n,) [m/s], towards true east; NaN where missing.
            v: shape (n,) [m/s], towards true north.
            error: Standard error of each component [m/s], one number or shape (n,).

        Raises:
            ConfigError: Lengths differ, an error is not positive, or a position is invalid.
        """
        depths, east, north = (np.array(x, np.float64, ndmin=1) for x in (depth, u, v))
        errors = _stated_errors(error, depths.size)
        if not depths.shape == east.shape == north.shape == errors.shape or depths.ndim != 1:
            shapes = ", ".join(str(x.shape) for x in (depths, east, north, errors))
            raise ConfigError(
                f"profile: expected depth, u, v and error of one length, got {shapes}"
            )
        place = _stated_fix((time, lon, lat), "profile")
        velocity = np.column_stack([east, north])
        known = np.isfinite(velocity).all(axis=1) & np.isfinite(depths)
        return Observation(
            *(*place, depths, velocity, errors, "earth"),
            flags=np.where(known, Flag.GOOD, Flag.MISSING).astype(np.int8),
            reasons=np.where(known, Reason.NONE, Reason.MISSING).astype(np.int32),
            dive=0,
            source=Source(0, STATED, 0, place.time_ns),
        )

    @staticmethod
    def mean(
        start: tuple[Any, float, float],
        end: tuple[Any, float, float],
        depth: float,
        u: float,
        v: float,
        error: float,
    ) -> "PathMean":
        """Return the mean current of a dive, straight down and up again between two fixes.

        Args:
            start: Time (as in ``profile``), longitude and latitude [degrees] of the fix before the dive.
            end: Fix after it, likewise.
            depth: Greatest depth [m].
            u: [m/s], towards true east.
            v: [m/s], towards true north.
            error: Standard error of each component [m/s].

        Raises:
            ConfigError: The dive does not end after its start, its depth or error is not above 0, or a position is invalid.
        """
        before, after = _stated_fix(start, "start"), _stated_fix(end, "end")
        if not (after.time_ns > before.time_ns and depth > 0.0 and math.isfinite(u + v)):
            raise ConfigError(
                f"mean: expected an end after the start, a depth above 0 and a finite current, got {before.time_ns}, {after.time_ns} ns, "
                f"{depth} m, {u}, {v} m/s"
            )
        share = (np.arange(_PIECES) + 0.5) / _PIECES
        east = (after.longitude - before.longitude + 180.0) % 360.0 - 180.0
        return PathMean(
            time_ns=after.time_ns,
            path_time_ns=before.time_ns
            + np.round(share * (after.time_ns - before.time_ns)).astype(np.int64),
            longitude=before.longitude + share * east,
            latitude=before.latitude + share * (after.latitude - before.latitude),
            depth=depth * (1.0 - np.abs(2.0 * share - 1.0)),
            weight=np.full(_PIECES, 1.0 / _PIECES),
            velocity=(float(u), float(v)),
            error_std=float(_stated_errors(error, 1)[0]),
            kind="dac",
            dive=0,
            source=Source(0, STATED, 0, after.time_ns),
            fixes=(before, after),
            deepest=float(depth),
        )

    @staticmethod
    def component(
        place: tuple[Any, float, float], depth: float, direction: float, speed: float, error: float
    ) -> LinearMeasurement:
        """Return one component of the current at a point, as from a radar or a single-axis current meter.

        Args:
            place: Time (as in ``profile``), longitude and latitude [degrees].
            depth: [m], positive down.
            direction: Direction of positive ``speed``, clockwise from true north [degrees].
            speed: Component of the current [m/s].
            error: Standard error [m/s].

        Raises:
            ConfigError: A number is not finite, the depth is below 0, the error is not above 0, or the position is invalid.
        """
        fix, angle = _stated_fix(place, "component"), math.radians(direction)
        if not (math.isfinite(angle + speed) and 0.0 <= depth < math.inf):
            raise ConfigError(
                f"component: expected a depth from 0 on, a direction and a speed, got {depth} m, {direction} degrees, {speed} m/s"
            )
        return LinearMeasurement(
            *(fix.time_ns, None, np.array([fix.longitude]), np.array([fix.latitude])),
            *(np.array([float(depth)]), None, np.array([[float(speed)]])),
            *(_stated_errors(error, 1), np.full(1, Flag.GOOD, np.int8), np.zeros(1, np.int32)),
            Label(0, Source(0, STATED, 0, fix.time_ns), kind="sensors"),
            components=np.array([[math.sin(angle), math.cos(angle)]]),
        )

    def __repr__(self) -> str:
        """Return time, position and velocities as text."""
        u, v = (span_text(component, 2) for component in self.velocity.T)
        usable = int(np.sum((self.flags == Flag.GOOD) | (self.flags == Flag.SUSPECT)))
        where = f"{time_text(self.time_ns)} at {place_text(self.longitude, self.latitude)}, dive {self.dive}"
        error = (
            f"error {span_text(self.error_std, 2)} m/s (true axes, relative to {self.reference})"
        )
        bins = f"{self.depth.size} bins, {usable} usable, {span_text(self.depth)} m deep"
        return f"Observation {where}: {bins}\n  u {u}, v {v}, {error}"


#: Columns of profiles that an estimator looks at, as of ``core.observation.table.Block``: of the whole profile, and of its bins.
PROFILE = (
    *("time", "input", "topic", "ordinal", "dive", "longitude", "latitude", "position_std"),
    *("common_std", "correlation_depth", "platform"),
)
OF_BINS = ("depth", "velocity", "error_std", "flags", "reasons")


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """Group: n profiles of one instrument and dive, of m bins each, in order of time, assimilated together.

    Attributes:
        columns: ``PROFILE``, shapes (n, ...), and ``OF_BINS``, shapes (n, m, ...).
        topics: Names of topics, by their numbers in ``columns``.
    """

    columns: Mapping[str, NDArray[Any]]
    topics: Sequence[str]

    @staticmethod
    def of(profiles: Sequence[Observation]) -> "Profiles":
        """Return profiles of equal length as columns."""
        topics = sorted({one.source.topic for one in profiles})
        unknown = (np.nan, np.nan)
        rows = [
            (
                *(one.time_ns, one.source.input, topics.index(one.source.topic)),
                *(one.source.position, one.dive, one.longitude, one.latitude, one.position_std),
                *(one.common_std, one.correlation_depth, one.platform_velocity or unknown),
            )
            for one in profiles
        ]
        columns = {
            name: np.array(column)
            for name, column in zip(PROFILE, zip(*rows, strict=True), strict=True)
        }
        bins = {name: np.stack([getattr(one, name) for one in profiles]) for name in OF_BINS}
        return Profiles(columns | bins, topics)

    def __len__(self) -> int:
        """Return the number of profiles."""
        return len(self.columns["time"])

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column."""
        return self.columns[name]

    def changed(self, **columns: NDArray[Any]) -> "Profiles":
        """Return the profiles with other values in some columns."""
        return Profiles({**self.columns, **columns}, self.topics)

    def rows(self, at: Any) -> "Profiles":
        """Return a subset of the profiles."""
        return Profiles({name: column[at] for name, column in self.columns.items()}, self.topics)

    @property
    def time_ns(self) -> int:
        """Mean time of the group [ns, UTC]."""
        return mean_time(self.columns["time"])

    @property
    def longitude(self) -> float:
        """Mean longitude [degrees east]."""
        return mean_longitude(self.columns["longitude"])

    @property
    def latitude(self) -> float:
        """Mean latitude [degrees north]."""
        return float(self.columns["latitude"].mean())

    @property
    def dive(self) -> int:
        """Number of the dive."""
        return int(self.columns["dive"][-1])

    @property
    def source(self) -> Source:
        """Message of the first profile."""
        return self.source_of(0)

    def source_of(self, row: int) -> Source:
        """Return the message of a profile."""
        number, topic, ordinal, time = (
            int(self.columns[name][row]) for name in ("input", "topic", "ordinal", "time")
        )
        return Source(number, self.topics[topic], ordinal, time)


def mean_time(times_ns: Times) -> int:
    """Return the mean of times [ns, UTC]."""
    first = int(times_ns[0])
    return first + round(int((times_ns - first).sum()) / len(times_ns))


def mean_longitude(longitude: Array) -> float:
    """Return the mean of longitudes near one another [degrees east]."""
    return float(longitude[0] + np.mean((longitude - longitude[0] + 180.0) % 360.0 - 180.0))


#: Topic of measurements that a person states, not a log.
STATED = "stated"
# of the way down and up of a mean that is stated; an even number, so that none reaches over the deepest point
_PIECES = 128


def _stated_fix(stated: tuple[Any, float, float], what: str) -> Fix:
    """Return a fix stated by a user.

    Raises:
        ConfigError: The time or position is invalid.
    """
    time, longitude, latitude = stated
    place = float(longitude), float(latitude)
    if not (-180.0 <= place[0] <= 360.0 and abs(place[1]) <= 90.0):
        raise ConfigError(f"{what}: expected longitude and latitude [degrees], got {place}")
    return Fix(int(measured_at(time, what)), *place)


def _stated_errors(error: Any, n: int) -> Array:
    """Return standard errors stated by a user, shape (n,) [m/s].

    Raises:
        ConfigError: One is missing or not above 0.
    """
    errors = np.array(error, np.float64)
    if not (errors > 0.0).all() or not np.isfinite(errors).all():
        raise ConfigError(
            f"error: expected the standard error of each component [m/s], above 0, got {error!r}; it is not guessed"
        )
    return np.full(n, errors) if errors.ndim == 0 else errors


#: What an estimator may be given.
Measurement = Observation | Profiles | PathMean | LinearMeasurement


def kind_of(measurement: Measurement) -> str:
    """Return the kind of a measurement: ``profiles``, ``dac``, ``drift`` or that of its label."""
    if isinstance(measurement, LinearMeasurement):
        return measurement.label.kind
    return measurement.kind if isinstance(measurement, PathMean) else "profiles"
