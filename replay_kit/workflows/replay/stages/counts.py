"""Running counts of a replay: messages, observations, bins, dives."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import add
from typing import NamedTuple, TypeVar

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.observation import (
    Innovation,
    LinearMeasurement,
    PathMean,
    Profiles,
    Reason,
    VehicleState,
    reasons_of,
)
from replay_kit.core.observation.evidence import BlockEvidence, Evidence, block_of
from replay_kit.workflows.replay.events import Track
from replay_kit.workflows.replay.stages.estimation import Step

Key = TypeVar("Key")


class Sums(NamedTuple):
    """Sums over profiles, and of squares over their bins and components.

    Attributes:
        profiles: Number of profiles.
        bins: Number of bins used.
        nis: Normalised innovations squared.
        dof: Degrees of freedom.
        before: Squared innovations [m^2/s^2].
        after: Squared residuals after the update [m^2/s^2].
        prior: Squared innovations against the prior without observations [m^2/s^2].
        predicted: Squared innovations against the estimate before the dive [m^2/s^2].
    """

    profiles: int = 0
    bins: int = 0
    nis: float = 0.0
    dof: int = 0
    before: float = 0.0
    after: float = 0.0
    prior: float = 0.0
    predicted: float = 0.0

    def with_profile(self, innovation: Innovation, dive_innovation: Array) -> "Sums":
        """Return the sums with another observation, or with the profiles of a group."""
        totals = innovation.totals
        if totals is None:
            bins, each = innovation.dof // 2, ("innovation", "residual", "prior_innovation")
            squares = [_squares(getattr(innovation, name)) for name in each]
        else:
            bins, squares = totals.bins, [totals.before, totals.after, totals.prior]
        counted = innovation.profiles, bins, innovation.nis, innovation.dof
        return Sums(*map(add, self, (*counted, *squares, _squares(dive_innovation))))

    def rms_of(self, *names: str) -> dict[str, float]:
        """Return the root mean square [m/s] of sums of squares, by their names; NaN without data."""
        return {
            name: float(np.sqrt(getattr(self, name) / self.dof)) if self.dof else np.nan
            for name in names
        }

    @property
    def nis_per_dof(self) -> float:
        """Mean normalised innovation squared per degree of freedom; NaN without data."""
        return self.nis / self.dof if self.dof else float("nan")


def _squares(values: Array) -> float:
    return float(np.nansum(values**2))


@dataclass(frozen=True, slots=True)
class SourceCounts:
    """Counts of one source other than the vehicle.

    Attributes:
        sums: Sums over used observations.
        rejected: Number without a usable value, or rejected by the gate.
        doubts: Number of observations by possible fault.
    """

    sums: Sums = field(default_factory=Sums)
    rejected: int = 0
    doubts: Mapping[str, int] = field(default_factory=dict)

    def after(self, step: Step, innovation: Innovation, doubt: str) -> "SourceCounts":
        """Return the counts with another observation, with its possible fault; empty without one."""
        doubts = added(self.doubts, [(doubt, 1)] if doubt else [])
        if not innovation.accepted:
            return SourceCounts(self.sums, self.rejected + 1, doubts)
        return SourceCounts(
            self.sums.with_profile(innovation, step.dive_innovation), self.rejected, doubts
        )


@dataclass(frozen=True, slots=True)
class Counts:
    """Counts of a vehicle's messages, observations and bins.

    Attributes:
        used: Used messages, by topic.
        skipped: Unused messages, by topic and reason.
        unsupported: DACs that the estimator cannot use, by kind.
        rejected: Profiles without a usable bin, or rejected by the gate.
        bins_rejected: Unused bins, by reason.
        gated: Profiles rejected by the gate.
        total: Sums over all used profiles.
        dives: Sums over the profiles of each dive.
        last_position: Last position; None before the first.
        interpolated: Used profiles with a place interpolated between positions far apart in time.
        position_std: Largest standard error of such a place [m].
        path_means: Used DACs, by kind.
        corrections: Magnitude of the flight-model correction of each DAC [m/s].
        sources: Counts of other sources, by kind.
        evidence: Log evidence of all observations, also rejected ones.
        repeated: Unused observations that repeat another, or are older than their predecessors.
    """

    used: Mapping[str, int] = field(default_factory=dict)
    skipped: Mapping[tuple[str, str], int] = field(default_factory=dict)
    unsupported: Mapping[str, int] = field(default_factory=dict)
    rejected: int = 0
    bins_rejected: Mapping[str, int] = field(default_factory=dict)
    gated: int = 0
    total: Sums = field(default_factory=Sums)
    dives: Mapping[int, Sums] = field(default_factory=dict)
    last_position: VehicleState | None = None
    interpolated: int = 0
    position_std: float = 0.0
    path_means: Mapping[str, int] = field(default_factory=dict)
    corrections: tuple[float, ...] = ()
    evidence: Mapping[int, BlockEvidence] = field(default_factory=dict)
    sources: Mapping[str, SourceCounts] = field(default_factory=dict)
    repeated: int = 0

    @property
    def log_evidence(self) -> Evidence | None:
        """Log evidence of the observations; None if the estimator states no density."""
        return Evidence(self.evidence) if self.evidence else None

    def after_messages(self, found: Mapping[tuple[str, str], int]) -> "Counts":
        """Return the counts with more messages by topic and reason, empty for used ones."""
        used = [(topic, number) for (topic, reason), number in found.items() if not reason]
        skipped = [(key, number) for key, number in found.items() if key[1]]
        return replace(self, used=added(self.used, used), skipped=added(self.skipped, skipped))

    def after(self, steps: Sequence[Step]) -> "Counts":
        """Return the counts after steps."""
        done = [(step, one) for step in steps if (one := step.innovation) is not None]
        used = [(step, one) for step, one in done if one.accepted]
        means = [step.event for step, _ in done if isinstance(step.event, PathMean)]
        total, dives, sources = self.total, dict(self.dives), dict(self.sources)
        for step, one in used:
            total = total.with_profile(one, step.dive_innovation)
            if one.dive > 0 and not isinstance(step.event, LinearMeasurement):
                known = dives.get(one.dive, Sums())
                dives[one.dive] = known.with_profile(one, step.dive_innovation)
        for step, one in done:
            if isinstance(step.event, LinearMeasurement):
                label = step.event.label
                source = sources.get(label.kind, SourceCounts())
                sources[label.kind] = source.after(step, one, label.doubt)
        innovations = [one for _, one in done]
        std = [step.event["position_std"] for step, _ in used if isinstance(step.event, Profiles)]
        far = [each for one in std for each in one[one > 0.0].tolist()]
        tracks = [step.event for step in steps if isinstance(step.event, Track)]
        return replace(
            self,
            rejected=self.rejected + len(done) - len(used),
            bins_rejected=added(
                self.bins_rejected, (named for one in innovations for named in _reasons(one))
            ),
            gated=self.gated
            + sum(one.decision == "rejected" and not _is_repeat(one) for one in innovations),
            total=total,
            dives=dives,
            last_position=tracks[-1][-1] if tracks else self.last_position,
            interpolated=self.interpolated + len(far),
            position_std=max([self.position_std, *far]),
            path_means=added(
                self.path_means,
                ((step.event.kind, 1) for step, _ in used if isinstance(step.event, PathMean)),
            ),
            corrections=self.corrections
            + tuple(
                abs(complex(*event.used) - complex(*event.velocity))
                for event in means
                if event.corrected
            ),
            evidence=_with_evidence(self.evidence, innovations),
            sources=sources,
            repeated=self.repeated + sum(map(_is_repeat, innovations)),
        )

    def rebuilt(self, steps: Sequence[Step]) -> "Counts":
        """Return the counts after a rebuild of the estimate: only its own steps count as used."""
        messages = Counts(self.used, self.skipped, self.unsupported)
        rejected = self.rejected + self.total.profiles - len(steps)
        start = replace(messages, rejected=rejected, last_position=self.last_position)
        after: Counts = start.after(steps)
        unused = [("inconsistent", self.total.bins - after.total.bins)]
        return replace(after, bins_rejected=added(self.bins_rejected, unused))

    def notes(self) -> list[str]:
        """Return notes on the gate and the consistency checks, as sentences."""
        notes = []
        means = sum(self.path_means.values())
        if means and means == self.total.profiles:
            notes.append(
                f"no profile of the current was used: the estimate is based on {means} mean currents of dives only; "
                "the shear is that of the ensemble"
            )
        if self.interpolated:
            notes.append(
                f"{self.interpolated} profiles in dives were placed between positions far apart in time, to within "
                f"{self.position_std:.0f} m (measurements.position_max_gap)"
            )
        if self.repeated:
            notes.append(
                f"{self.repeated} profiles not used: duplicates, or older than their predecessors, as where logs overlap"
            )
        if self.gated:
            notes.append(
                f"{self.gated} profiles contradicted the estimate and were rejected; [gating] sets the gate"
            )
        return notes


def summed(each: Sequence[Counts]) -> Counts:
    """Return the counts of several vehicles together, without dives, which are counted per vehicle."""
    rejected, means = Counter[str](), Counter[str]()
    for one in each:
        rejected.update(one.bins_rejected)
        means.update(one.path_means)
    return Counts(
        rejected=sum(one.rejected for one in each),
        bins_rejected=rejected,
        total=Sums(*map(sum, zip(*(one.total for one in each), strict=True))),
        path_means=means,
        evidence={-k: Evidence(one.evidence).total for k, one in enumerate(each) if one.evidence},
    )


def _with_evidence(
    evidence: Mapping[int, BlockEvidence], innovations: Sequence[Innovation]
) -> dict[int, BlockEvidence]:
    """Return the log evidence by block with more observations, except those without a density or variance."""
    out = dict(evidence)
    for one in innovations:
        if np.isfinite(one.log_likelihood):
            key = block_of(one.dive, one.time_ns)
            out[key] = out.get(key, BlockEvidence()) + BlockEvidence(
                one.log_likelihood, one.dof, one.profiles
            )
    return out


def added(counts: Mapping[Key, int], more: Iterable[tuple[Key, int]]) -> dict[Key, int]:
    """Return counts with more of each key."""
    out = dict(counts)
    for key, count in more:
        out[key] = out.get(key, 0) + count
    return out


def _is_repeat(innovation: Innovation) -> bool:
    """Return whether an observation is unused because it repeats another or is too old; it contradicts nothing."""
    repeats = np.int32(Reason.DUPLICATE | Reason.OUT_OF_ORDER)
    return innovation.decision == "rejected" and bool((innovation.reasons & repeats).any())


def _reasons(innovation: Innovation) -> list[tuple[str, int]]:
    """Return the reasons of unused bins, and the number of bins."""
    if innovation.totals is not None:
        return list(innovation.totals.not_used)
    return reasons_of(innovation.reasons, innovation.flags)
