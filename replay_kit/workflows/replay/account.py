"""Account of a vehicle's messages and observations: for the outcome, for notes, and for errors on unusable logs."""

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from replay_kit.core.errors import MeasurementError
from replay_kit.core.grid import Grid
from replay_kit.core.message import NO_MEANS, LogReport, Message
from replay_kit.core.observation.evidence import Evidence
from replay_kit.logs.merge import Merge
from replay_kit.logs.payloads import merged_notes, short_note
from replay_kit.logs.tables.schemas import NOT_A_KIND
from replay_kit.measurements.step import left_out_rules
from replay_kit.results.losses import coded_reasons, loss_json
from replay_kit.results.outcome.parts import evidence_part
from replay_kit.workflows.replay.inputs.scan import Logs
from replay_kit.workflows.replay.steps import Counts, counts_with

#: Reason of a message that comes after the reorder window.
LATE = "later than the reorder window allows"
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
    ("cannot be decoded: row without a time or a place", "both, stated for each row,"),
)
# What some reasons of bins mean.
_LIMITS = {"gross_range": " (a component beyond measurements.max_speed: check its unit)"}
# Kinds of measurements in words.
_NAMES = {"dac": "mean currents of dives", "drift": "drifts at the surface"}
# Topics named when a log cannot be used; `replay-kit info` names all.
_TOPICS_SHOWN = 10


