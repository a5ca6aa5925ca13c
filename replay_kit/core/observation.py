"""Observations of the current, vehicle states, and the innovations of the estimator."""

import math
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.text import place_text, span_text, time_text
from replay_kit.core.time import to_time_ns

Reference = Literal["earth", "platform"]


class Flag(IntEnum):
    """QARTOD flags."""

    GOOD = 1
    NOT_EVALUATED = 2
    SUSPECT = 3
    FAIL = 4
    MISSING = 9


_GOOD, _SUSPECT = np.int8(Flag.GOOD), np.int8(Flag.SUSPECT)


def usable(flags: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return which bins are used: good ones and suspect ones; where the latter are unwanted, measurement quality control fails them."""
    return np.asarray((flags == _GOOD) | (flags == _SUSPECT))


class Reason(IntFlag):
    """Why a bin or a ping was not used, or why it is suspect: its flag says which."""

    NONE = 0
    MISSING = 1
    ABOVE_SURFACE = 2
    BELOW_GRID = 4
    OUTSIDE_REGION = 8
    PLATFORM_REFERENCE = 16
    NOT_EARTH_COORDINATES = 32
    NO_POSITION = 64
    MALFORMED = 128
    GROSS_RANGE = 256
    ON_LAND = 512
    BELOW_BOTTOM = 1024
    LOW_CORRELATION = 2048
    LOW_AMPLITUDE = 4096
    LOW_SNR = 8192
    LOW_PERCENT_GOOD = 16384
    ERROR_VELOCITY = 32768
    HIGH_SPEED = 65536
    TILT = 131072
    SIDELOBE = 262144
    OUTLIER = 524288
    AT_SURFACE = 1048576
    DUPLICATE = 2097152
    OUT_OF_ORDER = 4194304
    DEAD = 8388608
    INCONSISTENT = 16777216


def reasons_of(reasons: NDArray[np.int32], flags: NDArray[np.int8]) -> list[tuple[str, int]]:
    """Return the names of the reasons for which bins are not used, each with its number of bins."""
    not_used = reasons[~usable(flags)]
    found = int(np.bitwise_or.reduce(not_used, initial=0))
    return [
        (str(reason.name).lower(), int(np.count_nonzero(not_used & reason.value)))
        for reason in Reason
        if found & reason.value
    ]


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Where the vehicle was at one time.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down; NaN when unknown.
        dead_reckoned: True when the position was not measured but computed.
        source: The message it came from.
    """

    time_ns: int
    longitude: float
    latitude: float
    depth: float
    dead_reckoned: bool
    source: "Source"


@dataclass(frozen=True, slots=True)
class Source:
    """Pointer to the message that a value came from.

    Attributes:
        input: Position of the log among the run's inputs.
        topic: Channel name.
        position: Ordinal or byte offset in that log.
        time_ns: The message's time [ns, UTC].
    """

    input: int
    topic: str
    position: int
    time_ns: int


@dataclass(frozen=True, slots=True)
class RawValues:
    """What is remembered of a ping as the instrument gave it, before any rotation.

    Attributes:
        kind: ``zero`` when all velocities are zero, ``constant`` when all cells are equal, else ``varied``.
        digest: Equal for equal velocities; empty with too few of them.
        texture: shape (n - 2, k), second differences along the profile of each component or beam [m/s]; None with too few cells.
        along_beams: Whether the velocities were along beams.
        depth: Of the transducer, by the ping's own pressure [m]; NaN where it states none.
        error_velocity: Mean over the profile of what no velocity explains in the beams [m/s]; NaN where it is not known.
        heading: Of the instrument, clockwise from true or magnetic north [degrees]; NaN where it is not stated.
    """

    kind: Literal["varied", "constant", "zero"] = "varied"
    digest: bytes = b""
    texture: Array | None = field(default=None, compare=False)
    along_beams: bool = False
    depth: float = math.nan
    error_velocity: float = math.nan
    heading: float = math.nan


#: Of a ping that has too few of them.
NO_RAW_VALUES = RawValues()


#: Sources of measurements beside the vehicle's own profiles and mean currents.
Kind = Literal["", "shear", "radar", "drifters"]


@dataclass(frozen=True, slots=True)
class Label:
    """What statistics say of a measurement; no estimate depends on it.

    Attributes:
        dive: Number of the dive; as in ``Observation``.
        source: The message that completed it.
        mean: The mean along a path that it was made of; None for others.
        kind: ``shear``, ``radar`` or ``drifters``; empty for the vehicle's own profiles and mean currents.
        doubt: What may be wrong with it, in words; empty where nothing is known.
    """

    dive: int
    source: Source
    mean: "PathMean | None" = None
    kind: Kind = ""
    doubt: str = ""


#: Of a sensor that measures both components of the current: true east, true north.
BOTH_COMPONENTS = np.eye(2)


@dataclass(frozen=True, slots=True, eq=False)
class LinearMeasurement:
    """Sums of the current's components at points: what every measurement is to an estimator.

    Value i of component c is the sum over the points p of ``weights[i, p]`` times the current at p along ``components[c]``. The values of
    a component err with the covariance s_i s_j r_ij + c^2, where r_ij is stated or exp(-|z_i - z_j| / L), those of two components
    independently.

    Attributes:
        time_ns: When it was known [ns, UTC].
        point_time_ns: shape (P,) [ns, UTC]; None for that time at all points.
        longitude: shape (P,) [degrees east], or (1,) for points at one place.
        latitude: shape (P,) [degrees north], or (1,).
        depth: shape (P,) [m], positive down.
        weights: shape (n, P); None for one point a value.
        value: shape (n, c) [m/s]; NaN where missing.
        error_std: shape (n,) [m/s], s: each value's own error.
        common_std: Error that all values share [m/s], c; inf where the values are relative to an unknown velocity.
        correlation_depth: L [m]; 0 for independent errors.
        flags: shape (n,), QARTOD flags.
        reasons: shape (n,), bit mask of ``Reason``.
        label: For statistics.
        platform_velocity: As in ``Observation``: of an instrument whose systematic errors act along its motion.
        components: shape (c, 2), unit vectors along true east and true north; two of them are orthogonal.
        correlation: shape (n, n), r: of the values' own errors, where it does not depend on depths alone; None for that by L.
    """

    time_ns: int
    point_time_ns: NDArray[np.int64] | None
    longitude: Array
    latitude: Array
    depth: Array
    weights: Array | None
    value: Array
    error_std: Array
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]
    label: Label
    common_std: float = 0.0
    correlation_depth: float = 0.0
    platform_velocity: tuple[float, float] | None = None
    components: Array = field(default_factory=lambda: BOTH_COMPONENTS)
    correlation: Array | None = None

    @property
    def linear(self) -> "LinearMeasurement":
        """Itself."""
        return self

    @property
    def dive(self) -> int:
        """Number of the dive."""
        return self.label.dive

    @property
    def source(self) -> Source:
        """The message that completed it."""
        return self.label.source

    @property
    def reference(self) -> Literal["absolute", "relative"]:
        """What the values are: of the current itself, or of it beside an unknown velocity."""
        return "absolute" if np.isfinite(self.common_std) else "relative"

    @property
    def at_one_place(self) -> bool:
        """Whether all points have one longitude and latitude."""
        return self.longitude.size == 1

    @property
    def value_depth(self) -> Array:
        """Depth of each value, shape (n,) [m]: the mean over its points."""
        return self.at_values(self.depth)

    def at_values(self, at_points: Array) -> Array:
        """Return what is known at the points, shape (P, ...), summed for each value, shape (n, ...)."""
        return at_points if self.weights is None else np.asarray(self.weights @ at_points)

    @property
    def middle(self) -> tuple[float, float]:
        """Longitude and latitude [degrees] of the point up to which half of the weight lies."""
        at = 0
        if self.weights is not None and not self.at_one_place:
            at = _half_way(self.weights.mean(axis=0))
        return float(self.longitude[at]), float(self.latitude[at])

    @property
    def value_places(self) -> tuple[Array, Array]:
        """Longitude and latitude of each value [degrees], shapes (n,), as of ``middle``; shapes (1,) where all have one place."""
        if self.weights is None or self.at_one_place or len(self.weights) == 1:
            longitude, latitude = self.middle
            return np.array([longitude]), np.array([latitude])
        at = [_half_way(row) for row in self.weights]
        return self.longitude[at], self.latitude[at]

    def covariance(self, used: NDArray[np.intp]) -> Array:
        """Return the error covariance of some values of a component [m^2/s^2], without the shared error where that is infinite."""
        own, depth = self.error_std[used], self.value_depth[used]
        cov = np.diag(own**2)
        if self.correlation is not None:
            cov = np.outer(own, own) * self.correlation[np.ix_(used, used)]
        elif self.correlation_depth > 0.0:
            distance = np.abs(depth[:, None] - depth) / self.correlation_depth
            cov = np.outer(own, own) * np.exp(-distance)
        return cov + self.common_std**2 if 0.0 < self.common_std < np.inf else cov


