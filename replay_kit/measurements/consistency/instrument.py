"""The checks of what an instrument repeats, and of its noise: second differences along a profile leave the current out.

They ask for messages that come twice, for the scatter of bins against their stated errors, for one beam unlike the others, and for profiles
that keep one shape in other water.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding
from replay_kit.core.observation import Observation, VehicleState
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.sources import metres_per_degree
from replay_kit.measurements.consistency.summary import Pings, PingSummary, Summaries

# Pings or positions after which each is judged, and those after which stated errors are.
_LEAST_PINGS, _LATER_PINGS = 30, 40
# How many times as large as the stated error the noise of sound bins may be: below, the errors of a mean are stated for single pings, or
# hold more than noise; above, the current changes from bin to bin.
_LEAST_NOISE, _MOST_NOISE = 0.05, 8.0
# Logarithms of ratios that are certainly between.
_USUAL = math.log(1.01 * _LEAST_NOISE), math.log(0.99 * _MOST_NOISE)
# m; by which the water about an instrument is another. Profiles in a row that are alike there, and how much.
_OTHER_DEPTH, _OTHER_PLACE, _LEAST_ALIKE, _ALIKE = 20.0, 1000.0, 8, 0.7
# Degrees of latitude, and of longitude anywhere, that are certainly less.
_CLOSE = 0.005
# How many times as large as that of the others the variance of a beam's noise is, or how many times as small, when the beam is bad.
_UNLIKE = 25.0
# m/s; a mean error velocity that no noise and no error of a beam's angle makes
_MOST_ERROR = 0.1


@dataclass(frozen=True, slots=True)
class Repeats:
    """Pings, or positions, that come twice: equal, at one time, from one log.

    Attributes:
        last: The last one.
        latest: Of the latest ones, whether each repeats the one before it.
    """

    last: Observation | VehicleState | None = None
    latest: tuple[bool, ...] = ()

    def after(self, event: Observation | VehicleState, summary: PingSummary | None = None) -> Self:
        """Return what is remembered after a ping or a position."""
        repeats = self.last is not None and event.time_ns == self.last.time_ns and _equal(event, self.last)  # fmt: skip
        return type(self)(event, (*self.latest, repeats)[-_LEAST_PINGS:])

    def quietly(
        self,
        events: Pings | Sequence[VehicleState],
        known: Summaries = (),
    ) -> Self | None:
        """Return what is remembered after events, if each is later than the one before it."""
        times = [event.time_ns for event in (self.last, *events) if event is not None]
        later = len(times) > len(events) and all(map(int.__lt__, times, times[1:]))
        if not later or 3 * sum(self.latest) >= _LEAST_PINGS:
            return None
        return type(self)(events[-1], (*self.latest, *[False] * len(events))[-_LEAST_PINGS:])

    def found(self, event: Observation | VehicleState, named: frozenset[str]) -> Finding | None:
        """Return that the messages are duplicates, if a third of them are."""
        if len(self.latest) < _LEAST_PINGS or 3 * sum(self.latest) < len(self.latest):
            return None
        return Finding(
            findings.DUPLICATES,
            event.time_ns,
            f"{event.source.topic}: {sum(self.latest)} of the last {len(self.latest)} messages equal the one before, at the same time",
            "a log with every message twice, as of two recorders that were merged",
            "each is counted once; nothing needs to be set",
            "warning",
        )

    @property
    def is_unusable(self) -> bool:
        """A position that comes twice is as good as one that comes once."""
        return False


def _equal(one: Observation | VehicleState, other: Observation | VehicleState) -> bool:
    """Return whether two pings, or positions, of one time are one message."""
    of_one = (one.source.input, one.source.topic) == (other.source.input, other.source.topic)
    if isinstance(one, Observation) and isinstance(other, Observation):
        of_one = of_one and np.array_equal(one.velocity, other.velocity, equal_nan=True)
    return of_one and (one.longitude, one.latitude) == (other.longitude, other.latitude)


@dataclass(frozen=True, slots=True)
class Noise:
    """The noise of the bins, by the second differences of profiles, against their stated errors.

    Bins whose errors are correlated say nothing.

    Attributes:
        log_ratios: Logarithm of the noise over the stated error, of the latest pings.
    """

    log_ratios: tuple[float, ...] = ()

    def after(self, ping: Observation, summary: PingSummary) -> "Noise":
        """Return the noise after a ping."""
        if summary.noise is None:
            return self
        return Noise((*self.log_ratios, summary.noise)[-_LATER_PINGS:])

    def quietly(self, pings: Pings, known: Summaries) -> "Noise | None":
        """Return the noise after pings, if no median of it can be odd."""
        ratios = (*self.log_ratios, *(each.noise for each in known if each.noise is not None))
        usual = [ratio for ratio in ratios if _USUAL[0] < ratio < _USUAL[1]]
        few = len(ratios) - len(usual) < _LATER_PINGS // 2
        return Noise(ratios[-_LATER_PINGS:]) if few else None

    def found(self, ping: Observation, named: frozenset[str]) -> Finding | None:
        """Return that the stated errors are none of the instrument's, if they are not."""
        # wrong units and a bad beam, which explain it, are found in fewer pings
        if len(self.log_ratios) < _LATER_PINGS or {findings.UNIT, findings.BEAM} & named:
            return None
        ratio = math.exp(sorted(self.log_ratios)[_LATER_PINGS // 2])
        if _LEAST_NOISE < ratio < _MOST_NOISE:
            return None
        return Finding(
            findings.ERRORS,
            ping.time_ns,
            f"{ping.source.topic}: neighbouring bins scatter {ratio:.2g} times as much as their stated errors",
            "errors in another unit, of single pings where these are means, or of means where these are single pings",
            "correct the stated errors (velocity_std), or leave them out and set measurements.velocity_std",
        )


@dataclass(frozen=True, slots=True)
class Beams:
    """The noise of each beam, by the second differences along it, and whether the beams fit each other.

    Attributes:
        variances: Of the beams, of the latest pings [m^2/s^2].
        errors: Mean error velocity of the latest pings [m/s].
    """

    variances: tuple[tuple[float, ...], ...] = ()
    errors: tuple[float, ...] = ()

    def after(self, ping: Observation, summary: PingSummary) -> "Beams":
        """Return the noise after a ping that came along beams."""
        raw = ping.raw
        if not raw.along_beams or raw.texture is None or not np.isfinite(raw.texture).all(1).any():
            return self
        variances = tuple(np.nanmean(raw.texture**2, axis=0).tolist())
        errors = (*self.errors, raw.error_velocity) if math.isfinite(raw.error_velocity) else self.errors  # fmt: skip
        return Beams((*self.variances, variances)[-_LEAST_PINGS:], errors[-_LEAST_PINGS:])

    def quietly(self, pings: Pings, known: Summaries) -> "Beams | None":
        """Return the noise after pings, if no median of it can be odd, by the extremes."""
        after, odd = self, self.variances
        for ping, each in zip(pings, known, strict=True):
            after = after.after(ping, each)
        if after is self:
            return self
        odd += after.variances
        least, most = np.min(odd), np.max(odd)
        alike = len(pings) <= _LEAST_PINGS and 0.0 < most < 0.99 * _UNLIKE * least
        small = max(map(abs, self.errors + after.errors), default=0.0) < _MOST_ERROR
        return after if alike and small else None

    def found(self, ping: Observation, named: frozenset[str]) -> Finding | None:
        """Return that one beam is unlike the others, if it is."""
        if len(self.variances) < _LEAST_PINGS or findings.BEAM in named:
            return None
        beams = np.median(self.variances, axis=0)
        ratios = beams / np.array([np.median(np.delete(beams, k)) for k in range(len(beams))])
        worst = int(np.argmax(np.abs(np.log(np.maximum(ratios, 1e-9)))))
        error = abs(float(np.median(self.errors))) if len(self.errors) == _LEAST_PINGS else 0.0
        if 1.0 / _UNLIKE < ratios[worst] < _UNLIKE:
            if error < _MOST_ERROR:
                return None
            evidence = (
                f"the beams contradict each other by {error:.2f} m/s in all cells (error velocity)"
            )
        else:
            evidence = f"beam {worst + 1} scatters {math.sqrt(ratios[worst]):.2g} times as much as the others"
        return Finding(
            findings.BEAM,
            ping.time_ns,
            f"{ping.source.topic}: {evidence}",
            "the order or the directions of the beams, or one that is dead, blocked or disturbed",
            "its profiles are not used; leave that beam out, so that velocities are solved from the other three",
            distrusts=True,
        )


@dataclass(frozen=True, slots=True)
class Stuck:
    """Profiles whose small scales stay as they are while the instrument moves through other water: it repeats itself, with some noise.

    Attributes:
        before: The ping with which the next is compared: its texture, its depth [m] and its place [degrees].
        products: Of the latest comparisons: the time [ns, UTC], and the products of one with the other and of each with itself.
    """

    before: tuple[Array, float, float, float] | None = None
    products: tuple[tuple[int, float, float, float], ...] = ()

    def after(self, ping: Observation, summary: PingSummary) -> "Stuck":
        """Return the comparisons after a ping; one at the same place says nothing."""
        texture = ping.raw.texture
        if texture is None:
            return self
        now = texture, float(ping.depth[0]), ping.longitude, ping.latitude
        if self.before is None or self.before[0].shape != texture.shape:
            return Stuck(now)
        before = self.before[0]
        deeper, east, north = (b - a for a, b in zip(self.before[1:], now[1:], strict=True))
        if not abs(deeper) >= _OTHER_DEPTH:
            if abs(east) < _CLOSE and abs(north) < _CLOSE:
                return self
            of_east, of_north = metres_per_degree(self.before[3])
            if not math.hypot(of_east * east, of_north * north) >= _OTHER_PLACE:
                return self
        known = np.isfinite(before + texture)
        a, b = before[known], texture[known]
        product = ping.time_ns, float(a @ b), float(a @ a), float(b @ b)
        return Stuck(now, (*self.products, product)[-_LEAST_PINGS:])

    def quietly(self, pings: Pings, known: Summaries) -> "Stuck | None":
        """Return the comparisons after pings that are all too near for one."""
        return self if all(one is self for one in map(self.after, pings, known)) else None

    def found(self, ping: Observation, named: frozenset[str]) -> Finding | None:
        """Return that the instrument repeats itself, if it does."""
        # what was compared before has been judged
        compared = len(self.products) >= _LEAST_ALIKE and self.products[-1][0] == ping.time_ns
        if findings.DEAD in named or not compared:
            return None
        # by the latest comparisons alone: those before were of a living instrument
        latest = self.products[-_LEAST_ALIKE:]
        one, first, second = np.sum([product[1:] for product in latest], axis=0).tolist()
        if one < _ALIKE * math.sqrt(first * second) or first * second == 0.0:
            return None
        unlike = [k for k, (_, p, a, b) in enumerate(self.products) if p < 0.5 * math.sqrt(a * b)]
        begin = min(unlike[-1] + 1 if unlike else 0, len(self.products) - 1)
        return Finding(
            findings.DEAD,
            self.products[begin][0],
            f"{ping.source.topic}: {len(latest)} profiles in a row, at other depths or places, have one shape "
            f"(correlation of second differences {one / math.sqrt(first * second):.2f})",
            "an instrument that hangs, whose last profile is logged with some noise",
            "its profiles are not used; check the instrument's power and its logger",
            distrusts=True,
        )
