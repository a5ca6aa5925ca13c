"""The frozen values that flow through replay-kit, from a log's message to a plan.

Arrays are float64 and are never written to after construction. Time is int64 nanoseconds, UTC. Velocities are
(east, north) in m/s. Depth is metres, positive down. Names, frames and units: ``replay_kit/README.md``.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Reference = Literal["earth", "platform"]


@dataclass(frozen=True, slots=True)
class Projection:
    """Centre of the azimuthal equidistant projection (WGS84) that defines a local east-north frame.

    Attributes:
        longitude: Centre [degrees east].
        latitude: Centre [degrees north].
    """

    longitude: float
    latitude: float


class Message(NamedTuple):
    """One decoded message of a log; a tuple, as a log has millions and a frozen dataclass takes four times as long to make.

    Attributes:
        time_ns: The time that orders the replay [ns, UTC], by the clock the reader was asked for.
        topic: Channel name; for MAVLink ``mavlink/{system}/{component}/{NAME}``.
        schema: Schema name as the file gives it (``foxglove.LocationFix``, ``sensor_msgs/msg/NavSatFix``); for MAVLink the
            message's name.
        payload: Plain mapping of field names to numbers, strings, bytes, lists and mappings, whatever the encoding was.
        input: Position of the log among the run's inputs.
        position: Ordinal or byte offset in that log; grows through the file.
    """

    time_ns: int
    topic: str
    schema: str
    payload: Mapping[str, Any]
    input: int
    position: int


@dataclass(frozen=True, slots=True)
class Loss:
    """What a damaged log no longer holds.

    Attributes:
        what: Words for a person: where the damage is and what was done.
        offset: Byte offset in the file at which whole records end.
        bytes: Number of bytes that could not be used.
        messages: Number of messages in them; None when nothing in the file says.
        first_ns: Earliest time that they may have [ns, UTC]; None when nothing in the file says.
        last_ns: Latest.
    """

    what: str
    offset: int
    bytes: int
    messages: int | None = None
    first_ns: int | None = None
    last_ns: int | None = None


@dataclass(frozen=True, slots=True)
class LogReport:
    """What a reader met in one log, complete once its messages were read to the end.

    Attributes:
        path: The log.
        format: ``mcap``, ``tlog``, ``dataflash``, ``seaglider``, ``pd0`` or ``ad2cp``.
        read: Messages met, by topic, decoded or not.
        undecodable: Topic to (count, reason) for what no decoder could read.
        losses: Damage met; empty for a sound file.
        without_stamp: Messages ordered by their log time although the clock is ``header``, because they carry no stamp.
        unchecked: What no checksum covers, so that damage in it would pass unseen: kind to count.
        notes: What a user should know of its clocks, in words.
    """

    path: str
    format: str
    read: Mapping[str, int]
    undecodable: Mapping[str, tuple[int, str]]
    losses: tuple[Loss, ...]
    without_stamp: int = 0
    unchecked: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


class LogReader(Protocol):
    """A log opened for one pass of reading."""

    path: str
    format: str

    def messages(self) -> Iterator[Message]:
        """Yield the decoded messages in the file's order; ``merge`` puts them in the order of their times."""
        ...

    def report(self) -> LogReport:
        """Return what was met so far."""
        ...


class Flag(IntEnum):
    """QARTOD flags."""

    GOOD = 1
    NOT_EVALUATED = 2
    SUSPECT = 3
    FAIL = 4
    MISSING = 9


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


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Where the vehicle was at one time.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down; NaN when unknown.
        dead_reckoned: True when the position was not measured but computed.
        source: The message that said so.
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


@dataclass(frozen=True, slots=True, eq=False)
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