def _half_way(weights: Array) -> int:
    """Return the point up to which half of the weight lies."""
    share = np.cumsum(weights)
    return min(int(np.searchsorted(share, 0.5)), share.size - 1)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Observation:
    """One profile of the horizontal current: n bins under one position.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        depth: shape (n,) [m], positive down.
        velocity: shape (n, 2) [m/s], true east and true north; NaN where missing.
        error_std: shape (n,) [m/s], the instrument's own error of each component.
        reference: What the velocity is relative to.
        flags: shape (n,), QARTOD flags.
        reasons: shape (n,), bit mask of ``Reason``.
        dive: Number of the dive the profile belongs to, counted from 1; 0 before the first dive or for a surface vessel.
        source: The message it came from.
        common_std: Error of each component that all bins share [m/s], the platform's velocity; inf when that is not known, and
            ``velocity`` is then relative to the platform.
        correlation_depth: Distance along the profile over which the correlation of the bins' own errors falls by e [m]; 0 for
            independent ones.
        platform_velocity: True east and north [m/s], what was added to the velocity measured relative to the platform; None when
            it is not known, or when the instrument's log does not say.
        raw: Of the velocities as the instrument gave them.
        position_std: Standard error of its place [m], interpolated between positions far apart in time; 0 for a place that is near one.
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
    raw: RawValues = NO_RAW_VALUES
    position_std: float = 0.0

    @property
    def linear(self) -> LinearMeasurement:
        """The same as sums of components: each bin is the current at a point, all points lie at one place."""
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
        """Return a profile of the current, or with one depth the current at one place.

        Args:
            time: ISO 8601 text, datetime64, datetime or integer nanoseconds (UTC).
            lon: [degrees east].
            lat: [degrees north].
            depth: shape (n,) [m], positive down.
            u: shape (n,) [m/s], towards true east; NaN where missing.
            v: shape (n,) [m/s], towards true north.
            error: Standard error of each component [m/s], one number or shape (n,).

        Raises:
            ConfigError: The lengths differ, an error is not above 0, or a place is none.
        """
        depths, east, north = (np.atleast_1d(np.asarray(x, np.float64)) for x in (depth, u, v))
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
            start: Time (as of ``profile``), longitude and latitude [degrees] of the fix before it.
            end: Of the fix after it.
            depth: Greatest depth [m].
            u: Towards true east [m/s].
            v: Towards true north [m/s].
            error: Standard error of each component [m/s].

        Raises:
            ConfigError: The dive does not end after it began, its depth or error is not above 0, or a place is none.
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
        """Return one component of the current at a place, as a radar or a current meter with one axis measures it.

        Args:
            place: Time (as of ``profile``), longitude and latitude [degrees].
            depth: [m], positive down.
            direction: Towards which ``speed`` is positive, clockwise from true north [degrees].
            speed: [m/s].
            error: Standard error [m/s].

        Raises:
            ConfigError: A number is not finite, the depth is below 0, the error is not above 0, or the place is none.
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
            Label(0, Source(0, STATED, 0, fix.time_ns), kind="radar"),
            components=np.array([[math.sin(angle), math.cos(angle)]]),
        )

    def __repr__(self) -> str:
        """Return where and when it was made, and what it holds."""
        u, v = (span_text(component, 2) for component in self.velocity.T)
        usable = int(np.sum((self.flags == Flag.GOOD) | (self.flags == Flag.SUSPECT)))
        where = f"{time_text(self.time_ns)} at {place_text(self.longitude, self.latitude)}, dive {self.dive}"
        error = (
            f"error {span_text(self.error_std, 2)} m/s (true axes, relative to {self.reference})"
        )
        bins = f"{self.depth.size} bins, {usable} usable, {span_text(self.depth)} m deep"
        return f"Observation {where}: {bins}\n  u {u}, v {v}, {error}"