@dataclass(frozen=True, slots=True, eq=False)
class Account:
    """Account of a vehicle's messages and observations.

    Attributes:
        counts: Counts of both.
        reports: Reports on its logs.
        merged: Merged messages of its logs.
        first_input: Number of its first log.
    """

    counts: Counts
    reports: Sequence[LogReport]
    merged: Merge[Message]
    first_input: int = 0

    def topics(self) -> list[dict[str, Any]]:
        """Return a row per topic of the logs: number of messages read, used and skipped, and skipped by reason."""
        merged, read = self.merged, Counter[str]()
        reasons: dict[str, Counter[str]] = defaultdict(Counter)
        for report in self.reports:
            read.update(report.read)
            for topic, (count, why) in report.undecodable.items():
                reasons[topic][f"cannot be decoded: {why}"] += count
        for (topic, reason), count in self.counts.messages.items():
            reasons[topic][reason] += count
        for why, excluded in (
            (LATE, merged.late),
            ("its stamp is far from its neighbours'", merged.astray),
        ):
            for topic, count in excluded.items():
                reasons[topic][why] += count
        rows = []
        for topic in sorted(read):
            known = reasons[topic]
            used = known.pop("", 0)
            skipped = read[topic] - used
            if (unexplained := skipped - known.total()) > 0:
                known["not needed by the estimator, or outside the time span"] += unexplained
            counts = {"read": read[topic], "used": used, "skipped": skipped}
            rows.append({"topic": topic, **counts, "reasons": known})
        return rows

    def require_left_out(self, rules: Sequence[str]) -> None:
        """Raise MeasurementError if a rule of ``measurements.without`` withheld nothing: the result would be that of the whole log."""
        applied = {rule for _, reason in self.counts.messages for rule in left_out_rules(reason)}
        dives = sorted(dive for dive in self.counts.dives if dive > 0)
        held = f"dives {dives[0]}..{dives[-1]} with" if dives else "no dive with"
        for rule in rules:
            if rule not in applied:
                raise MeasurementError(
                    f"--without {rule}: the log holds nothing of that; it has {held} measurements; leave the rule out, or name dives "
                    "of the log"
                )

    def require_usable(self, grid: Grid, logs: Logs) -> None:
        """Raise MeasurementError if no profile was used; the message lists the data found, and what of the logs is below the forecast."""
        counts, vehicle = self.counts, self.counts.last_position
        if counts.total.profiles:
            return
        names = ", ".join(report.path for report in self.reports)
        said = [note for report in self.reports for note in report.notes]
        odd = "".join(f". {note}" for note in said if note.endswith("taken as missing"))
        if counts.bins_rejected.get("outside_region") and vehicle is not None:
            raise MeasurementError(
                f"{names}: the log lies outside the ensemble's region: "
                f"last position {vehicle.latitude:.4f} N, {vehicle.longitude:.4f} E; the region is "
                f"{grid.longitude.min():.3f}..{grid.longitude.max():.3f} E, {grid.latitude.min():.3f}..{grid.latitude.max():.3f} N. "
                "Use another ensemble, or --place-ensemble for a study"
            )
        if rejected := counts.total.rejected:
            why = ", ".join(
                f"{n} values {name}{_LIMITS.get(name, '')}"
                for name, n in counts.bins_rejected.items()
            )
            what = ", ".join(
                f"{sums.rejected} {_NAMES.get(kind, kind)}"
                for kind, sums in counts.kinds.items()
                if sums.rejected
            )
            below = surface_only(grid, logs) if "below_grid" in counts.bins_rejected else ""
            raise MeasurementError(
                f"{names}: {what or f'{rejected} measurements'}, none usable: {why or 'too far from the forecast'}"
                f"{below and f'. {below}'}{odd}"
            )
        found = _describe(self.topics()) or "no messages at all"
        lost = self.lost_pings()
        means = "".join(f". {note}" for note in said if note.startswith(NO_MEANS))
        raise MeasurementError(
            f"{names}: {lost}{'. ' if lost else ''}no usable ADCP ping and no mean current of a dive; "
            "expected pings (AdcpPing, ADCP_* frames, PD0, AD2CP, [[measurements.map]]) with positions, or mean currents between fixes. "
            f"Found: {found}{self._mapping_hint()}{means}{odd}"
        )

    def _mapping_hint(self) -> str:
        unknown = {topic for topic, reason in self.counts.messages if reason == NOT_A_KIND}
        if not unknown:
            return ""
        netcdf = (report.notes[:1] for report in self.reports if report.format == "netcdf")
        variables = "".join(f". {note}" for notes in netcdf for note in notes)
        return (
            f"{variables}. {len(unknown)} topics are of unknown types: replay-kit info {self.reports[0].path} --suggest map.toml writes a "
            "mapping of them to complete, for --config map.toml"
        )

    def notes(self) -> list[str]:
        """Return notes on log clocks and unused observations; ``topics`` has the reasons of unused messages."""
        jumps = (
            (self.reports[one.input - self.first_input].path, one) for one in self.merged.jumps
        )
        return [
            *filter(None, [self.merged.doubtful_times]),
            *(
                f"{report.path}: {report.without_stamp} messages without a stamp were ordered by their log time"
                for report in self.reports
                if report.without_stamp
            ),
            *_notes_of(self.reports),
            *(f"{path}: {jump}" for path, jump in jumps),
            *self.counts.notes(),
            *(
                f"{count} mean currents ({kind}): not supported by this estimator"
                for kind, count in sorted(self.counts.unsupported.items())
            ),
        ]

    def lost_pings(self) -> str:
        """Return the pings lost for lack of a setting, if more than a fifth of a topic's; otherwise empty."""
        rows, late = self.topics(), self.merged.late
        if any(late.get(row["topic"], 0) > _MANY_LOST * row["read"] for row in rows):
            seconds = math.ceil(self.merged.late_by_s)
            # what they would have placed follows from it
            return (
                f"{sum(late.values())} messages came up to {seconds} s later than others before them, more than "
                f"the reorder window allows; logs.reorder_window = {seconds} keeps them"
            )
        lost = list[str]()
        for row in rows:
            for reason, count in row["reasons"].items():
                what = f"{count} rows" if "row " in reason else f"{count} of {row['read']} pings"
                lost += [
                    f"{what} on {row['topic']} were not used: {reason.partition(';')[0]}; {setting} would keep them"
                    for begin, setting in _KEEPING
                    if reason.startswith(begin) and count > _MANY_LOST * row["read"]
                ]
        return ". ".join(lost)

    def part(self) -> dict[str, Any]:
        """Return the part of an outcome on messages and observations."""
        rows = [row | {"reasons": coded_reasons(row["reasons"])} for row in self.topics()]
        losses = [(report.path, loss) for report in self.reports for loss in report.losses]
        return _measured(self.counts) | {
            "messages": rows,
            "lost_pings": self.lost_pings(),
            "losses": [{"file": path} | loss_json(loss) for path, loss in losses],
            "late": sum(self.merged.late.values()),
            "mission": ", ".join(dict.fromkeys(one.mission for one in self.reports if one.mission)),
        }


