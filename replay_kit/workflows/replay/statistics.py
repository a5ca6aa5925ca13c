"""Counting what a replay met, and the time it took: messages, profiles, innovations, dives, stages."""

import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.grid import Grid
from replay_kit.core.message import LogReport
from replay_kit.core.observation import Innovation, PathMean, Reason, VehicleState
from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import Outcome
from replay_kit.estimator.update.screening import usable
from replay_kit.results.summary import DiveRow, ReplaySummary, TopicRow, TruthScore

# Topics named when a log turns out to be of no use; `replay-kit info` names all.
_TOPICS_SHOWN = 10


@dataclass(slots=True)
class _Sums:
    """Sums of squares over bins and components."""

    profiles: int = 0
    bins: int = 0
    nis: float = 0.0
    dof: int = 0
    squares: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    def add(self, innovation: Innovation, predicted: Array) -> None:
        self.profiles += 1
        self.bins += innovation.dof // 2
        self.nis += innovation.nis
        self.dof += innovation.dof
        parts = {
            "before": innovation.innovation,
            "after": innovation.residual,
            "prior": innovation.prior_innovation,
            "predicted": predicted,
        }
        for name, values in parts.items():
            self.squares[name] += float(np.nansum(values**2))

    def rms(self, name: str) -> float:
        return float(np.sqrt(self.squares[name] / self.dof)) if self.dof else float("nan")

    @property
    def nis_per_dof(self) -> float:
        return self.nis / self.dof if self.dof else float("nan")


@dataclass(slots=True)
class Stopwatch:
    """Wall time spent in each stage.

    Attributes:
        seconds: By stage.
    """

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time that a block takes to a stage."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began


_SAID_INFLATIONS = 5