class Fix(NamedTuple):
    """A fix at the surface: time [ns, UTC], longitude [degrees east], latitude [degrees north]."""

    time_ns: int
    longitude: float
    latitude: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathMean:
    """The current's mean along a path: a dive's depth-averaged current, or the drift at the surface between two fixes.

    Attributes:
        time_ns: When the path ended and the mean was known [ns, UTC].
        path_time_ns: shape (m,) [ns, UTC], increasing; when the vehicle was at the path's points.
        longitude: shape (m,) [degrees east].
        latitude: shape (m,) [degrees north].
        depth: shape (m,) [m], positive down.
        weight: shape (m,), share of the time spent about each point; sums to one.
        velocity: As the log states it, or as it follows from the fixes, true east and true north [m/s].
        error_std: Error of each component of it [m/s].
        kind: ``dac`` for a dive's depth-averaged current, ``drift`` for the drift at the surface.
        dive: Number of the dive, or of the dive before the drift; as in ``Observation``.
        source: The message that completed it.
        fixes: Before and after the path; None where they are not known.
        corrected: ``velocity`` without the flight model's error, as the dives before show it, true east and true north [m/s]; None where
            they do not.
        flight_std: Error of each component that the flight model adds [m/s], as far as it is counted.
        beside_profiles: Whether profiles that were computed from it, among other things, are used too.
        deepest: Greatest depth of the path [m]; NaN where it is not known.
    """

    time_ns: int
    path_time_ns: NDArray[np.int64]
    longitude: Array
    latitude: Array
    depth: Array
    weight: Array
    velocity: tuple[float, float]
    error_std: float
    kind: Literal["dac", "drift"]
    dive: int
    source: Source
    fixes: tuple[Fix, Fix] | None = None
    corrected: tuple[float, float] | None = None
    flight_std: float = 0.0
    beside_profiles: bool = False
    deepest: float = np.nan

    @property
    def used(self) -> tuple[float, float]:
        """What an estimator is given, true east and true north [m/s]: ``corrected``, or ``velocity`` where there is no correction."""
        return self.velocity if self.corrected is None else self.corrected

    @property
    def used_std(self) -> float:
        """Error of each component of ``used`` [m/s]."""
        return math.hypot(self.error_std, self.flight_std) if self.flight_std else self.error_std

    @property
    def linear(self) -> LinearMeasurement:
        """The same as sums of components: one value, the weighted sum over the path's points."""
        return LinearMeasurement(
            self.time_ns,
            self.path_time_ns,
            self.longitude,
            self.latitude,
            self.depth,
            self.weight[None],
            np.array([self.used]),
            np.array([self.used_std]),
            np.array([Flag.GOOD], np.int8),
            np.zeros(1, np.int32),
            Label(self.dive, self.source, self),
        )

    def __repr__(self) -> str:
        """Return when and over what path the mean was taken, and the mean."""
        (u, v), path = self.velocity, f"{self.depth.size} points, {span_text(self.depth)} m deep"
        corrected = (
            ""
            if self.corrected is None
            else "; corrected u {:.3f}, v {:.3f} +- {:.3f} m/s".format(
                *self.corrected, self.used_std
            )
        )
        return (
            f"PathMean ({self.kind}) {time_text(self.time_ns)}, dive {self.dive}: {path}\n"
            f"  u {u:.3f}, v {v:.3f} +- {self.error_std:.3f} m/s (true axes){corrected}"
        )


