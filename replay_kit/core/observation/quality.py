"""Source, flags and reasons of a measured value, and its innovation."""

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.words.text import span_text, time_text


@dataclass(frozen=True, slots=True)
class Source:
    """Message from which a value came.

    Attributes:
        input: Position of the log among the run's inputs.
        topic: Channel name.
        position: Ordinal or byte offset in that log.
        time_ns: Time of the message [ns, UTC].
    """

    input: int
    topic: str
    position: int
    time_ns: int


class Flag(IntEnum):
    """QARTOD flags."""

    GOOD = 1
    NOT_EVALUATED = 2
    SUSPECT = 3
    FAIL = 4
    MISSING = 9


_GOOD, _SUSPECT = np.int8(Flag.GOOD), np.int8(Flag.SUSPECT)


def usable(flags: NDArray[np.int8]) -> Mask:
    """Return whether bins are used: flags good and suspect. Quality control sets unwanted suspect ones to fail."""
    return np.asarray((flags == _GOOD) | (flags == _SUSPECT))


class Reason(IntFlag):
    """Reason why a bin or ping is excluded or, by its flag, suspect."""

    NONE = 0
    MISSING = 1
    ABOVE_SURFACE = 2
    BELOW_GRID = 4
    OUTSIDE_REGION = 8
    PLATFORM_REFERENCE = 16
    NOT_EARTH_COORDINATES = 32
    NO_POSITION = 64
    MALFORMED = 128
    GROSS_RANGE = 256
    ON_LAND = 512
    BELOW_BOTTOM = 1024
    LOW_CORRELATION = 2048
    LOW_AMPLITUDE = 4096
    LOW_SNR = 8192
    LOW_PERCENT_GOOD = 16384
    ERROR_VELOCITY = 32768
    HIGH_SPEED = 65536
    TILT = 131072
    SIDELOBE = 262144
    OUTLIER = 524288
    AT_SURFACE = 1048576
    DUPLICATE = 2097152
    OUT_OF_ORDER = 4194304
    DEAD = 8388608
    INCONSISTENT = 16777216


# What is counted last: of a bin without a value it says nothing that it lies off the grid.
_LAST = (Reason.MISSING, Reason.BELOW_GRID, Reason.OUTSIDE_REGION, Reason.ON_LAND)
_COUNTED = (*(one for one in Reason if one not in _LAST), *_LAST)


def reasons_of(reasons: NDArray[np.int32], flags: NDArray[np.int8]) -> list[tuple[str, int]]:
    """Return the number of excluded bins by name of the reason.

    A bin counts once, for its first reason; ``missing`` comes after quality control, and a place off the grid last.
    """
    left, found = reasons[~usable(flags)], list[tuple[str, int]]()
    named = int(np.bitwise_or.reduce(left, initial=0))
    for reason in _COUNTED:
        if named & reason.value and (count := np.count_nonzero(here := left & reason.value != 0)):
            found.append((str(reason.name).lower(), int(count)))
            left = left[~here]
    return found


Decision = Literal["accepted", "rejected", "unusable"]


@dataclass(frozen=True, slots=True)
class GroupTotals:
    """Sums over the profiles of a group, each against the estimate at its time.

    Attributes:
        bins: Number of used bins.
        before: Sum of squared innovations [m^2/s^2], over bins and components.
        after: Sum of squared residuals [m^2/s^2].
        prior: Sum of squared innovations of the prior [m^2/s^2].
        not_used: Number of excluded bins by reason.
    """

    bins: int
    before: float
    after: float
    prior: float
    not_used: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Innovation:
    """Innovation and residual of one observation or group.

    Attributes:
        time_ns: [ns, UTC].
        depth: shape (n,) [m], depths of the bins, used or not.
        innovation: shape (n, 2) [m/s], local east and north, measured minus predicted; NaN for excluded bins. Here and below a corrected
            mean current counts as measured.
        innovation_std: shape (n, 2) [m/s], predicted standard deviation of the innovation.
        residual: shape (n, 2) [m/s], measured minus updated estimate.
        prior_innovation: shape (n, 2) [m/s], measured minus prior.
        nis: Normalised innovation squared of all rows used.
        dof: Number of rows used.
        accepted: False if no bin was usable or the gate rejected the profile.
        error_inflation: Factor, at least 1, on the error variance in the update, from the bins' scatter; ``innovation_std`` and ``nis`` use
            the stated errors.
        flags: shape (n,), QARTOD flags after the region's checks.
        reasons: shape (n,), bit mask of ``Reason``.
        dive: As in the observation.
        source: As in the observation.
        decision: Use of the observation.
        gate_statistic: Gate's normalised innovation squared, with adapted errors.
        gate: Threshold of ``gate_statistic``; inf without a gate.
        signal_dof: Degrees of freedom for signal.
        log_likelihood: Log density of the values under the prediction, with stated errors, without the constant of 2 pi; NaN without a
            usable bin or predicted variance.
        mean_current: shape (2,) [m/s], local east and north, measured mean along a path; None for a profile.
        mean_kind: Kind as in ``PathMean`` or ``Label``; empty for a profile.
        mean_std: Error of each component of ``mean_current`` [m/s].
        corrected_current: shape (2,) [m/s], ``mean_current`` corrected for the flight-model error; None without a correction.
        corrected_std: Error of each component of ``corrected_current`` [m/s].
        estimated_std: Error of each component of the updated estimate's path mean [m/s]; NaN if unknown.
        replayed_residual: shape (n, 2) [m/s], residual before smoothing; None without smoothing.
        measured: shape (n, 2) [m/s], local east and north, updated estimate plus residual; None if not stated.
        profiles: Number of profiles. For a group, depths, innovations and residuals are means, ``nis`` and ``dof`` sums, and the gate's
            result and ``source`` those of the first.
        totals: Sums over a group; None for one profile.
    """

    time_ns: int
    depth: Array
    innovation: Array
    innovation_std: Array
    residual: Array
    prior_innovation: Array
    nis: float
    dof: int
    accepted: bool
    error_inflation: float
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]
    dive: int
    source: Source
    decision: Decision = "accepted"
    gate_statistic: float = float("nan")
    gate: float = float("inf")
    signal_dof: float = float("nan")
    log_likelihood: float = float("nan")
    mean_current: Array | None = None
    mean_kind: str = ""
    mean_std: float = float("nan")
    corrected_current: Array | None = None
    corrected_std: float = float("nan")
    estimated_std: float = float("nan")
    replayed_residual: Array | None = None
    measured: Array | None = None
    profiles: int = 1
    totals: GroupTotals | None = None

    @property
    def used_current(self) -> Array | None:
        """Assimilated mean along a path, shape (2,) [m/s], local east and north, corrected if possible."""
        return self.mean_current if self.corrected_current is None else self.corrected_current

    def __repr__(self) -> str:
        """Return decision, RMS innovation and residual as text."""
        parts = (part[np.isfinite(part)] for part in (self.innovation, self.residual))
        before, after = (f"{np.sqrt(np.mean(part**2)):.3f}" if part.size else "-" for part in parts)
        bins = f"{self.depth.size} bins, {span_text(self.depth)} m deep"
        return (
            f"Innovation {time_text(self.time_ns)}, dive {self.dive}: {self.decision}, {bins}\n"
            f"  RMS {before} m/s before and {after} m/s after the update, NIS {self.nis:.1f} of {self.dof} degrees of freedom"
        )
