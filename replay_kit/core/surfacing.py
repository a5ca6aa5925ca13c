"""Where a dive or a plan's first leg is predicted to surface, and where the vehicle did."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos, hypot, inf, nan, radians, sin, sqrt
from typing import Any, Literal

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import grid_bearing_of_true_north, heading_deg, to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, VehicleState


def apart(begin: Any, end: Any) -> tuple[float, float]:
    """Return how far towards true east and north a place lies from another [m]; both have longitude and latitude."""
    east, north = to_local(Projection(begin.longitude, begin.latitude), end.longitude, end.latitude)
    return float(east), float(north)


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

    def scaled(self, factor: float) -> "Ellipse":
        """Return an ellipse about the same place with other axes."""
        return replace(self, major=factor * self.major, minor=factor * self.minor)

    def holds(self, longitude: float, latitude: float) -> bool:
        """Return whether a place lies inside."""
        along, across = self._apart(longitude, latitude)
        # an ellipse without width holds what lies on it
        return hypot(along * self.minor, across * self.major) <= self.major * self.minor

    def radius_of(self, longitude: float, latitude: float) -> float:
        """Return the factor by which the ellipse is to be scaled to reach a place; infinite for one without width."""
        along, across = self._apart(longitude, latitude)
        return hypot(along / self.major, across / self.minor) if self.minor > 0.0 else inf

    def _apart(self, longitude: float, latitude: float) -> tuple[float, float]:
        """Return how far a place is from the centre along the major axis and across it [m]."""
        east, north = apart(self, Fix(0, longitude, latitude))
        bearing = radians(self.bearing_deg)
        return (
            east * sin(bearing) + north * cos(bearing),
            east * cos(bearing) - north * sin(bearing),
        )

    def outline(self, projection: Projection) -> Array:
        """Return its outline in a local frame, shape (37, 2) [m], the last point the first.

        It runs counter-clockwise, as RFC 7946 asks of the outer ring of a polygon.
        """
        # the last point is the first to the last bit
        angle = np.deg2rad(10.0 * (np.arange(37) % 36))
        turn = grid_bearing_of_true_north(projection, self.longitude, self.latitude)
        bearing = radians(self.bearing_deg) + float(turn)
        # the second axis to the left of the first, so that the angle grows counter-clockwise
        along, across = self.major * np.cos(angle), -self.minor * np.sin(angle)
        east, north = to_local(projection, self.longitude, self.latitude)
        east = east + along * sin(bearing) + across * cos(bearing)
        return np.column_stack([east, north + along * cos(bearing) - across * sin(bearing)])


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
        ellipse = self.predicted.ellipse
        return None if ellipse is None else ellipse.holds(self.longitude, self.latitude)


def surfacing_outcome(planned_ns: int, predicted: Surfacing, fix: VehicleState) -> SurfacingOutcome:
    """Return a predicted surfacing beside the fix at which the vehicle surfaced.

    Args:
        planned_ns: When the plan begins [ns, UTC].
        predicted: The predicted surfacing.
        fix: The vehicle's.
    """
    off, place = apart(predicted, fix), (fix.time_ns, fix.longitude, fix.latitude)
    return SurfacingOutcome(planned_ns, predicted, *place, hypot(*off), float(heading_deg(*off)))


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
        persistence_radius: Radius of the circle about the place with the last dive's mean current that should hold nine in ten, given how
            much mean currents have changed from dive to dive [m]; NaN before a first change. Without mean currents it is their velocity
            over ground.
        basis: What it is predicted from.
        scored: Number of earlier forecasts by which it may be calibrated; 0 where that was not tried.
        factor: Of its outer ellipse by that; NaN where it is not calibrated.
    """

    dive: int
    earlier: int
    start: Fix
    time_ns: int
    longitude: float
    latitude: float
    inner: Ellipse
    outer: Ellipse
    persistence_radius: float
    basis: Basis = "mean_currents"
    scored: int = 0
    factor: float = nan

    @property
    def radius(self) -> float:
        """Radius of the circle as large as the outer ellipse [m]."""
        return float(np.sqrt(self.outer.major * self.outer.minor))


@dataclass(frozen=True, slots=True)
class DiveOutcome:
    """A predicted end of a dive beside the actual one.

    Attributes:
        forecast: Made with nothing measured in the dive, but its way through the water.
        fix: At which the vehicle surfaced.
        log_score: Logarithm of the density of the dive's mean current, or velocity over ground, under the forecast [m^-2 s^2].
        persistence_log_score: The same of the last dive's mean current, or velocity, with its spread; NaN before a first change.
        persistence_distance: From the place with the last dive's mean current, or velocity, to the fix [m]; NaN without one.
    """

    forecast: DiveForecast
    fix: Fix
    log_score: float
    persistence_log_score: float
    persistence_distance: float

    @property
    def distance(self) -> float:
        """From the predicted place to the actual one [m]."""
        return hypot(*self.off)

    @property
    def direction_deg(self) -> float:
        """From the predicted place to the actual one, clockwise from true north."""
        return float(heading_deg(*self.off))

    @property
    def off(self) -> tuple[float, float]:
        """From the predicted place to the actual one, true east and north [m]."""
        return apart(self.forecast, self.fix)

    @property
    def in_inner(self) -> bool:
        """Whether the inner ellipse holds it."""
        return self.forecast.inner.holds(self.fix.longitude, self.fix.latitude)

    @property
    def in_outer(self) -> bool:
        """Whether the outer ellipse holds it."""
        return self.forecast.outer.holds(self.fix.longitude, self.fix.latitude)


