"""What every measurement is to an estimator: sums of the current's components at points; and the mean along a path."""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Indices, Times
from replay_kit.core.observation.quality import Flag, Source
from replay_kit.core.text import span_text, time_text


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
    """What statistics say of a measurement; no estimate depends on it.

    Attributes:
        dive: Number of the dive; as in ``Observation``.
        source: The message that completed it.
        mean: The mean along a path that it was made of; None for others.
        kind: ``shear``, ``radar``, ``drifters`` or ``sensors``, of other packages and of single components that a person states; empty
            for the vehicle's own profiles and mean currents.
        doubt: What may be wrong with it, in words; empty where nothing is known.
        vectors: The vectors of which a radar's boxes are averages; None for others.
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

    def covariance(self, used: Indices) -> Array:
        """Return the error covariance of some values of a component [m^2/s^2], without the shared error where that is infinite."""
        return error_covariance(
            self.error_std[used],
            self.value_depth[used],
            self.correlation_depth,
            self.common_std,
            None if self.correlation is None else self.correlation[np.ix_(used, used)],
        )


def error_covariance(
    own: Array,
    depth: Array,
    correlation_depth: float,
    common_std: float,
    correlation: Array | None = None,
) -> Array:
    """Return the error covariance of values, shape (n, n) [m^2/s^2], without the shared error where that is infinite.

    Args:
        own: shape (n,) [m/s], s; all as of ``LinearMeasurement``.
        depth: shape (n,) [m], of each value.
        correlation_depth: L [m].
        common_std: c [m/s].
        correlation: shape (n, n), r; None for that by L.
    """
    if correlation is None:
        correlation = np.eye(len(own))
        if correlation_depth > 0.0:
            correlation = np.exp(-np.abs(depth[:, None] - depth) / correlation_depth)
    shared = common_std**2 if common_std < np.inf else 0.0
    return np.asarray(np.outer(own, own) * correlation + shared)


def _half_way(weights: Array) -> int:
    """Return the point up to which half of the weight lies."""
    share = np.cumsum(weights)
    return min(int(np.searchsorted(share, 0.5)), share.size - 1)


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
        corrected: ``velocity`` without the flight model's error, as the dives before show it [m/s]; None where they do not.
        flight_std: Error of each component that the flight model adds [m/s], as far as it is counted.
        beside_profiles: Whether profiles that were computed from it, among other things, are used too.
        deepest: Greatest depth of the path [m]; NaN where it is not known.
        reckoned: What dead-reckoned positions and fixes say of it, true east and north [m/s]; None without them.
        radius: Of its goal [m]; NaN where none is stated.
        declination: Of the Earth's magnetic field [degrees east]; NaN where none is stated.
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
        first = f"PathMean ({self.kind}) {time_text(self.time_ns)}, dive {self.dive}: {path}"
        text = f"{first}\n  u {u:.3f}, v {v:.3f} +- {self.error_std:.3f} m/s (true axes)"
        if self.corrected is None:
            return text
        u, v = self.corrected
        return f"{text}; corrected u {u:.3f}, v {v:.3f} +- {self.used_std:.3f} m/s"