#: Topic of measurements that a person states, not a log.
STATED = "stated"
# of the way down and up of a mean that is stated; an even number, so that none reaches over the deepest point
_PIECES = 128


def _stated_fix(stated: tuple[Any, float, float], what: str) -> Fix:
    """Return a time and place that a person states.

    Raises:
        ConfigError: It is none.
    """
    time, longitude, latitude = stated
    place = float(longitude), float(latitude)
    if not (-180.0 <= place[0] <= 360.0 and abs(place[1]) <= 90.0):
        raise ConfigError(f"{what}: expected longitude and latitude [degrees], got {place}")
    return Fix(int(to_time_ns(time)), *place)


def _stated_errors(error: Any, n: int) -> Array:
    """Return standard errors that a person states, shape (n,) [m/s].

    Raises:
        ConfigError: One is missing or not above 0.
    """
    errors = np.asarray(np.nan if error is None else error, np.float64)
    if not (errors > 0.0).all() or not np.isfinite(errors).all():
        raise ConfigError(
            f"error: expected the standard error of each component [m/s], above 0, got {error!r}; it is not guessed"
        )
    return np.full(n, float(errors)) if errors.ndim == 0 else errors


#: What an estimator may be given.
Measurement = Observation | PathMean | LinearMeasurement


def kind_of(measurement: Measurement) -> str:
    """Return ``profiles``, the kind of a mean along a path, or that of another source."""
    if isinstance(measurement, LinearMeasurement):
        return measurement.label.kind
    return measurement.kind if isinstance(measurement, PathMean) else "profiles"


Decision = Literal["accepted", "softened", "rejected", "unusable"]


