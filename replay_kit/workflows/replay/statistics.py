"""Running counts of a replay, as frozen values: messages, measurements, dives."""

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from replay_kit.core.arrays import replace
from replay_kit.core.errors import MeasurementError
from replay_kit.core.evidence import Evidence
from replay_kit.core.grid import Grid
from replay_kit.core.message import NO_MEANS, LogReport, Message
from replay_kit.core.observation import Measurement, kind_of
from replay_kit.logs.merge import ClockJump, Merge
from replay_kit.logs.shared.payloads import gather, short
from replay_kit.logs.tables.schemas import NOT_A_KIND
from replay_kit.measurements.step import left_out_rules
from replay_kit.results.outcome.run import DiveRow, ReplaySummary, SourceRow, TopicRow
from replay_kit.workflows.replay.stages.counts import ProfileCounts, SourceCounts, Sums, added
from replay_kit.workflows.replay.stages.estimation import Step

# Of a topic's pings; when more are lost, the summary begins with it.
_MANY_LOST = 0.2
# How the reasons begin for which a ping is lost that a setting would keep, and the setting.
_KEEPING = (
    (
        "no position within",
        "a larger measurements.position_max_age, or positions after the last dive",
    ),
    (
        "ping: expected reference",
        'measurements.reference = "earth" or "platform", whichever the velocities are relative to,',
    ),
    ("heading is magnetic", "measurements.magnetic_declination"),
    ("velocity relative to the platform", "measurements.use_relative = true"),
)
# Topics named when a log cannot be used; `replay-kit info` names all.
_TOPICS_SHOWN = 10