def surface_only(grid: Grid, logs: Logs) -> str:
    """Return the lack of a forecast of the surface for logs that go below it, as a sentence; empty for other forecasts and logs."""
    if grid.levels[-1] > 0.0 or not (deepest := logs.reach.deepest):
        return ""
    return f"The forecast has only the level 0 m, and the log goes to {deepest:.0f} m: use one with levels down to there"


def pooled_part(each: Mapping[str, Account]) -> dict[str, Any]:
    """Return the part of an outcome on messages and observations of several vehicles by name; dives are counted per vehicle."""
    parts, whole = {name: account.part() for name, account in each.items()}, Counts()
    for k, part in enumerate(account.counts for account in each.values()):
        bins = counts_with(whole.bins_rejected, part.bins_rejected.items())
        evidence = {**whole.evidence}
        if part.evidence:
            evidence[-k] = Evidence(part.evidence).total
        whole = Counts(bins_rejected=bins, total=whole.total.plus(part.total), evidence=evidence)
    return _measured(whole) | {
        "messages": [
            row | {"topic": f"{name} {row['topic']}"}
            for name, part in parts.items()
            for row in part["messages"]
        ],
        "losses": [loss for part in parts.values() for loss in part["losses"]],
        "late": sum(part["late"] for part in parts.values()),
    }


def _measured(counts: Counts) -> dict[str, Any]:
    """Return the part of an outcome on observations."""
    total = counts.total
    sources = [
        {
            "kind": kind,
            "used": sums.profiles,
            "rejected": sums.rejected,
            "values": sums.dof,
            **sums.rms_of("before", "after", "prior", begin="rms_"),
            "nis_per_dof": sums.nis_per_dof,
            "doubts": [
                f"{n} with {doubt}"
                for (doubted, doubt), n in counts.doubts.items()
                if doubted == kind
            ],
        }
        for kind, sums in sorted(counts.sources.items())
    ]
    return {
        "observations": {
            "used": total.profiles,
            "rejected": total.rejected,
            "bins_used": total.bins,
            "mean_currents": total.means,
            "bins_rejected": counts.bins_rejected,
            # of a run without any nothing needs to be said
            **({"sources": sources} if sources else {}),
        },
        "rms_innovation": total.rms_of("before", "after", "prior"),
        "nis_per_dof": total.nis_per_dof,
        "by_dive": [
            {
                "dive": dive,
                "profiles": sums.profiles - sums.means,
                "bins": sums.bins - sums.means,
                "mean_currents": sums.means,
                **sums.rms_of("predicted", "prior", begin="rms_innovation_"),
                "nis_per_dof": sums.nis_per_dof,
            }
            for dive, sums in sorted(counts.dives.items())
        ],
        "evidence": evidence_part(counts.log_evidence),
    }


def _notes_of(reports: Sequence[LogReport]) -> list[str]:
    """Return the readers' notes with their logs; a note of several logs is given once, with their number."""
    paths = {note: report.path for report in reports for note in report.notes}
    gathered = merged_notes(note for report in reports for note in report.notes)
    missions = dict.fromkeys(report.mission for report in reports if report.mission)
    merged = f"the logs are of {len(missions)} missions, merged as those of one vehicle: {', '.join(missions)}"
    return [merged] * (len(missions) > 1) + [
        f"{paths[found[0]] if len(found) == 1 else f'{len(found)} logs'}: {short_note(note)}"
        for note, found in gathered.items()
    ]


def _describe(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the topics found: currents and positions first, with reasons; the number of the others."""

    def why(row: Mapping[str, Any]) -> str:
        """Return why messages were not used, if one was used or skipped because of its contents; otherwise empty."""
        passed = ("not needed", NOT_A_KIND)
        relevant = row["used"] or any(not one.startswith(passed) for one in row["reasons"])
        each = (f"{count} x {reason}" for reason, count in row["reasons"].items())
        return ": " * bool(row["reasons"]) + ", ".join(each) if relevant else ""

    some = sorted(rows, key=lambda row: (not (row["used"] or why(row)), -row["read"]))
    words = [f"{row['topic']} ({row['read']}{why(row)})" for row in some[:_TOPICS_SHOWN]]
    more = f", and {len(rows) - _TOPICS_SHOWN} more topics" if len(rows) > _TOPICS_SHOWN else ""
    return "; ".join(words) + more
