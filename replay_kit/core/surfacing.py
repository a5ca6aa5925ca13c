"""What a plan said of the next surfacing, beside what then happened."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import grid_bearing_of_true_north, heading_deg, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import VehicleState


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Where nine of ten surfacings are expected.

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
        ellipse: Where nine of ten samples of the estimate end; None without samples.
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
        predicted: What it said.
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
        predicted: What it said.
        fix: The vehicle's.
    """
    east, north = to_local(
        Projection(predicted.longitude, predicted.latitude), fix.longitude, fix.latitude
    )
    away, direction = float(np.hypot(east, north)), float(heading_deg(east, north))
    return SurfacingOutcome(
        planned_ns, predicted, fix.time_ns, fix.longitude, fix.latitude, away, direction
    )
