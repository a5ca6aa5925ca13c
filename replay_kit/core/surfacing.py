"""Where a dive or a plan's first leg is predicted to surface, and where the vehicle did."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import grid_bearing_of_true_north, heading_deg, to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, VehicleState


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse of predicted surfacings.

    Attributes:
        longitude: Of its centre [degrees east].
        latitude: Of its centre [degrees north].
        major: Semi-axis [m].
        minor: Semi-axis [m].
        bearing_deg: Of the major axis, clockwise from true north, in [0, 180).
    """

    longitude: float
    latitude: float
    major: float
    minor: float
    bearing_deg: float

    def holds(self, longitude: float, latitude: float) -> bool:
        """Return whether a place lies inside."""
        east, north = to_local(Projection(self.longitude, self.latitude), longitude, latitude)
        bearing = np.deg2rad(self.bearing_deg)
        along, across = (
            east * np.sin(bearing) + north * np.cos(bearing),
            east * np.cos(bearing) - north * np.sin(bearing),
        )
        # an ellipse without width holds what lies on it
        return bool(
            (along * self.minor) ** 2 + (across * self.major) ** 2 <= (self.major * self.minor) ** 2
        )

    def outline(self, projection: Projection) -> Array:
        """Return its outline in a local frame, shape (37, 2) [m], the last point the first.

        It runs counter-clockwise, as RFC 7946 asks of the outer ring of a polygon.
        """
        # the last point is the first to the last bit
        angle = np.deg2rad(10.0 * (np.arange(37) % 36))
        bearing = np.deg2rad(self.bearing_deg) + float(
            grid_bearing_of_true_north(projection, self.longitude, self.latitude)
        )
        # the second axis to the left of the first, so that the angle grows counter-clockwise
        along, across = self.major * np.cos(angle), -self.minor * np.sin(angle)
        east, north = to_local(projection, self.longitude, self.latitude)
        return np.column_stack(
            [
                east + along * np.sin(bearing) + across * np.cos(bearing),
                north + along * np.cos(bearing) - across * np.sin(bearing),
            ]
        )


def planned_ellipses(legs: Sequence[Mapping[str, float]]) -> list[Ellipse]:
    """Return the ellipses of the surfacings of a plan's legs, of those that have one."""
    names = ("longitude", "latitude", "major_m", "minor_m", "bearing_deg")
    return [
        Ellipse(*(leg[f"ellipse_{name}"] for name in names))
        for leg in legs
        if "ellipse_major_m" in leg
    ]


@dataclass(frozen=True, slots=True)
class Surfacing:
    """Where and when a plan's first leg ends at the surface.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        ellipse: Holds nine of ten samples of the estimate; None without samples.
    """

    time_ns: int
    longitude: float
    latitude: float
    ellipse: Ellipse | None = None


@dataclass(frozen=True, slots=True)
class SurfacingOutcome:
    """A plan's next surfacing beside the vehicle's.

    Attributes:
        planned_ns: When the plan begins [ns, UTC].
        predicted: The predicted surfacing.
        time_ns: When the vehicle surfaced [ns, UTC].
        longitude: Where [degrees east].
        latitude: Where [degrees north].
        distance: From the predicted place to the actual one [m].
        direction_deg: From the predicted place to the actual one, clockwise from true north.
    """

    planned_ns: int
    predicted: Surfacing
    time_ns: int
    longitude: float
    latitude: float
    distance: float
    direction_deg: float

    @property
    def late(self) -> float:
        """How much later than predicted the vehicle surfaced [s]."""
        return (self.time_ns - self.predicted.time_ns) / 1e9

    @property
    def inside(self) -> bool | None:
        """Whether the vehicle surfaced inside the ellipse; None without one."""
        return (
            None
            if self.predicted.ellipse is None
            else self.predicted.ellipse.holds(self.longitude, self.latitude)
        )


def surfacing_outcome(planned_ns: int, predicted: Surfacing, fix: VehicleState) -> SurfacingOutcome:
    """Return a predicted surfacing beside the fix at which the vehicle surfaced.

    Args:
        planned_ns: When the plan begins [ns, UTC].
        predicted: The predicted surfacing.
        fix: The vehicle's.
    """
    east, north = to_local(
        Projection(predicted.longitude, predicted.latitude), fix.longitude, fix.latitude
    )
    away, direction = float(np.hypot(east, north)), float(heading_deg(east, north))
    return SurfacingOutcome(
        planned_ns, predicted, fix.time_ns, fix.longitude, fix.latitude, away, direction
    )


