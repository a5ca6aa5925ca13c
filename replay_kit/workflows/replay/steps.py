"""Estimation stage: positions and observations in, the estimate before and after each out; and running counts of them."""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from operator import add
from typing import Any, NamedTuple, TypeVar

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.observation import (
    Innovation,
    LinearMeasurement,
    PathMean,
    Profiles,
    Reason,
    VehicleState,
    kind_of,
    reasons_of,
)
from replay_kit.core.observation.evidence import BlockEvidence, Evidence, block_of
from replay_kit.estimator import Estimator
from replay_kit.workflows.replay.events import Aside, Event, Track

Key = TypeVar("Key")
# Of an observation that repeats another or is older than those before it, and so contradicts nothing.
_REPEATS = np.int32(Reason.DUPLICATE | Reason.OUT_OF_ORDER)
# Kinds of the vehicle's own observations.
_OF_VEHICLE = "profiles", "dac", "drift"
# Number of a dive whose mean current has come, after which a measurement of it begins it anew.
_ENDED = -1


@dataclass(frozen=True, slots=True, eq=False)
class Dive:
    """Present dive of a vehicle.

    Attributes:
        start: Estimator's state before its first observation.
        number: Number of the dive.
    """

    # Any: each kind of estimator has a state of its own, which only it reads
    start: Any
    number: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Event with the estimate before and after it.

    Attributes:
        event: Consecutive positions or one, an observation or group of profiles, or a DAC not assimilated.
        before: Estimator's state before it.
        after: Estimator's state after it.
        innovation: Innovation of an observation or group, and decision of the gate; None for others.
        dive_innovation: shape (n, 2) [m/s], against the estimate before the observation's dive; of a group all bins.
        dive_std: shape (1, 2) [m/s], predicted standard deviation of ``dive_innovation`` for a DAC; None for others.
    """

    event: Event | VehicleState
    before: Any
    after: Any
    innovation: Innovation | None = None
    dive_innovation: Array = field(default_factory=lambda: np.empty((0, 2)))
    dive_std: Array | None = None


#: An event with the number of its vehicle.
Given = tuple[int, Event]


def assimilate(
    estimators: Sequence[Estimator[Any]],
    current: Any,
    dives: Sequence[Dive],
    given: Sequence[Given],
) -> tuple[Any, list[Dive], list[tuple[int, Step]]]:
    """Return the estimator's state, the dives of all vehicles and the steps after events.

    Args:
        estimators: Estimator of each vehicle, all with one type of state.
        current: Estimator's state before.
        dives: Dive of each vehicle before.
        given: Events in order.
    """
    dives, steps = list(dives), list[tuple[int, Step]]()
    # measurements of vehicles with one estimator are assimilated together
    for _, of_estimator in groupby(given, key=lambda one: id(estimators[one[0]])):
        together = list(of_estimator)
        estimator = estimators[together[0][0]]
        # Any: only an estimator that supports mean currents along paths is given some
        measured: list[Any] = [
            event for _, event in together if not isinstance(event, Track | Aside)
        ]
        results = deque(estimator.assimilate(current, measured)[1])
        for vehicle, event in together:
            if isinstance(event, Track | Aside):
                steps.append((vehicle, Step(event, current, current)))
                continue
            left = len(event) if isinstance(event, Profiles) else 1
            while left:
                # Any: the event is, or is of, what was given
                some: Any
                some, before, current, innovation, against = results.popleft()
                left -= len(some) if isinstance(some, Profiles) else 1
                if some.dive != dives[vehicle].number:
                    dives[vehicle] = Dive(before, some.dive)
                start = dives[vehicle].start
                std, of_dive = None, None if against is None else against(start)
                if isinstance(some, PathMean):
                    # profiles of the dive itself make the estimate surer than it was before the dive
                    known = innovation
                    if start is not before:
                        known = estimator.assimilate(start, [some])[1][-1].innovation
                    std, of_dive = known.innovation_std, known.innovation
                if of_dive is None or np.isnan(of_dive).all():
                    of_dive = estimator.innovation(start, some)
                steps.append((vehicle, Step(some, before, current, innovation, of_dive, std)))
                if std is not None and len(dives) > 1:
                    # of many vehicles each would keep the state that its last dive began with, tens of megabytes
                    dives[vehicle] = Dive(start, _ENDED)
    ended = [Dive(current, _ENDED) if dive.number == _ENDED else dive for dive in dives]
    return current, ended, steps


class Sums(NamedTuple):
    """Sums over observations, and of squares over the bins and components of used ones.

    Attributes:
        profiles: Number of used profiles and other observations.
        bins: Number of bins used.
        nis: Normalised innovations squared.
        dof: Degrees of freedom.
        before: Squared innovations [m^2/s^2].
        after: Squared residuals after the update [m^2/s^2].
        prior: Squared innovations against the prior without observations [m^2/s^2].
        predicted: Squared innovations against the estimate before the dive [m^2/s^2].
        means: Number of used DACs.
        rejected: Number of observations without a usable bin, or rejected by the gate.
        gated: Number rejected by the gate.
        repeated: Number unused because they repeat another, or are older than their predecessors.
        refused: Number of profiles of those gated or repeated.
    """

    profiles: int = 0
    bins: int = 0
    nis: float = 0.0
    dof: int = 0
    before: float = 0.0
    after: float = 0.0
    prior: float = 0.0
    predicted: float = 0.0
    means: int = 0
    rejected: int = 0
    gated: int = 0
    repeated: int = 0
    refused: int = 0

    @staticmethod
    def of(step: Step) -> "Sums":
        """Return the sums of a step's observation, or of the profiles of its group."""
        innovation = step.innovation
        assert innovation is not None
        if not innovation.accepted:
            gated = innovation.decision == "rejected"
            repeats = gated and bool((innovation.reasons & _REPEATS).any())
            refused = innovation.profiles if gated else 0
            return Sums(rejected=1, gated=gated - repeats, repeated=int(repeats), refused=refused)
        if (totals := innovation.totals) is None:
            each = innovation.innovation, innovation.residual, innovation.prior_innovation
            bins, (before, after, prior) = innovation.dof // 2, map(_squares, each)
        else:
            bins, before, after, prior = totals.bins, totals.before, totals.after, totals.prior
        means, predicted = int(isinstance(step.event, PathMean)), _squares(step.dive_innovation)
        of_fit = innovation.nis, innovation.dof, before, after, prior, predicted
        return Sums(innovation.profiles, bins, *of_fit, means)

    def plus(self, other: "Sums") -> "Sums":
        """Return the sums of both."""
        return Sums(*map(add, self, other))

    def rms_of(self, *names: str, begin: str = "") -> dict[str, float]:
        """Return the root mean square [m/s] of sums of squares, by their names after a common beginning; NaN without data."""
        return {
            f"{begin}{name}": float(np.sqrt(getattr(self, name) / self.dof)) if self.dof else np.nan
            for name in names
        }

    @property
    def nis_per_dof(self) -> float:
        """Mean normalised innovation squared per degree of freedom; NaN without data."""
        return self.nis / self.dof if self.dof else float("nan")


