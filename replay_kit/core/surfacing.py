"""Predicted and actual surfacings of dives and of a plan's first leg."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos, hypot, inf, nan, radians, sin, sqrt
from typing import Any, Literal

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import grid_bearing_of_true_north, heading_deg, to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, VehicleState


def offset_between(begin: Any, end: Any) -> tuple[float, float]:
    """Return the offset between two positions, true east and north [m]; both have longitude and latitude."""
    east, north = to_local(Projection(begin.longitude, begin.latitude), end.longitude, end.latitude)
    return float(east), float(north)


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Ellipse of predicted surfacings.

    Attributes:
        longitude: Centre [degrees east].
        latitude: Centre [degrees north].
        major: Semi-major axis [m].
        minor: Semi-minor axis [m].
        bearing_deg: Bearing of the major axis, clockwise from true north, in [0, 180).
    """

    longitude: float
    latitude: float
    major: float
    minor: float
    bearing_deg: float

    def scaled(self, factor: float) -> "Ellipse":
        """Return the ellipse with its axes scaled."""
        return replace(self, major=factor * self.major, minor=factor * self.minor)

    def holds(self, longitude: float, latitude: float) -> bool:
        """Return whether a position lies inside."""
        along, across = self._axis_distances(longitude, latitude)
        # an ellipse without width holds what lies on it
        return hypot(along * self.minor, across * self.major) <= self.major * self.minor

    def radius_of(self, longitude: float, latitude: float) -> float:
        """Return the scale factor for the ellipse to reach a position; infinite if it has no width."""
        along, across = self._axis_distances(longitude, latitude)
        return hypot(along / self.major, across / self.minor) if self.minor > 0.0 else inf

    def _axis_distances(self, longitude: float, latitude: float) -> tuple[float, float]:
        """Return the distances of a position from the centre along and across the major axis [m]."""
        east, north = offset_between(self, Fix(0, longitude, latitude))
        bearing = radians(self.bearing_deg)
        return (
            east * sin(bearing) + north * cos(bearing),
            east * cos(bearing) - north * sin(bearing),
        )

    def outline(self, projection: Projection) -> Array:
        """Return the outline in a local frame, shape (37, 2) [m], counter-clockwise (RFC 7946), the last point equal to the first."""
        # the last point is the first to the last bit
        angle = np.deg2rad(10.0 * (np.arange(37) % 36))
        turn = grid_bearing_of_true_north(projection, self.longitude, self.latitude)
        bearing = radians(self.bearing_deg) + float(turn)
        # the second axis to the left of the first, so that the angle grows counter-clockwise
        along, across = self.major * np.cos(angle), -self.minor * np.sin(angle)
        east, north = to_local(projection, self.longitude, self.latitude)
        east = east + along * sin(bearing) + across * cos(bearing)
        return np.column_stack([east, north + along * cos(bearing) - across * sin(bearing)])


#: Names of an ellipse's numbers, in order, in the record of a leg.
ON_LEG = tuple(
    f"ellipse_{name}" for name in ("longitude", "latitude", "major_m", "minor_m", "bearing_deg")
)


def planned_ellipses(legs: Sequence[Mapping[str, float]]) -> list[Ellipse]:
    """Return the ellipses of a plan's surfacings, of legs that have one."""
    return [Ellipse(*(leg[name] for name in ON_LEG)) for leg in legs if ON_LEG[2] in leg]


@dataclass(frozen=True, slots=True)
class Surfacing:
    """Predicted surfacing at the end of a plan's first leg.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        ellipse: Ellipse of 90 % of the samples; None without samples.
    """

    time_ns: int
    longitude: float
    latitude: float
    ellipse: Ellipse | None = None