def record(off: Array, late: Array, errors: Array) -> float:
    """Return the log score of predictions made one after the other, their stated errors scaled by those made before.

    Args:
        off: shape (n,), distances from the predicted places [m].
        late: shape (n,), delays [s].
        errors: shape (n, 2), stated standard errors of a component of the place [m] and of the time [s].

    References:
        Dawid (1984), Statistical theory: the prequential approach.
    """
    squares = np.column_stack([0.5 * off**2, late**2]) / errors**2
    # the errors made count beside two as stated
    scales = (2.0 + np.cumsum(squares, axis=0) - squares) / (2.0 + np.arange(len(off))[:, None])
    densities = (np.log(2.0 * np.pi * scales * errors**2) + squares / scales) * [1.0, 0.5]
    return -float(np.sum(densities))


# Stated errors of a plan's surfacing without an ellipse [m] and [s]; those of the habit, the first a speed [m/s].
_PLANNED, _HABIT = (600.0, 600.0), (0.03, 1200.0)
# Standard errors to the edge of an ellipse that holds nine of ten; durations of which the habit takes the mean; share of a dive by which
# the fixes of one surfacing may be apart.
_EDGE, _LAST, _ALIKE = 2.146, 3, 0.25


def records(
    dives: Sequence[DiveOutcome], plans: Sequence[SurfacingOutcome]
) -> tuple[int, float, float]:
    """Return the number of surfacings that habit and plans both predicted, and the record of each.

    By habit a dive goes on with the last one's velocity over ground for the mean duration of the last three.
    """
    rows = list[tuple[float, ...]]()
    for k in range(1, len(dives)):
        start, fix, lasts = dives[k].forecast.start, dives[k].fix, _flown(dives[k])[1]
        one = min(plans, key=lambda plan: abs(plan.time_ns - fix.time_ns), default=None)
        if one is None or abs(one.time_ns - fix.time_ns) > _ALIKE * 1e9 * lasts:
            continue
        usual, speed = usual_seconds(dives[:k]), _flown(dives[k - 1])[0]
        off = np.array(apart(start, fix)) - usual * speed
        ellipse, error = one.predicted.ellipse, _PLANNED[0]
        if ellipse is not None:
            error = max(sqrt(ellipse.major * ellipse.minor) / _EDGE, 1.0)
        # where the duration errs, so does the place along the way
        spread = hypot(_HABIT[0] * usual, _HABIT[1] * hypot(*speed))
        own = hypot(*off), lasts - usual, spread, _HABIT[1]
        rows.append((*own, one.distance, one.late, error, _PLANNED[1]))
    found = np.array(rows).reshape(-1, 2, 4)
    habit, planned = (record(of[:, 0], of[:, 1], of[:, 2:]) for of in found.swapaxes(0, 1))
    return len(rows), habit, planned


def usual_seconds(dives: Sequence[DiveOutcome]) -> float:
    """Return the mean duration of the last three of some dives [s], one at least."""
    lasts = [_flown(one)[1] for one in dives[-_LAST:]]
    return sum(lasts) / len(lasts)


def _flown(dive: DiveOutcome) -> tuple[Array, float]:
    """Return the velocity over ground of a dive, shape (2,) [m/s], and its duration [s]."""
    seconds = (dive.fix.time_ns - dive.forecast.start.time_ns) / 1e9
    return np.array(apart(dive.forecast.start, dive.fix)) / seconds, seconds


#: Scored surfacings from which ellipses are calibrated by them.
CALIBRATING = 19
# Time after which a scored surfacing counts half as much [ns].
_HALF_LIFE_NS = 10 * 86_400_000_000_000


def calibrated(forecast: DiveForecast, outcomes: Sequence[DiveOutcome]) -> DiveForecast:
    """Return a forecast whose ellipses are as large as those before it had to be to hold the shares that they should.

    Each ellipse is scaled to a quantile of the factors that would have let it reach the surfacings so far, later ones counting more, and
    the coming one counting as beyond them all: in exchangeable dives it holds its share or more whatever their distribution. With fewer
    than 19 of them, which the forecast names by ``scored``, it is as it was.

    Args:
        forecast: Of the coming surfacing.
        outcomes: Of earlier ones.

    References:
        Tibshirani et al. (2019), Conformal prediction under covariate shift.
    """
    forecast = replace(forecast, scored=len(outcomes))
    if len(outcomes) < CALIBRATING:
        return forecast
    ages = np.array([forecast.start.time_ns - one.fix.time_ns for one in outcomes])
    weights = 0.5 ** (np.maximum(ages, 0) / _HALF_LIFE_NS)
    radii = [
        [
            getattr(one.forecast, name).radius_of(one.fix.longitude, one.fix.latitude)
            for one in outcomes
        ]
        for name in ("inner", "outer")
    ]
    factors = [
        _quantile(np.array(each), weights, share) for each, share in zip(radii, SHARES, strict=True)
    ]
    if not np.all(np.isfinite(factors)):
        return forecast
    inner, outer = forecast.inner.scaled(factors[0]), forecast.outer.scaled(factors[1])
    return replace(forecast, inner=inner, outer=outer, factor=factors[1])


def _quantile(values: Array, weights: Array, share: float) -> float:
    """Return the least value at or below which lies a share of the weight, with a weight of 1 beyond them all; infinite where none does."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order]) >= share * (weights.sum() + 1.0) - 1e-12
    return float(values[order][np.argmax(reached)]) if reached.any() else inf


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
    inner, outer = np.mean([(one.in_inner, one.in_outer) for one in outcomes], axis=0).tolist()
    return inner, outer