@dataclass(frozen=True, slots=True)
class GroupTotals:
    """Sums over the profiles of a superobservation, each against the estimate of its turn.

    Attributes:
        softened: Number of profiles whose errors the gate increased.
        bins: Number of bins used.
        before: Squared innovations [m^2/s^2], of all bins and both components.
        after: Squared residuals after the update [m^2/s^2].
        prior: Squared innovations against the prior without observations [m^2/s^2].
        not_used: Number of bins not used, by reason.
    """

    softened: int
    bins: int
    before: float
    after: float
    prior: float
    not_used: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Innovation:
    """The innovation of one observation: measured minus predicted, before and after the update.

    Attributes:
        time_ns: [ns, UTC].
        depth: shape (n,) [m], the bins offered to the estimator, used or not.
        innovation: shape (n, 2) [m/s], local east and north, measured minus predicted; NaN for bins not used. Of a mean current that is
            corrected for the flight model's error, corrected minus predicted; so are the others.
        innovation_std: shape (n, 2) [m/s], predicted standard deviation of the innovation.
        residual: shape (n, 2) [m/s], measured minus estimated after the update.
        prior_innovation: shape (n, 2) [m/s], measured minus predicted by the prior that has seen no observation.
        nis: Normalised innovation squared of all rows used.
        dof: Number of rows used.
        accepted: False when no bin was usable, or the gate rejected the profile.
        error_inflation: Factor, at least 1, by which the bins' error variance was grown in the update, because their scatter or the
            correlation of their residuals asked for it, or to soften it; ``innovation_std`` and ``nis`` are those of the stated errors.
        flags: shape (n,), QARTOD flags after the region's checks.
        reasons: shape (n,), bit mask of ``Reason``.
        dive: As in the observation.
        source: As in the observation.
        decision: What was done with the observation.
        gate_statistic: Normalised innovation squared of what the observation says of the estimate, with adapted errors.
        gate: What ``gate_statistic`` was held against; inf without a gate.
        signal_dof: Degrees of freedom for signal: how many independent values of the estimate the observation determined.
        prior_inflation: Factor by which the estimate's covariance was grown after the observation, as too many lay outside it.
        log_likelihood: Logarithm of the measured values' density under the prediction, with the stated errors, without the constant of
            2 pi; NaN without a usable bin, or when the estimator predicts no variance.
        mean_current: shape (2,) [m/s], local east and north, what a mean along a path measured; None for a profile.
        mean_kind: Of the mean along a path, as in ``PathMean``; empty for a profile.
        mean_std: Error of each component of ``mean_current`` [m/s].
        corrected_current: shape (2,) [m/s], ``mean_current`` without the flight model's error; None where there is no correction.
        corrected_std: Error of each component of it [m/s].
        estimated_std: Error of each component of the estimate's mean along the path after the update [m/s]; NaN where it is not known.
        replayed_residual: shape (n, 2) [m/s], of a smoothed result: the residual before smoothing; None in others.
        profiles: Number of profiles that it holds. Where several are combined, depths, innovations and residuals are means over them,
            ``nis`` and ``dof`` are sums, the gate's result is that of the first, and ``source`` is its message.
        totals: Of several profiles; None for one.
    """

    time_ns: int
    depth: Array
    innovation: Array
    innovation_std: Array
    residual: Array
    prior_innovation: Array
    nis: float
    dof: int
    accepted: bool
    error_inflation: float
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]
    dive: int
    source: Source
    decision: Decision = "accepted"
    gate_statistic: float = float("nan")
    gate: float = float("inf")
    signal_dof: float = float("nan")
    prior_inflation: float = 1.0
    log_likelihood: float = float("nan")
    mean_current: Array | None = None
    mean_kind: str = ""
    mean_std: float = float("nan")
    corrected_current: Array | None = None
    corrected_std: float = float("nan")
    estimated_std: float = float("nan")
    replayed_residual: Array | None = None
    profiles: int = 1
    totals: GroupTotals | None = None

    @property
    def used_current(self) -> Array | None:
        """What the estimate was given of a mean along a path, shape (2,) [m/s], local east and north: corrected, where it is."""
        return self.mean_current if self.corrected_current is None else self.corrected_current

    def __repr__(self) -> str:
        """Return what was done with the observation, and how far it lay from the prediction."""
        parts = (part[np.isfinite(part)] for part in (self.innovation, self.residual))
        before, after = (f"{np.sqrt(np.mean(part**2)):.3f}" if part.size else "-" for part in parts)
        bins = f"{self.depth.size} bins, {span_text(self.depth)} m deep"
        return (
            f"Innovation {time_text(self.time_ns)}, dive {self.dive}: {self.decision}, {bins}\n"
            f"  RMS {before} m/s before and {after} m/s after the update, NIS {self.nis:.1f} of {self.dof} degrees of freedom"
        )