#: What a dive's end is predicted from: the way through the water by the flight model and the mean currents of the dives before; or their
#: mean velocities over ground, beside the estimate of the current or alone.
Basis = Literal["mean_currents", "estimate", "displacements"]

#: Shares of surfacings that the inner and the outer ellipse should hold.
SHARES = (0.5, 0.9)


@dataclass(frozen=True, slots=True)
class DiveForecast:
    """The predicted end of a dive.

    Attributes:
        dive: Its number.
        earlier: Number of dives that it is predicted from.
        start: The fix before it.
        time_ns: When it ends [ns, UTC].
        longitude: Where it is predicted to surface [degrees east].
        latitude: The same [degrees north].
        inner: The ellipse that should hold half of such surfacings.
        outer: The ellipse that should hold nine in ten.
        persistent_radius: Radius of the circle about the place with the last dive's mean current that should hold nine in ten, given how
            much mean currents have changed from dive to dive [m]; NaN before a first change. Without mean currents it is their velocity
            over ground.
        basis: What it is predicted from.
    """

    dive: int
    earlier: int
    start: Fix
    time_ns: int
    longitude: float
    latitude: float
    inner: Ellipse
    outer: Ellipse
    persistent_radius: float
    basis: Basis = "mean_currents"

    @property
    def radius(self) -> float:
        """Radius of the circle as large as the outer ellipse [m]."""
        return float(np.sqrt(self.outer.major * self.outer.minor))


@dataclass(frozen=True, slots=True)
class DiveOutcome:
    """A predicted end of a dive beside the actual one.

    Attributes:
        forecast: Made without anything that was measured in the dive, but for its way through the water.
        fix: At which the vehicle surfaced.
        log_score: Logarithm of the density of the dive's mean current, or velocity over ground, under the forecast [m^-2 s^2]; larger is
            better.
        persistent_log_score: The same of the last dive's mean current, or velocity, with its spread; NaN before a first change.
        persistent_distance: From the place with the last dive's mean current, or velocity, to the fix [m]; NaN without one.
    """

    forecast: DiveForecast
    fix: Fix
    log_score: float
    persistent_log_score: float
    persistent_distance: float

    @property
    def distance(self) -> float:
        """From the predicted place to the actual one [m]."""
        return float(np.hypot(*self.off))

    @property
    def direction_deg(self) -> float:
        """From the predicted place to the actual one, clockwise from true north."""
        return float(heading_deg(*self.off))

    @property
    def off(self) -> tuple[float, float]:
        """From the predicted place to the actual one, true east and north [m]."""
        east, north = to_local(
            Projection(self.forecast.longitude, self.forecast.latitude),
            self.fix.longitude,
            self.fix.latitude,
        )
        return float(east), float(north)

    @property
    def in_inner(self) -> bool:
        """Whether the inner ellipse holds it."""
        return self.forecast.inner.holds(self.fix.longitude, self.fix.latitude)

    @property
    def in_outer(self) -> bool:
        """Whether the outer ellipse holds it."""
        return self.forecast.outer.holds(self.fix.longitude, self.fix.latitude)


def forecast_place(start: Fix, seconds: float, velocity: Array) -> tuple[float, float]:
    """Return longitude and latitude [degrees] after a time at a mean velocity over ground, shape (2,), true east and north [m/s]."""
    longitude, latitude = to_geographic(
        Projection(start.longitude, start.latitude), *(seconds * velocity)
    )
    return float(longitude), float(latitude)


def ellipse_of(longitude: float, latitude: float, cov: Array, radius: float) -> Ellipse:
    """Return an ellipse about a place.

    Args:
        longitude: Of its centre [degrees east].
        latitude: Of its centre [degrees north].
        cov: shape (2, 2) [m^2], true east and north.
        radius: Semi-axes in standard deviations.
    """
    values, vectors = np.linalg.eigh(cov)
    minor, major = radius * np.sqrt(np.maximum(values, 0.0))
    bearing = float(np.rad2deg(np.arctan2(vectors[0, 1], vectors[1, 1]))) % 180.0
    return Ellipse(longitude, latitude, float(major), float(minor), bearing)


def held_shares(outcomes: Sequence[DiveOutcome]) -> tuple[float, float]:
    """Return the shares of surfacings, one at least, in their inner and outer ellipses."""
    return float(np.mean([one.in_inner for one in outcomes])), float(
        np.mean([one.in_outer for one in outcomes])
    )
