"""Depths and positions that cannot be: bins above the surface, a vehicle that dives and stays on one spot to the last digit."""

import math
from dataclasses import dataclass, replace

from replay_kit.core.errors import Finding
from replay_kit.core.observation import Observation, VehicleState
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.summary import PingSummary

# Share of the pings above the surface, and the number of them, from which depths are wrong.
_MOST_ABOVE, _LEAST_PINGS = 0.1, 5
# s, m and positions for which an unchanged position is that of a dead receiver
_FROZEN_TIME, _FROZEN_DEPTH, _FROZEN_FIXES = 600.0, 20.0, 4


@dataclass(frozen=True, slots=True)
class DepthCounts:
    """Pings so far, without those of an instrument at the surface.

    An instrument that looks up from near the surface has bins above it, too; so a ping counts when most of its bins are there.

    Attributes:
        pings: Number of pings with a velocity.
        above: Number of those with most of their bins above the surface.
    """

    pings: int = 0
    above: int = 0

    def after(self, ping: Observation, summary: PingSummary) -> "DepthCounts":
        """Return the counts after a ping."""
        return (
            self
            if summary.is_above is None
            else DepthCounts(self.pings + 1, self.above + summary.is_above)
        )

    def found(self, ping: Observation, named: frozenset[str]) -> Finding | None:
        """Return that the bins are above the surface, if they are."""
        if not self.is_wrong:
            return None
        return Finding(
            findings.DEPTH,
            ping.time_ns,
            f"{ping.source.topic}: most bins of {self.above} of {self.pings} pings lie above the surface",
            "the sign of depth, or an instrument that looks up and is read as looking down, or the other way round",
            "its profiles are not used; check depth_positive and orientation of the mapping, or the ping's orientation",
            distrusts=True,
        )

    @property
    def is_wrong(self) -> bool:
        """Whether more pings lie above the surface than a sound instrument can give."""
        return self.above >= _LEAST_PINGS and self.above > _MOST_ABOVE * self.pings


@dataclass(frozen=True, slots=True)
class PositionRun:
    """The positions since the last one that differed.

    Attributes:
        longitude: Of all of them [degrees]; NaN before the first.
        latitude: Of all of them [degrees].
        since_ns: Time of the first [ns, UTC].
        last_ns: Time of the last [ns, UTC].
        fixes: Number.
        shallowest: Least depth [m]; NaN when none was known.
        deepest: Greatest depth [m].
    """

    longitude: float = math.nan
    latitude: float = math.nan
    since_ns: int = 0
    last_ns: int = 0
    fixes: int = 0
    shallowest: float = math.nan
    deepest: float = math.nan

    def after(self, vehicle: VehicleState) -> "PositionRun":
        """Return the run after a position."""
        depth = vehicle.depth
        if vehicle.longitude != self.longitude or vehicle.latitude != self.latitude:
            return PositionRun(
                vehicle.longitude,
                vehicle.latitude,
                vehicle.time_ns,
                vehicle.time_ns,
                1,
                depth,
                depth,
            )
        # a depth that is not known changes neither bound
        least = depth if not self.shallowest <= depth and math.isfinite(depth) else self.shallowest
        most = depth if not self.deepest >= depth and math.isfinite(depth) else self.deepest
        return replace(
            self, last_ns=vehicle.time_ns, fixes=self.fixes + 1, shallowest=least, deepest=most
        )

    def found(self, vehicle: VehicleState, named: frozenset[str]) -> Finding | None:
        """Return that the receiver repeats its position, if it does."""
        if not self.is_unusable:
            return None
        return Finding(
            findings.FROZEN,
            self.last_ns,
            f"{self.fixes} positions over {(self.last_ns - self.since_ns) * 1e-9:.0f} s are equal to the last digit "
            f"while the vehicle moved between {self.shallowest:.0f} and {self.deepest:.0f} m",
            "a receiver without a fix that repeats its last one",
            "pings at such positions are not used; check the receiver, or give the dead-reckoned positions of the vehicle",
        )

    @property
    def is_unusable(self) -> bool:
        """Whether the receiver repeats a position while the vehicle dives, so that pings at it are not to be used."""
        return (
            self.fixes >= _FROZEN_FIXES
            and self.last_ns - self.since_ns >= _FROZEN_TIME * 1e9
            and self.deepest - self.shallowest > _FROZEN_DEPTH
        )
