"""Where a dive is expected to surface, from the dives before it, and where it did."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import heading_deg, to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix
from replay_kit.core.surfacing import Ellipse

#: What a dive's end is expected from: the way through the water by the flight model and the mean currents of the dives before; or their
#: mean velocities over ground, beside the estimate of the current or alone.
Basis = Literal["mean_currents", "estimate", "displacements"]

#: Shares of surfacings that the inner and the outer ellipse should hold.
SHARES = (0.5, 0.9)


@dataclass(frozen=True, slots=True)
class DiveForecast:
    """The expected end of a dive.

    Attributes:
        dive: Its number.
        earlier: Number of dives that it is expected from.
        start: The fix before it.
        time_ns: When it ends [ns, UTC].
        longitude: Where it is expected to surface [degrees east].
        latitude: The same [degrees north].
        inner: The ellipse that should hold half of such surfacings.
        outer: The ellipse that should hold nine in ten.
        persistent_radius: Radius of the circle about the place with the last dive's mean current that should hold nine in ten, given how
            much mean currents have changed from dive to dive [m]; NaN before a first change. Without mean currents it is their velocity
            over ground.
        basis: What it is expected from.
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
    """An expected end of a dive beside the actual one.

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
        """From the expected place to the actual one [m]."""
        return float(np.hypot(*self.off))

    @property
    def direction_deg(self) -> float:
        """From the expected place to the actual one, clockwise from true north."""
        return float(heading_deg(*self.off))

    @property
    def off(self) -> tuple[float, float]:
        """From the expected place to the actual one, true east and north [m]."""
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
