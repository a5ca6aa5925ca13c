"""What a check of pings or of positions is, the checks of pings, and the list of all: to add one is to write its file and to name it here.

The checks of pings ask for bins above the surface, and compare speeds with those of the ensemble.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

from replay_kit.core.errors import Finding
from replay_kit.core.extensions import additions
from replay_kit.core.observation import Observation, VehicleState
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.instrument import Beams, Noise, Repeats, Stuck
from replay_kit.measurements.consistency.position_checks import (
    Displacements,
    PositionRun,
    SeparatePlaces,
)
from replay_kit.measurements.consistency.summary import MOST_SPEED, Pings, PingSummary, Summaries

# Share of the pings above the surface, and the number of them, from which depths are wrong.
_MOST_ABOVE, _LEAST_ABOVE = 0.1, 5
# Pings after which speeds are judged, and the factor beyond which they contradict the ensemble.
_LEAST_PINGS, _ODD = 30, 8.0
# m/s; a slower profile lacks even the noise of an instrument
_LEAST_SPEED = 0.01


class PingCheck(Protocol):
    """What a check remembers of one instrument: a frozen value, made without arguments before the first ping."""

    def after(self, ping: Observation, summary: PingSummary) -> Self:
        """Return what is remembered after a ping that is neither dead nor stale.

        Args:
            ping: Of one topic.
            summary: What was computed of it for all checks.
        """
        ...

    def found(self, ping: Observation, named: frozenset[str]) -> Finding | None:
        """Return what the pings so far establish, if anything; of findings of one name the first is reported.

        Args:
            ping: The last one.
            named: Names of what was found of the instrument before.
        """
        ...

    def quietly(self, pings: Pings, known: Summaries) -> Self | None:
        """Return what is remembered after pings in the order of their times, if ``found`` is certain to be None after each; else None.

        A check without this method is asked ping by ping, as are all others then.
        """
        ...


class PositionCheck(Protocol):
    """What a check remembers of the vehicle's positions: a frozen value, made without arguments before the first."""

    def after(self, vehicle: VehicleState) -> Self:
        """Return what is remembered after a position."""
        ...

    def quietly(self, track: Sequence[VehicleState]) -> Self | None:
        """Return what is remembered after ``steady`` positions, as of a ``PingCheck``; pings at all of them can be used."""
        ...

    def found(self, vehicle: VehicleState, named: frozenset[str]) -> Finding | None:
        """Return what the positions so far establish, if anything; arguments as of a ``PingCheck``."""
        ...

    @property
    def is_unusable(self) -> bool:
        """Whether pings at the last position are not to be used."""
        ...


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

    def quietly(self, pings: Pings, known: Summaries) -> "DepthCounts | None":
        """Return the counts after pings of which none is above the surface."""
        above = [each.is_above for each in known if each.is_above is not None]
        quiet = not (self.is_wrong or any(above))
        return DepthCounts(self.pings + len(above), self.above) if quiet else None

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
        return self.above >= _LEAST_ABOVE and self.above > _MOST_ABOVE * self.pings


@dataclass(frozen=True, slots=True)
class SpeedCounts:
    """Absolute pings so far, by their speed. Each counts by the median of its bins, so that a few outliers change nothing.

    Attributes:
        pings: Number of pings.
        fast: Number of those more than eight times as fast as the ensemble, less their stated errors.
        slow: Number of those less than an eighth as fast, errors included.
        impossible: Number of both that are, besides, faster than any model's currents, or slower than any instrument's noise.
        log_ratio: Sum of the logarithm of how many times as fast as the ensemble each is.
    """

    pings: int = 0
    fast: int = 0
    slow: int = 0
    impossible: int = 0
    log_ratio: float = 0.0

    def after(self, ping: Observation, summary: PingSummary) -> "SpeedCounts":
        """Return the counts after a ping; one whose speed is not compared changes nothing."""
        speed = summary.speed
        if speed is None or not (speed.measured > 0.0 and speed.typical > 0.0):
            return self
        measured, typical, error = speed.measured, speed.typical, 2.0 * speed.error_std**2
        fast, slow = measured - error > _ODD**2 * typical, measured < typical / _ODD**2
        return SpeedCounts(
            self.pings + 1,
            self.fast + fast,
            self.slow + slow,
            self.impossible
            + (fast and measured > MOST_SPEED**2)
            + (slow and measured < _LEAST_SPEED**2),
            self.log_ratio + 0.5 * math.log(measured / typical),
        )

    def quietly(self, pings: Pings, known: Summaries) -> "SpeedCounts | None":
        """Return the counts after pings, if those so far bound the share of the odd ones."""
        after = self
        for ping, each in zip(pings, known, strict=True):
            after = after.after(ping, each)
        return after if 2 * max(after.fast, after.slow) <= self.pings else None

    def found(self, ping: Observation, named: frozenset[str]) -> Finding | None:
        """Return that the speeds are no current's, or else that they contradict the ensemble's, if they do."""
        if findings.UNIT in named or not self.contradict_ensemble:
            return None
        words = (
            f"{self.ratio:.3g} times as fast"
            if self.ratio > 1.0
            else f"{1.0 / self.ratio:.3g} times as slow"
        )
        evidence = f"{ping.source.topic}: {self.pings} pings are {words} as the ensemble's currents"
        if not self.is_odd:
            return findings.ensemble_contradicts(evidence, ping.time_ns)
        return Finding(
            findings.UNIT,
            ping.time_ns,
            evidence,
            "velocities in cm/s or mm/s that are taken for m/s, or an ensemble in another unit",
            "state measurements.velocity_unit (m/s when the log is right), and check the ensemble's unit",
            "unusable",
        )

    @property
    def ratio(self) -> float:
        """How many times as fast as the ensemble the profiles are, the geometric mean; NaN before the first."""
        return math.exp(self.log_ratio / self.pings) if self.pings else math.nan

    @property
    def is_odd(self) -> bool:
        """Whether most pings are faster or slower than any current explains: the ensemble alone convicts nobody."""
        return self.contradict_ensemble and 2 * self.impossible > self.pings

    @property
    def contradict_ensemble(self) -> bool:
        """Whether most pings are faster or slower than those of the ensemble by far."""
        return self.pings >= _LEAST_PINGS and 2 * max(self.fast, self.slow) > self.pings


def added_checks(of_positions: bool) -> tuple[Any, ...]:
    """Return the checks of positions, or of pings, that installed packages add, in the order of their names."""
    found = additions(
        "checks", lambda value: hasattr(value, "after") and hasattr(value, "found"), "a check"
    )
    return tuple(one for one in found.values() if hasattr(one, "is_unusable") == of_positions)


def quiet(checks: Iterable[Any], *events: Any) -> tuple[Any, ...] | None:
    """Return what checks remember after events of which none of them finds anything; None where one may, or is asked one by one."""
    after = []
    for each in checks:
        quietly = getattr(each, "quietly", None)
        if quietly is None or (one := quietly(*events)) is None:
            return None
        after.append(one)
    return tuple(after)


#: The checks before the first ping, and before the first position, in the order in which findings are reported.
PING_CHECKS: tuple[PingCheck, ...] = (
    DepthCounts(),
    SpeedCounts(),
    Repeats(),
    Noise(),
    Beams(),
    Stuck(),
)
POSITION_CHECKS: tuple[PositionCheck, ...] = (
    PositionRun(),
    SeparatePlaces(),
    Displacements(),
    Repeats(),
)
