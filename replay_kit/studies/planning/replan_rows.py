"""Replanning in twin missions: the options, the outcome of each mission, and the figures over all."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.studies.reports.tables import NAN

# Arrival times are compared between missions that arrive this near [m].
NEAR = 500.0


@dataclass(frozen=True, slots=True)
class ReplanJob:
    """Which missions.

    Attributes:
        missions: Their number.
        legs: From start to goal in the truth.
        most_legs: Limit on the legs that a mission may take.
        depth: Of the dives [m]; the last level's when that is shallower.
        angles: Least and greatest glide angle [degrees], of the missions drawn.
        speed: Through water [m/s], of the missions drawn.
        noise: Error of each component of each bin [m/s].
        tolerance: A replanned mission ends this near to the goal [m].
        seed: Of starts, goals and noise.
        members: Truths, in turn; None for members spread evenly over the ensemble.
    """

    missions: int = 40
    legs: int = 10
    most_legs: int = 15
    depth: float = 500.0
    angles: tuple[float, float] = (15.0, 35.0)
    speed: float = 0.3
    noise: float = 0.09
    tolerance: float = 250.0
    seed: int = 0
    members: tuple[int, ...] | None = None

    def check(self) -> None:
        """Raise ConfigError when a number cannot be simulated."""
        positive = (self.missions, self.legs, self.most_legs, self.depth, self.speed, self.noise, self.tolerance)
        if not (all(value > 0 for value in positive) and 0.0 < self.angles[0] <= self.angles[1] < 90.0):
            raise ConfigError(f"replanning: expected numbers above 0 and angles below 90 degrees, got {self}")


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a mission.

    Attributes:
        miss: Between the goal and the last surfacing [m].
        closest: Between the goal and the surfacing, or the start, nearest to it [m].
        duration: To the last surfacing [s].
        legs: Flown.
        ended: Why no further leg was flown: ``arrived``, ``plan ended``, ``legs used up``, or the reason in words.
    """

    miss: float
    closest: float
    duration: float
    legs: int
    ended: str


@dataclass(frozen=True, slots=True)
class ReplanRow:
    """One twin mission.

    Attributes:
        member: The truth, position from 0.
        seed: Of its start, goal and noise.
        distance: Between start and goal [m].
        truth_duration: Of the mission drawn, which reaches the goal in the truth [s].
        single: With the single plan made at the start.
        replanned: With a new plan at each surfacing.
        prediction_errors: Between each leg's predicted surfacing and the actual one, of the replanned mission [m].
    """

    member: int
    seed: int
    distance: float
    truth_duration: float
    single: Outcome
    replanned: Outcome
    prediction_errors: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """Miss distance of the replanned mission over that with the single plan."""
        return self.replanned.miss / self.single.miss


@dataclass(frozen=True, slots=True)
class ReplanSummary:
    """All missions.

    Attributes:
        missions: Their number.
        ratio_median: Of the ratios of the miss distances.
        ratio_90: Nine of ten missions have no greater ratio.
        closest_ratio_median: The same of the nearest surfacings, though without a position nobody knows which that is.
        closest_ratio_90: The same.
        single_median: Miss distance with the single plan [m].
        replanned_median: Miss distance when replanned [m].
        single_near: Share that ends within 500 m of the goal.
        replanned_near: The same when replanned.
        both_near: Missions in which both do.
        time_ratio_median: Arrival when replanned over arrival with the single plan, over these; NaN without one.
    """

    missions: int
    ratio_median: float
    ratio_90: float
    closest_ratio_median: float
    closest_ratio_90: float
    single_median: float
    replanned_median: float
    single_near: float
    replanned_near: float
    both_near: int
    time_ratio_median: float


def summarise(rows: Sequence[ReplanRow]) -> ReplanSummary:
    """Return the figures over all missions; arrival times are compared only where both arrive."""
    single, replanned = np.array([(row.single.miss, row.replanned.miss) for row in rows]).T
    ratios = np.array([row.ratio for row in rows])
    closest = np.array([row.replanned.closest / row.single.closest for row in rows])
    both = [row.replanned.duration / row.single.duration for row in rows if max(row.single.miss, row.replanned.miss) <= NEAR]
    return ReplanSummary(
        missions=len(rows),
        ratio_median=float(np.median(ratios)),
        ratio_90=_ninety(ratios),
        closest_ratio_median=float(np.median(closest)),
        closest_ratio_90=_ninety(closest),
        single_median=float(np.median(single)),
        replanned_median=float(np.median(replanned)),
        single_near=float(np.mean(single <= NEAR)),
        replanned_near=float(np.mean(replanned <= NEAR)),
        both_near=len(both),
        time_ratio_median=float(np.median(both)) if both else NAN,
    )


def _ninety(values: Array) -> float:
    """Return the least of some values that nine of ten do not exceed: one of them, without interpolation."""
    return float(np.quantile(values, 0.9, method="inverted_cdf"))