@dataclass(slots=True)
class Tally:
    """Running counts of one replay."""

    late: Mapping[str, int] = field(default_factory=dict)
    _used: Counter[str] = field(default_factory=Counter)
    _reasons: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    _not_taken: Counter[str] = field(default_factory=Counter)
    _rejected: int = 0
    _bins_rejected: Counter[str] = field(default_factory=Counter)
    _gated: int = 0
    _softened: int = 0
    _inflations: list[float] = field(default_factory=list)
    _all: _Sums = field(default_factory=_Sums)
    _dives: dict[int, _Sums] = field(default_factory=dict)

    def used(self, topic: str) -> None:
        """Count a message that was used."""
        self._used[topic] += 1

    def skipped(self, topic: str, reason: str) -> None:
        """Count a message that was not used."""
        self._reasons[topic][reason] += 1

    def not_taken(self, mean: PathMean) -> None:
        """Count a mean current that the estimator has no use for."""
        self._not_taken[mean.kind] += 1

    def observed(self, innovation: Innovation, predicted: Array) -> None:
        """Count a profile.

        Args:
            innovation: What it said.
            predicted: shape (n, 2) [m/s], measured minus predicted from all dives before its own.
        """
        not_used = innovation.reasons[~usable(innovation.flags)]
        for reason in Reason:
            count = int(np.count_nonzero(not_used & reason))
            if count and reason:
                self._bins_rejected[str(reason.name).lower()] += count
        self._gated += innovation.decision == "rejected"
        self._softened += innovation.decision == "softened"
        if innovation.prior_inflation > 1.0:
            self._inflations.append(innovation.prior_inflation)
        if not innovation.accepted:
            self._rejected += 1
            return
        self._all.add(innovation, predicted)
        if innovation.dive > 0:
            self._dives.setdefault(innovation.dive, _Sums()).add(innovation, predicted)

    def require_usable(self, reports: Sequence[LogReport], grid: Grid, vehicle: VehicleState | None) -> None:
        """Raise MeasurementError, saying what was found instead, when no profile was used."""
        if self._all.profiles:
            return
        names = ", ".join(report.path for report in reports)
        if self._bins_rejected.get("outside_region") and vehicle is not None:
            raise MeasurementError(
                f"{names}: the log lies outside the ensemble's region: "
                f"last position {vehicle.latitude:.4f} N, {vehicle.longitude:.4f} E; the region is "
                f"{grid.longitude.min():.3f}..{grid.longitude.max():.3f} E, {grid.latitude.min():.3f}..{grid.latitude.max():.3f} N. "
                "Use an ensemble of the right place, or --place-ensemble for a study"
            )
        if self._rejected:
            why = ", ".join(f"{count} bins {name}" for name, count in self._bins_rejected.items())
            raise MeasurementError(f"{names}: {self._rejected} ADCP pings, none usable: {why}")
        found = _describe(self._rows(reports)) or "no messages at all"
        raise MeasurementError(
            f"{names}: no usable ADCP ping; expected pings (AdcpPing messages, ADCP_* frames, PD0, AD2CP or a [[measurements.map]]) "
            f"with positions and, unless in earth coordinates, attitude. Found: {found}"
        )

    def notes(self, reports: Sequence[LogReport]) -> list[str]:
        """Return what a user should know of messages that could not be decoded, or not be ordered by the clock asked for."""
        unstamped = [
            f"{report.path}: {report.without_stamp} messages without a stamp were ordered by their log time"
            for report in reports
            if report.without_stamp
        ]
        clocks = [f"{report.path}: {note}" for report in reports for note in report.notes]
        means = [f"{count} mean currents ({kind}): not used by this estimator" for kind, count in sorted(self._not_taken.items())]
        return (
            unstamped
            + clocks
            + self._doubts()
            + means
            + [
                f"{report.path}: {count} messages on {topic} could not be decoded: {why}"
                for report in reports
                for topic, (count, why) in sorted(report.undecodable.items())
            ]
        )

    def _doubts(self) -> list[str]:
        """Return what the gate and the watch did, in words."""
        said = []
        if self._gated:
            said.append(f"{self._gated} profiles contradicted the estimate and were rejected; [gating] sets the gate")
        if self._softened:
            said.append(f"{self._softened} profiles contradicted the estimate and counted with larger errors")
        if self._inflations:
            factors = ", ".join(f"{factor:.2g}" for factor in self._inflations[:_SAID_INFLATIONS])
            more = " ..." if len(self._inflations) > _SAID_INFLATIONS else ""
            said.append(
                f"most profiles lay outside what the estimate expected, so its covariance was grown {len(self._inflations)} times, "
                f"by {factors}{more}: the ensemble, or the errors stated, do not fit this log"
            )
        return said

    def summary(
        self,
        reports: Sequence[LogReport],
        seconds: Mapping[str, float],
        planned: tuple[Plan | None, str, tuple[Outcome, ...]],
        truth: TruthScore | None,
        notes: tuple[str, ...],
    ) -> ReplaySummary:
        """Return the replay's summary.

        Args:
            reports: Of the logs.
            seconds: Wall time of each stage.
            planned: The last plan, why there is none, and what became of the surfacings that plans said would be next.
            truth: Score against a truth, if one was given.
            notes: What the user should know.
        """
        dives = tuple(
            DiveRow(dive, sums.profiles, sums.bins, sums.rms("predicted"), sums.rms("prior"), sums.nis_per_dof)
            for dive, sums in sorted(self._dives.items())
        )
        return ReplaySummary(
            messages=self._rows(reports),
            losses=tuple((report.path, loss) for report in reports for loss in report.losses),
            late=sum(self.late.values()),
            profiles_used=self._all.profiles,
            profiles_rejected=self._rejected,
            bins_used=self._all.bins,
            bins_rejected=dict(self._bins_rejected),
            rms_before=self._all.rms("before"),
            rms_after=self._all.rms("after"),
            rms_prior=self._all.rms("prior"),
            nis_per_dof=self._all.nis_per_dof,
            by_dive=dives,
            seconds=dict(seconds),
            plan=planned[0],
            plan_note=planned[1],
            outcomes=planned[2],
            truth=truth,
            notes=notes,
        )

    def _rows(self, reports: Sequence[LogReport]) -> tuple[TopicRow, ...]:
        read: Counter[str] = Counter()
        reasons: dict[str, Counter[str]] = defaultdict(Counter)
        for report in reports:
            read.update(report.read)
            for topic, (count, why) in report.undecodable.items():
                reasons[topic][f"cannot be decoded: {why}"] += count
        for topic, counts in self._reasons.items():
            reasons[topic].update(counts)
        for topic, count in self.late.items():
            reasons[topic]["later than the reorder window allows"] += count
        rows = []
        for topic in sorted(read):
            unexplained = read[topic] - self._used[topic] - sum(reasons[topic].values())
            if unexplained > 0:
                reasons[topic]["not asked for: of no use to the estimator, or outside the time span"] += unexplained
            rows.append(TopicRow(topic, read[topic], self._used[topic], read[topic] - self._used[topic], dict(reasons[topic])))
        return tuple(rows)


def _describe(rows: Sequence[TopicRow]) -> str:
    """Return the topics met, those that speak of current or position with their reasons first, the rest by their number."""
    shown = sorted(rows, key=lambda row: (not _near_miss(row), -row.read))
    words = []
    for row in shown[:_TOPICS_SHOWN]:
        why = ", ".join(f"{count} x {reason}" for reason, count in row.reasons.items()) if _near_miss(row) else ""
        words.append(f"{row.topic} ({row.read}{': ' + why if why else ''})")
    more = f", and {len(rows) - _TOPICS_SHOWN} more topics" if len(rows) > _TOPICS_SHOWN else ""
    return "; ".join(words) + more


def _near_miss(row: TopicRow) -> bool:
    """Return whether something of a topic was used, or refused for a reason of its own."""
    return row.used > 0 or any(not reason.startswith(("not asked for", "not a kind")) for reason in row.reasons)