@dataclass(frozen=True, slots=True)
class RunStatistics:
    """Running counts of one replay.

    Attributes:
        profiles: Of profiles and other measurements.
        used: Number of messages that were used, by topic.
        skipped: Of those that were not, by topic and reason.
        unsupported: Mean currents that the estimator cannot use, by kind.
        late: Messages later than the reorder window allows, by topic.
        astray: Set aside because their stamps are far from their neighbours', by topic.
        jumps: Of the logs' clocks.
        late_by: By how much the latest late message is older than the newest before it [s].
        doubt: What is odd about the logs' times; empty when nothing is.
    """

    profiles: ProfileCounts = field(default_factory=ProfileCounts)
    used: Mapping[str, int] = field(default_factory=dict)
    skipped: Mapping[tuple[str, str], int] = field(default_factory=dict)
    unsupported: Mapping[str, int] = field(default_factory=dict)
    late: Mapping[str, int] = field(default_factory=dict)
    astray: Mapping[str, int] = field(default_factory=dict)
    jumps: tuple[ClockJump, ...] = ()
    late_by: float = 0.0
    doubt: str = ""

    def after_messages(self, found: Mapping[tuple[str, str], int]) -> "RunStatistics":
        """Return the statistics with more messages by topic and the reason for which they are not used, empty for those that are."""
        used = {topic: number for (topic, reason), number in found.items() if not reason}
        skipped = {key: number for key, number in found.items() if key[1]}
        counts = added(self.used, used.items()), added(self.skipped, skipped.items())
        return replace(self, used=counts[0], skipped=counts[1])

    def with_unsupported(self, event: Measurement) -> "RunStatistics":
        """Return the statistics with a measurement that the estimator cannot use."""
        return replace(self, unsupported=added(self.unsupported, [(kind_of(event), 1)]))

    def with_rejected(self, number: int) -> "RunStatistics":
        """Return the statistics with more measurements that are not used."""
        profiles = replace(self.profiles, rejected=self.profiles.rejected + number)
        return replace(self, profiles=profiles)

    def after_steps(self, steps: Sequence[Step]) -> "RunStatistics":
        """Return the statistics with more positions and measurements."""
        return replace(self, profiles=self.profiles.after(steps))

    def with_order(self, merged: Merge[Message], first_input: int = 0) -> "RunStatistics":
        """Return the statistics with what merging the logs found: late messages, stamps far from their neighbours, jumps of clocks.

        Args:
            merged: The logs.
            first_input: Of them; their reports begin with its.
        """
        return replace(
            self,
            late=merged.late,
            astray=merged.astray,
            jumps=tuple(replace(jump, input=jump.input - first_input) for jump in merged.jumps),
            late_by=merged.late_by_s,
            doubt=merged.doubtful_times,
        )

    def topic_rows(self, reports: Sequence[LogReport]) -> tuple[TopicRow, ...]:
        """Return a row for each topic of the logs."""
        read: Counter[str] = Counter()
        reasons: dict[str, Counter[str]] = defaultdict(Counter)
        for report in reports:
            read.update(report.read)
            for topic, (count, why) in report.undecodable.items():
                reasons[topic][f"cannot be decoded: {why}"] += count
        for (topic, reason), count in self.skipped.items():
            reasons[topic][reason] += count
        for counts, why in (
            (self.late, "later than the reorder window allows"),
            (self.astray, "its stamp is far from its neighbours'"),
        ):
            for topic, count in counts.items():
                reasons[topic][why] += count
        rows = []
        for topic in sorted(read):
            used = self.used.get(topic, 0)
            unexplained = read[topic] - used - reasons[topic].total()
            if unexplained > 0:
                reasons[topic][
                    "not asked for: of no use to the estimator, or outside the time span"
                ] += unexplained
            rows.append(
                TopicRow(topic, read[topic], used, read[topic] - used, dict(reasons[topic]))
            )
        return tuple(rows)

    def require_left_out(self, rules: Sequence[str]) -> None:
        """Raise MeasurementError when a rule of ``measurements.without`` has left nothing out: the answer would be the whole log's."""
        applied = {rule for _, reason in self.skipped for rule in left_out_rules(reason)}
        for rule in rules:
            if rule not in applied:
                dives = sorted(dive for dive in self.profiles.dives if dive > 0)
                held = (
                    f"dives {dives[0]}..{dives[-1]} with measurements"
                    if dives
                    else "no dive with measurements"
                )
                raise MeasurementError(
                    f"--without {rule}: expected something of the log to leave out, but it holds nothing of that; "
                    f"besides what was left out it has {held}; leave the rule out, or name dives of the log"
                )

    def require_usable(self, reports: Sequence[LogReport], grid: Grid) -> None:
        """Raise MeasurementError when no profile was used; the message lists what was found instead."""
        counts, vehicle = self.profiles, self.profiles.last_position
        if counts.total.profiles:
            return
        names = ", ".join(report.path for report in reports)
        if counts.bins_rejected.get("outside_region") and vehicle is not None:
            raise MeasurementError(
                f"{names}: the log lies outside the ensemble's region: "
                f"last position {vehicle.latitude:.4f} N, {vehicle.longitude:.4f} E; the region is "
                f"{grid.longitude.min():.3f}..{grid.longitude.max():.3f} E, {grid.latitude.min():.3f}..{grid.latitude.max():.3f} N. "
                "Use an ensemble of the right place, or --place-ensemble for a study"
            )
        if counts.rejected:
            why = ", ".join(f"{count} bins {name}" for name, count in counts.bins_rejected.items())
            raise MeasurementError(f"{names}: {counts.rejected} ADCP pings, none usable: {why}")
        found = _describe(self.topic_rows(reports)) or "no messages at all"
        lost = self.lost_pings(reports)
        means = [note for report in reports for note in report.notes if note.startswith(NO_MEANS)]
        hints = "".join([self._mapping_hint(reports), *(f". {note}" for note in means)])
        raise MeasurementError(
            f"{names}: {lost}{'. ' if lost else ''}no usable ADCP ping and no mean current of a dive; "
            "expected pings (AdcpPing messages, ADCP_* frames, PD0, AD2CP or a [[measurements.map]]) with positions and, unless in earth "
            f"coordinates, attitude; or depth-averaged currents between fixes. Found: {found}{hints}"
        )

    def _mapping_hint(self, reports: Sequence[LogReport]) -> str:
        unknown = {topic for topic, reason in self.skipped if reason == NOT_A_KIND}
        if not unknown:
            return ""
        variables = "".join(
            f". {note}"
            for report in reports
            if report.format == "netcdf"
            for note in report.notes[:1]
        )
        name = reports[0].path
        return (
            f"{variables}. {len(unknown)} topics are of unknown types: replay-kit info {name} --suggest map.toml writes a mapping "
            "of them to complete, for --config map.toml"
        )

    def notes(self, reports: Sequence[LogReport]) -> list[str]:
        """Return notes on the clocks of the logs, on measurements that were not used, and on messages that could not be decoded."""
        return [
            *([self.doubt] if self.doubt else []),
            *(
                f"{report.path}: {report.without_stamp} messages without a stamp were ordered by their log time"
                for report in reports
                if report.without_stamp
            ),
            *_notes_of(reports),
            *(f"{reports[jump.input].path}: {jump}" for jump in self.jumps),
            *(
                f"{count} messages on {topic} were set aside: their stamps are more than a day from those before and after"
                for topic, count in sorted(self.astray.items())
            ),
            *self.profiles.notes(),
            *(
                f"{count} mean currents ({kind}): not supported by this estimator"
                for kind, count in sorted(self.unsupported.items())
            ),
            *(
                f"{report.path}: {count} messages on {topic} could not be decoded: {why}"
                for report in reports
                for topic, (count, why) in sorted(report.undecodable.items())
            ),
        ]

    def lost_pings(self, reports: Sequence[LogReport]) -> str:
        """Return which pings were lost for want of a setting, where they are more than a fifth of a topic's; else empty."""
        words, rows = [], self.topic_rows(reports)
        late = self.late
        if pushed := any(late.get(row.topic, 0) > _MANY_LOST * row.read for row in rows):
            # what they would have placed follows from it
            words.append(
                f"{sum(late.values())} messages came up to {math.ceil(self.late_by)} s later than others before them, more than "
                f"the reorder window allows; logs.reorder_window = {math.ceil(self.late_by)} keeps them"
            )
        for row in [] if pushed else rows:
            for reason, count in row.reasons.items():
                keeping = next(
                    (setting for begin, setting in _KEEPING if reason.startswith(begin)), None
                )
                if keeping is not None and count > _MANY_LOST * row.read:
                    why = reason.partition(";")[0]
                    words.append(
                        f"{count} of {row.read} pings on {row.topic} were not used: {why}; {keeping} would keep them"
                    )
        return ". ".join(words)

    def summary(self, reports: Sequence[LogReport]) -> ReplaySummary:
        """Return the summary of messages and measurements; times, plan, truth and notes are added to it."""
        counts, total = self.profiles, self.profiles.total
        return ReplaySummary(
            messages=self.topic_rows(reports),
            lost_pings=self.lost_pings(reports),
            losses=tuple((report.path, loss) for report in reports for loss in report.losses),
            late=sum(self.late.values()),
            profiles_used=total.profiles,
            profiles_rejected=counts.rejected,
            bins_used=total.bins,
            mean_currents=sum(counts.path_means.values()),
            bins_rejected=counts.bins_rejected,
            rms_before=total.rms(total.before),
            rms_after=total.rms(total.after),
            rms_prior=total.rms(total.prior),
            nis_per_dof=total.nis_per_dof,
            sources=tuple(_source_row(*each) for each in sorted(counts.sources.items())),
            evidence=Evidence(counts.evidence) if counts.evidence else None,
            by_dive=tuple(
                DiveRow(
                    dive,
                    sums.profiles,
                    sums.bins,
                    sums.rms(sums.predicted),
                    sums.rms(sums.prior),
                    sums.nis_per_dof,
                )
                for dive, sums in sorted(counts.dives.items())
            ),
        )


