"""What is said of a measured value: where it came from, whether it is used and why not, and its innovation."""

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.text import span_text, time_text


@dataclass(frozen=True, slots=True)
class Source:
    """Pointer to the message that a value came from.

    Attributes:
        input: Position of the log among the run's inputs.
        topic: Channel name.
        position: Ordinal or byte offset in that log.
        time_ns: The message's time [ns, UTC].
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
    """Return which bins are used: good ones and suspect ones; where the latter are unwanted, measurement quality control fails them."""
    return np.asarray((flags == _GOOD) | (flags == _SUSPECT))


class Reason(IntFlag):
    """Why a bin or a ping was not used, or why it is suspect: its flag says which."""

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


_MISSING_LAST = (*(one for one in Reason if one is not Reason.MISSING), Reason.MISSING)


def reasons_of(reasons: NDArray[np.int32], flags: NDArray[np.int8]) -> list[tuple[str, int]]:
    """Return the names of the reasons for which bins are not used, each with its number of bins.

    A bin counts once, for its first reason; as missing only where there is no other.
    """
    left, found = reasons[~usable(flags)], list[tuple[str, int]]()
    named = int(np.bitwise_or.reduce(left, initial=0))
    for reason in _MISSING_LAST:
        if named & reason.value and (count := np.count_nonzero(here := left & reason.value != 0)):
            found.append((str(reason.name).lower(), int(count)))
            left = left[~here]
    return found


Decision = Literal["accepted", "rejected", "unusable"]


@dataclass(frozen=True, slots=True)
class GroupTotals:
    """Sums over the profiles of a superobservation, each against the estimate of its turn.

    Attributes:
        bins: Number of bins used.
        before: Squared innovations [m^2/s^2], of all bins and both components.
        after: Squared residuals after the update [m^2/s^2].
        prior: Squared innovations against the prior without observations [m^2/s^2].
        not_used: Number of bins not used, by reason.
    """

    bins: int
    before: float
    after: float
    prior: float
    not_used: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Innovation:
    """The innovation of one observation: measured minus predicted, before and after the update.

    Attributes:
        time_ns: [ns, UTC].
        depth: shape (n,) [m], the bins offered to the estimator, used or not.
        innovation: shape (n, 2) [m/s], local east and north, measured minus predicted; NaN for bins not used. Of a mean current that is
            corrected for the flight model's error, corrected minus predicted; so are the others.
        innovation_std: shape (n, 2) [m/s], predicted standard deviation of the innovation.
        residual: shape (n, 2) [m/s], measured minus estimated after the update.
        prior_innovation: shape (n, 2) [m/s], measured minus predicted by the prior that has seen no observation.
        nis: Normalised innovation squared of all rows used.
        dof: Number of rows used.
        accepted: False when no bin was usable, or the gate rejected the profile.
        error_inflation: Factor, at least 1, by which the bins' error variance was grown in the update, because their scatter asked for
            it; ``innovation_std`` and ``nis`` are those of the stated errors.
        flags: shape (n,), QARTOD flags after the region's checks.
        reasons: shape (n,), bit mask of ``Reason``.
        dive: As in the observation.
        source: As in the observation.
        decision: What was done with the observation.
        gate_statistic: Normalised innovation squared of what the observation says of the estimate, with adapted errors.
        gate: What ``gate_statistic`` was held against; inf without a gate.
        signal_dof: Degrees of freedom for signal: how many independent values of the estimate the observation determined.
        log_likelihood: Logarithm of the measured values' density under the prediction, with the stated errors, without the constant of
            2 pi; NaN without a usable bin, or when the estimator predicts no variance.
        mean_current: shape (2,) [m/s], local east and north, what a mean along a path measured; None for a profile.
        mean_kind: Of the mean along a path, as in ``PathMean``, or of another source, as in ``Label``; empty for a profile.
        mean_std: Error of each component of ``mean_current`` [m/s].
        corrected_current: shape (2,) [m/s], ``mean_current`` without the flight model's error; None where there is no correction.
        corrected_std: Error of each component of it [m/s].
        estimated_std: Error of each component of the estimate's mean along the path after the update [m/s]; NaN where it is not known.
        replayed_residual: shape (n, 2) [m/s], of a smoothed result: the residual before smoothing; None in others.
        measured: shape (n, 2) [m/s], local east and north: the estimate after the update plus the residual; None where it is not stated.
        profiles: Number of profiles that it holds. Where several are combined, depths, innovations and residuals are means over them,
            ``nis`` and ``dof`` are sums, the gate's result is that of the first, and ``source`` is its message.
        totals: Of several profiles; None for one.
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
        """What the estimate was given of a mean along a path, shape (2,) [m/s], local east and north: corrected, where it is."""
        return self.mean_current if self.corrected_current is None else self.corrected_current

    def __repr__(self) -> str:
        """Return what was done with the observation, and how far it lay from the prediction."""
        parts = (part[np.isfinite(part)] for part in (self.innovation, self.residual))
        before, after = (f"{np.sqrt(np.mean(part**2)):.3f}" if part.size else "-" for part in parts)
        bins = f"{self.depth.size} bins, {span_text(self.depth)} m deep"
        return (
            f"Innovation {time_text(self.time_ns)}, dive {self.dive}: {self.decision}, {bins}\n"
            f"  RMS {before} m/s before and {after} m/s after the update, NIS {self.nis:.1f} of {self.dof} degrees of freedom"
        )