@dataclass(frozen=True, slots=True)
class SurfacingOutcome:
    """Predicted surfacing of a plan and the vehicle's next surfacing.

    Attributes:
        planned_ns: Start of the plan [ns, UTC].
        predicted: Predicted surfacing.
        time_ns: Time of the surfacing [ns, UTC].
        longitude: Position of the surfacing [degrees east].
        latitude: Position of the surfacing [degrees north].
        distance: Distance from the predicted position [m].
        direction_deg: Direction from the predicted position, clockwise from true north.
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
        """Delay of the surfacing against its prediction [s]."""
        return (self.time_ns - self.predicted.time_ns) / 1e9

    @property
    def inside(self) -> bool | None:
        """Whether the vehicle surfaced inside the ellipse; None without one."""
        ellipse = self.predicted.ellipse
        return None if ellipse is None else ellipse.holds(self.longitude, self.latitude)


def surfacing_outcome(planned_ns: int, predicted: Surfacing, fix: VehicleState) -> SurfacingOutcome:
    """Return the outcome of a predicted surfacing.

    Args:
        planned_ns: Start of the plan [ns, UTC].
        predicted: Predicted surfacing.
        fix: Fix at which the vehicle surfaced.
    """
    off, place = offset_between(predicted, fix), (fix.time_ns, fix.longitude, fix.latitude)
    return SurfacingOutcome(planned_ns, predicted, *place, hypot(*off), float(heading_deg(*off)))


#: What a dive's end is predicted from: the way through the water by the flight model and the mean currents of the dives before; or their
#: mean velocities over ground, beside the estimate of the current or alone.
Basis = Literal["mean_currents", "estimate", "displacements"]

#: Shares of surfacings that the inner and the outer ellipse should hold.
SHARES = (0.5, 0.9)


@dataclass(frozen=True, slots=True)
class DiveForecast:
    """Predicted surfacing of a dive.

    Attributes:
        dive: Number of the dive.
        earlier: Number of dives used for the prediction.
        start: Fix before the dive.
        time_ns: End of the dive [ns, UTC].
        longitude: Predicted surfacing [degrees east].
        latitude: Predicted surfacing [degrees north].
        inner: Ellipse of 50 % probability.
        outer: Ellipse of 90 % probability.
        persistence_radius: Radius of the 90 % circle of persistence [m], from changes of the DAC, or of the velocity over ground, between
            dives; NaN before the first change.
        basis: Basis of the prediction.
        scored: Number of earlier forecasts for calibration; 0 if not tried.
        factor: Calibration factor of the outer ellipse; NaN without calibration.
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
        """Radius of the circle with the area of the outer ellipse [m]."""
        return float(np.sqrt(self.outer.major * self.outer.minor))


@dataclass(frozen=True, slots=True)
class DiveOutcome:
    """Predicted and actual surfacing of a dive.

    Attributes:
        forecast: Prediction from the motion through water alone, without the dive's measurements.
        fix: Fix at which the vehicle surfaced.
        log_score: Log density of the dive's DAC, or velocity over ground, under the forecast [m^-2 s^2].
        persistence_log_score: Log score of persistence; NaN before the first change.
        persistence_distance: Distance of the fix from the prediction by persistence [m]; NaN without one.
    """

    forecast: DiveForecast
    fix: Fix
    log_score: float
    persistence_log_score: float
    persistence_distance: float

    @property
    def distance(self) -> float:
        """Distance from the predicted to the actual position [m]."""
        return hypot(*self.off)

    @property
    def direction_deg(self) -> float:
        """Direction from the predicted to the actual position, clockwise from true north."""
        return float(heading_deg(*self.off))

    @property
    def off(self) -> tuple[float, float]:
        """Offset of the actual from the predicted position, true east and north [m]."""
        return offset_between(self.forecast, self.fix)

    @property
    def in_inner(self) -> bool:
        """Whether the vehicle surfaced in the inner ellipse."""
        return self.forecast.inner.holds(self.fix.longitude, self.fix.latitude)

    @property
    def in_outer(self) -> bool:
        """Whether the vehicle surfaced in the outer ellipse."""
        return self.forecast.outer.holds(self.fix.longitude, self.fix.latitude)


