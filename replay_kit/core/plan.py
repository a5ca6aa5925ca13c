"""Where to go, and how to get there."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from replay_kit.core.arrays import Array
from replay_kit.core.text import place_text, time_text


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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        """Return its ends, what to steer and how it turns out."""
        ends = " to ".join(f"{place_text(end.longitude, end.latitude)}, {end.depth:g} m" for end in (self.start, self.goal))
        steer = (
            f"heading {self.heading_deg:.1f} degrees, glide angle {self.glide_angle_deg:.1f} degrees, {self.speed:.2f} m/s through water"
        )
        outcome = f"{self.duration / 3600.0:.1f} h, closest approach {self.closest_approach:.0f} m; track of {len(self.track)} points"
        return f"Plan for {time_text(self.start_time_ns)}: {self.status}; {ends}\n  {steer}, {outcome}"