def pooled(each: Mapping[str, tuple[RunStatistics, Sequence[LogReport]]]) -> ReplaySummary:
    """Return the summary of the messages and measurements of several vehicles, by name; dives have none, as each counts its own."""
    summaries = {name: of.summary(reports) for name, (of, reports) in each.items()}
    counts = [of.profiles for of, _ in each.values()]
    bins_rejected, path_means = Counter[str](), Counter[str]()
    for one in counts:
        bins_rejected.update(one.bins_rejected)
        path_means.update(one.path_means)
    total = Sums(*map(sum, zip(*(one.total for one in counts), strict=True)))
    evidence = Evidence({-k: Evidence(one.evidence).total for k, one in enumerate(counts)})
    both = ProfileCounts(
        rejected=sum(one.rejected for one in counts),
        bins_rejected=bins_rejected,
        total=total,
        path_means=path_means,
    )
    summary: ReplaySummary = RunStatistics(profiles=both).summary(())
    return replace(
        summary,
        messages=tuple(
            replace(row, topic=f"{name} {row.topic}")
            for name, one in summaries.items()
            for row in one.messages
        ),
        losses=tuple(loss for one in summaries.values() for loss in one.losses),
        late=sum(one.late for one in summaries.values()),
        evidence=evidence if evidence.total.measurements else None,
    )


def _source_row(kind: str, found: SourceCounts) -> SourceRow:
    sums = found.sums
    before, after, prior = map(sums.rms, (sums.before, sums.after, sums.prior))
    doubts = tuple(f"{number} with {doubt}" for doubt, number in found.doubts.items())
    counted = sums.profiles, found.rejected, sums.dof
    return SourceRow(kind, *counted, before, after, prior, sums.nis_per_dof, doubts)


def _notes_of(reports: Sequence[LogReport]) -> list[str]:
    """Return the readers' notes with their logs; one that several logs have is given once, with their number."""
    paths = {note: report.path for report in reports for note in report.notes}
    gathered = gather(note for report in reports for note in report.notes)
    notes = [
        f"{paths[found[0]] if len(found) == 1 else f'{len(found)} logs'}: {short(note)}"
        for note, found in gathered.items()
    ]
    missions = dict.fromkeys(report.mission for report in reports if report.mission)
    if len(missions) > 1:
        notes.insert(
            0,
            f"the logs are of {len(missions)} missions, merged as if one vehicle had made them: {', '.join(missions)}",
        )
    return notes


def _describe(rows: Sequence[TopicRow]) -> str:
    """Return the topics met: first those of currents or positions, with the reasons; of the rest their number."""
    words = []
    for row in sorted(rows, key=lambda row: (not _is_relevant(row), -row.read))[:_TOPICS_SHOWN]:
        why = (
            ", ".join(f"{count} x {reason}" for reason, count in row.reasons.items())
            if _is_relevant(row)
            else ""
        )
        words.append(f"{row.topic} ({row.read}{': ' + why if why else ''})")
    more = f", and {len(rows) - _TOPICS_SHOWN} more topics" if len(rows) > _TOPICS_SHOWN else ""
    return "; ".join(words) + more


def _is_relevant(row: TopicRow) -> bool:
    """Return whether a message of a topic was used, or skipped for a reason that concerns its contents."""
    return row.used > 0 or any(
        not reason.startswith(("not asked for", "not a kind")) for reason in row.reasons
    )