@dataclass(frozen=True, slots=True, eq=False)
class PathMean:
    """The current's mean along a path: a dive's depth-averaged current, or the drift at the surface between two fixes.

    Attributes:
        time_ns: When the path ended and the mean was known [ns, UTC].
        path_time_ns: shape (m,) [ns, UTC], increasing; when the vehicle was at the path's points.
        longitude: shape (m,) [degrees east].
        latitude: shape (m,) [degrees north].
        depth: shape (m,) [m], positive down.
        weight: shape (m,), share of the time spent about each point; sums to one.
        velocity: True east and true north [m/s].
        error_std: Error of each component [m/s].
        kind: ``dac`` for a dive's depth-averaged current, ``drift`` for the drift at the surface.
        dive: Number of the dive, or of the dive before the drift; as in ``Observation``.
        source: The message that completed it.
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


#: What an estimator may be given.
Measurement = Observation | PathMean


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A forecast's grid in its local frame: a product in depth, curvilinear in the horizontal.

    Attributes:
        projection: The local frame.
        longitude: shape (J, I) [degrees east], continuous across the antimeridian.
        latitude: shape (J, I) [degrees north].
        east: shape (J, I) [m], local frame.
        north: shape (J, I) [m], local frame.
        levels: shape (Z,) [m], positive down, increasing.
        wet: shape (Z, J, I), True where the forecast has a velocity.
    """

    projection: Projection
    longitude: Array
    latitude: Array
    east: Array
    north: Array
    levels: Array
    wet: NDArray[np.bool_]

    @property
    def nodes(self) -> Array:
        """Points that are wet at the first level, shape (N, 2) [m], local east and north."""
        top = self.wet[0]
        return np.column_stack([self.east[top], self.north[top]])


@dataclass(frozen=True, slots=True, eq=False)
class Ensemble:
    """Forecast members on one grid. A truth is an ensemble of one.

    Attributes:
        grid: Where the members are given.
        velocity: shape (E, 2, Z, J, I) [m/s], along the local frame's axes; NaN where dry.
        time_ns: Time of the forecast [ns, UTC]; None when the file gives none.
        source: Path of the file, with ``#member`` when one was chosen.
        notes: What a user should know of how the file was read.
    """

    grid: Grid
    velocity: Array
    time_ns: int | None
    source: str
    notes: tuple[str, ...] = ()

    @property
    def n_members(self) -> int:
        """Number of members E."""
        return int(self.velocity.shape[0])


Decision = Literal["accepted", "softened", "rejected", "unusable"]


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """What one observation said against the prediction made before it.

    Attributes:
        time_ns: [ns, UTC].
        depth: shape (n,) [m], the bins offered to the estimator, used or not.
        innovation: shape (n, 2) [m/s], local east and north, measured minus predicted; NaN for bins not used.
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


@dataclass(frozen=True, slots=True)
class Place:
    """A point of the ocean.

    Attributes:
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down.
    """

    longitude: float
    latitude: float
    depth: float


PlanStatus = Literal["reached", "unreachable", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A glide at one constant velocity through water, and where it is predicted to go.

    Attributes:
        status: ``reached`` when the predicted path passes the goal within the tolerance, ``unreachable`` when the best path found
            does not, ``failed`` when the solver gave no usable path.
        start: Where it begins.
        goal: Where it should pass.
        start_time_ns: [ns, UTC].
        heading_deg: Through water, clockwise from true north at the start, in [0, 360).
        glide_angle_deg: Below the horizontal, positive down.
        speed: Through water [m/s].
        velocity_through_water: shape (3,) [m/s], local east, local north, down.
        duration: To the closest approach [s].
        closest_approach: Least predicted distance to the goal [m].
        track_time: shape (n,) [s] since the start.
        track: shape (n, 3) [m], predicted local east, north, depth.
        message: Words for a person, with the limit that binds if any.
        statistics: What the solver did: iterations, starts, return status.
    """

    status: PlanStatus
    start: Place
    goal: Place
    start_time_ns: int
    heading_deg: float
    glide_angle_deg: float
    speed: float
    velocity_through_water: Array
    duration: float
    closest_approach: float
    track_time: Array
    track: Array
    message: str
    statistics: Mapping[str, float | int | str] = field(default_factory=dict)
