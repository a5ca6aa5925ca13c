"""Observations of the current, vehicle states, and the innovations of the estimator."""

import math
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.text import place_text, span_text, time_text

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
    """

    kind: Literal["varied", "constant", "zero"] = "varied"
    digest: bytes = b""
    texture: Array | None = field(default=None, compare=False)
    along_beams: bool = False
    depth: float = math.nan
    error_velocity: float = math.nan


#: Of a ping that has too few of them.
NO_RAW_VALUES = RawValues()


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
    def as_profile(self) -> "Observation":
        """Itself; see ``PathMean.as_profile``."""
        return self

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
    def as_profile(self) -> Observation:
        """A profile of one bin at the path's mean depth, and at its position at half of its time."""
        middle = min(int(np.searchsorted(np.cumsum(self.weight), 0.5)), self.weight.size - 1)
        return Observation(
            self.time_ns,
            float(self.longitude[middle]),
            float(self.latitude[middle]),
            np.array([float(self.weight @ self.depth)]),
            np.array([self.used]),
            np.array([self.used_std]),
            "earth",
            np.array([Flag.GOOD], np.int8),
            np.zeros(1, np.int32),
            self.dive,
            self.source,
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


#: What an estimator may be given.
Measurement = Observation | PathMean


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