def _squares(values: Array) -> float:
    return float(np.nansum(values**2))


@dataclass(frozen=True, slots=True)
class Counts:
    """Counts of a vehicle's messages, observations and bins.

    Attributes:
        messages: Messages by topic and reason of not using them, empty for used ones.
        unsupported: DACs that the estimator cannot use, by kind.
        bins_rejected: Unused bins, by reason.
        total: Sums over all observations.
        dives: Sums over the profiles and DACs of each dive, rejected ones too.
        kinds: Sums over the observations of each kind.
        doubts: Number of observations of other sources by kind and possible fault.
        last_position: Last position; None before the first.
        interpolated: Used profiles with a place interpolated between positions far apart in time.
        position_std: Largest standard error of such a place [m].
        corrections: Magnitude of the flight-model correction of each DAC [m/s].
        evidence: Log evidence of all observations, also rejected ones.
    """

    messages: Mapping[tuple[str, str], int] = field(default_factory=dict)
    unsupported: Mapping[str, int] = field(default_factory=dict)
    bins_rejected: Mapping[str, int] = field(default_factory=dict)
    total: Sums = Sums()  # noqa: RUF009 - a frozen value
    dives: Mapping[int, Sums] = field(default_factory=dict)
    kinds: Mapping[str, Sums] = field(default_factory=dict)
    doubts: Mapping[tuple[str, str], int] = field(default_factory=dict)
    last_position: VehicleState | None = None
    interpolated: int = 0
    position_std: float = 0.0
    corrections: tuple[float, ...] = ()
    evidence: Mapping[int, BlockEvidence] = field(default_factory=dict)

    @property
    def sources(self) -> dict[str, Sums]:
        """Sums over the observations of sources other than the vehicle, by kind."""
        return {kind: sums for kind, sums in self.kinds.items() if kind not in _OF_VEHICLE}

    @property
    def log_evidence(self) -> Evidence | None:
        """Log evidence of the observations; None if the estimator states no density."""
        return Evidence(self.evidence) if self.evidence else None

    def plus(self, more: Sums) -> "Counts":
        """Return the counts with more in total."""
        return replace(self, total=self.total.plus(more))

    def after(self, steps: Sequence[Step]) -> "Counts":
        """Return the counts after steps."""
        total, dives, kinds = self.total, dict(self.dives), dict(self.kinds)
        evidence, bins, doubts = dict(self.evidence), dict(self.bins_rejected), dict(self.doubts)
        last: Track | VehicleState | None = self.last_position
        corrections, far = [*self.corrections], list[float]()
        for step in steps:
            event: Any = step.event
            last = event if isinstance(event, Track) else last
            if (innovation := step.innovation) is None:
                continue
            sums, kind = Sums.of(step), kind_of(event)
            total, kinds[kind] = total.plus(sums), kinds.get(kind, Sums()).plus(sums)
            if isinstance(event, LinearMeasurement):
                if event.label.doubt:
                    doubts = counts_with(doubts, [((kind, event.label.doubt), 1)])
            elif innovation.dive > 0:
                dives[innovation.dive] = dives.get(innovation.dive, Sums()).plus(sums)
            if isinstance(event, PathMean) and event.corrected:
                corrections.append(abs(complex(*event.used) - complex(*event.velocity)))
            if isinstance(event, Profiles) and innovation.accepted:
                far += [std for std in event["position_std"].tolist() if std > 0.0]
            unused = (
                reasons_of(innovation.reasons, innovation.flags)
                if innovation.totals is None
                else innovation.totals.not_used
            )
            bins = counts_with(bins, unused)
            # not of those without a density or variance
            if np.isfinite(innovation.log_likelihood):
                key = block_of(innovation.dive, innovation.time_ns)
                more = BlockEvidence(innovation.log_likelihood, innovation.dof, innovation.profiles)
                evidence[key] = evidence.get(key, BlockEvidence()) + more
        return replace(
            self,
            bins_rejected=bins,
            total=total,
            dives=dives,
            kinds=kinds,
            doubts=doubts,
            last_position=last[-1] if isinstance(last, Track) else last,
            interpolated=self.interpolated + len(far),
            position_std=max([self.position_std, *far]),
            corrections=tuple(corrections),
            evidence=evidence,
        )

    def rebuilt(self, steps: Sequence[Step]) -> "Counts":
        """Return the counts after a rebuild of the estimate: only its own steps count as used."""
        rejected = self.total.rejected + self.total.profiles - len(steps)
        start = Counts(self.messages, self.unsupported, total=Sums(rejected=rejected))
        after = replace(start, last_position=self.last_position).after(steps)
        unused = [("inconsistent", self.total.bins - after.total.bins)]
        return replace(after, bins_rejected=counts_with(self.bins_rejected, unused))

    def notes(self) -> list[str]:
        """Return notes on the gate and the consistency checks, as sentences."""
        total, only_means = self.total, self.total.means == self.total.profiles
        told = (
            (
                total.means * only_means,
                f"no profile of the current was used: the estimate is based on {total.means} mean currents of dives only; "
                "the shear is that of the ensemble",
            ),
            (
                self.interpolated,
                f"{self.interpolated} profiles in dives were placed between positions far apart in time, to within "
                f"{self.position_std:.0f} m (measurements.position_max_gap)",
            ),
            (
                total.repeated,
                f"{total.repeated} profiles not used: duplicates, or older than their predecessors, as where logs overlap",
            ),
            (
                total.gated,
                f"{total.gated} profiles contradicted the estimate and were rejected; [gating] sets the gate",
            ),
        )
        return [note for number, note in told if number]


def counts_with(counts: Mapping[Key, int], more: Iterable[tuple[Key, int]]) -> dict[Key, int]:
    """Return counts with more of each key."""
    out = dict(counts)
    for key, count in more:
        out[key] = out.get(key, 0) + count
    return out