def sequential_score(off: Array, late: Array, errors: Array) -> float:
    """Return the log score of sequential predictions, their stated errors scaled by earlier ones.

    Args:
        off: shape (n,), distances from the predicted positions [m].
        late: shape (n,), delays [s].
        errors: shape (n, 2), stated standard errors of a position component [m] and of the time [s].

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


def prediction_scores(
    dives: Sequence[DiveOutcome], plans: Sequence[SurfacingOutcome]
) -> tuple[int, float, float]:
    """Return the number of surfacings predicted both by habit and by plans, and the log scores of habit and plans.

    Habit: the last dive's velocity over ground for the mean duration of the last three.
    """
    rows = list[tuple[float, ...]]()
    for k in range(1, len(dives)):
        start, fix, lasts = dives[k].forecast.start, dives[k].fix, _flown(dives[k])[1]
        nearest = min(plans, key=lambda plan: abs(plan.time_ns - fix.time_ns), default=None)
        if nearest is None or abs(nearest.time_ns - fix.time_ns) > _ALIKE * 1e9 * lasts:
            continue
        usual, speed = usual_seconds(dives[:k]), _flown(dives[k - 1])[0]
        off = np.array(offset_between(start, fix)) - usual * speed
        ellipse, error = nearest.predicted.ellipse, _PLANNED[0]
        if ellipse is not None:
            error = max(sqrt(ellipse.major * ellipse.minor) / _EDGE, 1.0)
        # where the duration errs, so does the place along the way
        spread = hypot(_HABIT[0] * usual, _HABIT[1] * hypot(*speed))
        by_habit = hypot(*off), lasts - usual, spread, _HABIT[1]
        rows.append((*by_habit, nearest.distance, nearest.late, error, _PLANNED[1]))
    found = np.array(rows).reshape(-1, 2, 4)
    habit, planned = (
        sequential_score(columns[:, 0], columns[:, 1], columns[:, 2:])
        for columns in found.swapaxes(0, 1)
    )
    return len(rows), habit, planned


def usual_seconds(dives: Sequence[DiveOutcome]) -> float:
    """Return the mean duration of the last three of at least one dive [s]."""
    lasts = [_flown(one)[1] for one in dives[-_LAST:]]
    return sum(lasts) / len(lasts)


def _flown(dive: DiveOutcome) -> tuple[Array, float]:
    """Return the velocity over ground of a dive, shape (2,) [m/s], and its duration [s]."""
    seconds = (dive.fix.time_ns - dive.forecast.start.time_ns) / 1e9
    return np.array(offset_between(dive.forecast.start, dive.fix)) / seconds, seconds


#: Scored surfacings from which ellipses are calibrated by them.
CALIBRATING = 19
# Time after which a scored surfacing counts half as much [ns].
_HALF_LIFE_NS = 10 * 86_400_000_000_000


def calibrated_forecast(forecast: DiveForecast, outcomes: Sequence[DiveOutcome]) -> DiveForecast:
    """Return a forecast with ellipses scaled by the outcomes of earlier forecasts.

    Each ellipse is scaled by a weighted quantile of the factors that reach earlier surfacings, recent ones weighing more and the next one
    counting as infinite. For exchangeable dives it has at least its nominal coverage for any distribution. With fewer than 19 outcomes
    (``scored``) it is unchanged.

    Args:
        forecast: Forecast of the next surfacing.
        outcomes: Outcomes of earlier forecasts.

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
    """Return the weighted quantile of values, with an added weight of 1 at infinity."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order]) >= share * (weights.sum() + 1.0) - 1e-12
    return float(values[order][np.argmax(reached)]) if reached.any() else inf


def forecast_place(start: Fix, seconds: float, velocity: Array) -> tuple[float, float]:
    """Return longitude and latitude [degrees] after a time at a mean velocity over ground, shape (2,), true east and north [m/s]."""
    longitude, latitude = to_geographic(
        Projection(start.longitude, start.latitude), *(seconds * velocity)
    )
    return float(longitude), float(latitude)


def ellipse_of(
    longitude: float, latitude: float, cov: Array, radius: float, turn: float = 0.0
) -> Ellipse:
    """Return the ellipse of a covariance about a position.

    Args:
        longitude: Centre [degrees east].
        latitude: Centre [degrees north].
        cov: shape (2, 2) [m^2], true east and north, or axes from which true north is turned.
        radius: Semi-axes in standard deviations.
        turn: Bearing of true north in the axes of the covariance [rad].
    """
    values, vectors = np.linalg.eigh(cov)
    minor, major = radius * np.sqrt(np.maximum(values, 0.0))
    bearing = float(np.rad2deg(np.arctan2(*vectors[:, 1]) - turn)) % 180.0
    return Ellipse(longitude, latitude, float(major), float(minor), bearing)


def held_shares(outcomes: Sequence[DiveOutcome]) -> tuple[float, float]:
    """Return the fractions of at least one surfacing inside the inner and outer ellipses."""
    inner, outer = np.mean([(one.in_inner, one.in_outer) for one in outcomes], axis=0).tolist()
    return inner, outer
