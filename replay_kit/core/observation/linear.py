"""Linear measurements, sums of the current's components at points; and the mean along a path."""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Indices, Times
from replay_kit.core.observation.quality import Flag, Source
from replay_kit.core.words.text import span_text, time_text


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Position of the vehicle at one time.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down; NaN when unknown.
        dead_reckoned: Whether the position was dead-reckoned.
        source: Message of the position.
    """

    time_ns: int
    longitude: float
    latitude: float
    depth: float
    dead_reckoned: bool
    source: Source


class Fix(NamedTuple):
    """A fix at the surface: time [ns, UTC], longitude [degrees east], latitude [degrees north]."""

    time_ns: int
    longitude: float
    latitude: float


#: Sources of measurements beside the vehicle's own profiles and mean currents.
Kind = Literal["", "shear", "radar", "drifters", "sensors"]


@dataclass(frozen=True, slots=True)
class Label:
    """Origin of a measurement, for statistics; no estimate depends on it.

    Attributes:
        dive: Number of the dive, as in ``Observation``.
        source: Message that completed it.
        mean: Path mean from which it was made; None for others.
        kind: ``shear``, ``radar``, ``drifters`` or ``sensors``, also for other packages and single components; empty for the vehicle's
            profiles and mean currents.
        doubt: Possible defect, as text; empty without one.
        vectors: Radar vectors before averaging into boxes; None for others.
    """

    dive: int
    source: Source
    mean: "PathMean | None" = None
    kind: Kind = ""
    doubt: str = ""
    vectors: "LinearMeasurement | None" = None


#: Of a sensor that measures both components of the current: true east, true north.
BOTH_COMPONENTS = np.eye(2)


@dataclass(frozen=True, slots=True, eq=False)
class LinearMeasurement:
    """Linear measurement: sums of the current's components at points.

    Value i of component c is the sum over the points p of ``weights[i, p]`` times the current at p along ``components[c]``. The error
    covariance of a component is s_i s_j r_ij + c^2, where r_ij is stated or exp(-|z_i - z_j| / L); components are independent.

    Attributes:
        time_ns: Time of availability [ns, UTC].
        point_time_ns: shape (P,) [ns, UTC]; None for that time at all points.
        longitude: shape (P,) [degrees east], or (1,) for points at one position.
        latitude: shape (P,) [degrees north], or (1,).
        depth: shape (P,) [m], positive down.
        weights: shape (n, P); None for one point per value.
        value: shape (n, c) [m/s]; NaN where missing.
        error_std: shape (n,) [m/s], s: independent error of each value.
        common_std: Error common to all values [m/s], c; inf if they are relative to an unknown velocity.
        correlation_depth: L [m]; 0 for independent errors.
        flags: shape (n,), QARTOD flags.
        reasons: shape (n,), bit mask of ``Reason``.
        label: Origin, for statistics.
        platform_velocity: As in ``Observation``, for instruments whose systematic errors act along their motion.
        components: shape (c, 2), unit vectors along true east and true north; two of them are orthogonal.
        correlation: shape (n, n), r: correlation of the independent errors; None for that by L.
    """

    time_ns: int
    point_time_ns: Times | None
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
        """The measurement itself."""
        return self

    @property
    def dive(self) -> int:
        """Number of the dive."""
        return self.label.dive

    @property
    def source(self) -> Source:
        """Message that completed it."""
        return self.label.source

    @property
    def reference(self) -> Literal["absolute", "relative"]:
        """Whether the values are absolute or relative to an unknown velocity."""
        return "absolute" if np.isfinite(self.common_std) else "relative"

    @property
    def at_one_place(self) -> bool:
        """Whether all points have one longitude and latitude."""
        return self.longitude.size == 1

    @property
    def value_depth(self) -> Array:
        """Depth of each value, shape (n,) [m]: mean over its points."""
        return self.at_values(self.depth)

    def at_values(self, at_points: Array) -> Array:
        """Return sums over points, shape (P, ...), for each value, shape (n, ...)."""
        return at_points if self.weights is None else np.asarray(self.weights @ at_points)

    @property
    def middle(self) -> tuple[float, float]:
        """Longitude and latitude [degrees] of the point at half of the cumulative weight."""
        at = 0
        if self.weights is not None and not self.at_one_place:
            at = _half_way(self.weights.mean(axis=0))
        return float(self.longitude[at]), float(self.latitude[at])

    @property
    def value_places(self) -> tuple[Array, Array]:
        """Longitude and latitude of each value [degrees], shapes (n,), as in ``middle``; shapes (1,) at one position."""
        if self.weights is None or self.at_one_place or len(self.weights) == 1:
            longitude, latitude = self.middle
            return np.array([longitude]), np.array([latitude])
        at = [_half_way(row) for row in self.weights]
        return self.longitude[at], self.latitude[at]

    def covariance(self, used: Indices) -> Array:
        """Return the error covariance of some values of a component [m^2/s^2], without an infinite common error."""
        return error_covariance(
            self.error_std[used],
            self.value_depth[used],
            self.correlation_depth,
            self.common_std,
            None if self.correlation is None else self.correlation[np.ix_(used, used)],
        )


def error_covariance(
    error_std: Array,
    depth: Array,
    correlation_depth: float,
    common_std: float,
    correlation: Array | None = None,
) -> Array:
    """Return the error covariance of values, shape (n, n) [m^2/s^2], without an infinite common error.

    Args:
        error_std: shape (n,) [m/s], s; symbols of ``LinearMeasurement``.
        depth: shape (n,) [m], of each value.
        correlation_depth: L [m].
        common_std: c [m/s].
        correlation: shape (n, n), r; None for that by L.
    """
    if correlation is None:
        correlation = np.eye(len(error_std))
        if correlation_depth > 0.0:
            correlation = np.exp(-np.abs(depth[:, None] - depth) / correlation_depth)
    shared = common_std**2 if common_std < np.inf else 0.0
    return np.asarray(np.outer(error_std, error_std) * correlation + shared)


def _half_way(weights: Array) -> int:
    """Return the index of the point at half of the cumulative weight."""
    share = np.cumsum(weights)
    return min(int(np.searchsorted(share, 0.5)), share.size - 1)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathMean:
    """Mean current along a path: a dive's depth-averaged current (DAC), or the drift at the surface between two fixes.

    Attributes:
        time_ns: End of the path, when the mean becomes known [ns, UTC].
        path_time_ns: shape (m,) [ns, UTC], increasing, times at the path's points.
        longitude: shape (m,) [degrees east].
        latitude: shape (m,) [degrees north].
        depth: shape (m,) [m], positive down.
        weight: shape (m,), fraction of the time near each point, sum 1.
        velocity: Stated in the log or derived from fixes, true east and north [m/s].
        error_std: Standard error of each component [m/s].
        kind: ``dac`` for a dive's depth-averaged current, ``drift`` for the drift at the surface.
        dive: Number of the dive, or of the dive before the drift; as in ``Observation``.
        source: Message that completed it.
        fixes: Fixes before and after the path; None if unknown.
        corrected: ``velocity`` corrected for the flight-model error of earlier dives [m/s]; None without a correction.
        flight_std: Error of each component from the flight model [m/s].
        beside_profiles: Whether profiles that depend on it are used too.
        deepest: Greatest depth of the path [m]; NaN if unknown.
        reckoned: Mean current from dead-reckoned positions and fixes, true east and north [m/s]; None without them.
        radius: Radius of the dive's goal [m]; NaN if not stated.
        declination: Magnetic declination [degrees east]; NaN if not stated.
    """

    time_ns: int
    path_time_ns: Times
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
    reckoned: tuple[float, float] | None = None
    radius: float = np.nan
    declination: float = np.nan

    @property
    def used(self) -> tuple[float, float]:
        """Assimilated velocity, true east and north [m/s]: ``corrected``, or ``velocity`` without a correction."""
        return self.velocity if self.corrected is None else self.corrected

    @property
    def used_std(self) -> float:
        """Standard error of each component of ``used`` [m/s]."""
        return math.hypot(self.error_std, self.flight_std) if self.flight_std else self.error_std

    @property
    def linear(self) -> LinearMeasurement:
        """Linear measurement of one value: the weighted sum over the path's points."""
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
        """Return time, path and mean as text."""
        (u, v), path = self.velocity, f"{self.depth.size} points, {span_text(self.depth)} m deep"
        first = f"PathMean ({self.kind}) {time_text(self.time_ns)}, dive {self.dive}: {path}"
        text = f"{first}\n  u {u:.3f}, v {v:.3f} +- {self.error_std:.3f} m/s (true axes)"
        if self.corrected is None:
            return text
        u, v = self.corrected
        return f"{text}; corrected u {u:.3f}, v {v:.3f} +- {self.used_std:.3f} m/s"
