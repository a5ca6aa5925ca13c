"""What the quality control makes of a mission's logs: each test, what it found, which pings lose everything, and the dives."""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import LogReport, Message
from replay_kit.core.observation import Flag, Observation, Reason
from replay_kit.estimator.update.screening import usable
from replay_kit.logs import merge
from replay_kit.measurements import NOT_A_KIND, MeasurementState, Skipped, Used, finish, initial_state, interpret
from replay_kit.measurements.ping.payload import depth_of_pressure, number
from replay_kit.measurements.ping.pings import PING_SCHEMA
from replay_kit.measurements.quality.ping import Check
from replay_kit.measurements.vehicle.segments import Segments, segments
from replay_kit.workflows.replay.inputs import open_readers

# a depth that stays the same is noted again after a minute
_REPEATED_NS = 60 * 10**9
_NO_NUMBER = "no number in the bin"


@dataclass(slots=True)
class TestCount:
    """What one test said of all bins of a topic that have a velocity.

    Attributes:
        reason: What it marks bins with.
        evaluated: Bins judged.
        suspect: Of these, suspect ones.
        failed: Of these, failed ones.
        not_evaluated: Why to count of the others.
    """

    reason: Reason
    evaluated: int = 0
    suspect: int = 0
    failed: int = 0
    not_evaluated: Counter[str] = field(default_factory=Counter)

    def add(self, check: Check, present: NDArray[np.bool_]) -> None:
        """Count a ping's bins."""
        flags = check.flags[present]
        judged = int(np.count_nonzero(flags != Flag.NOT_EVALUATED))
        self.evaluated += judged
        self.suspect += int(np.count_nonzero(flags == Flag.SUSPECT))
        self.failed += int(np.count_nonzero(flags == Flag.FAIL))
        if judged < flags.size:
            self.not_evaluated[check.why_not or _NO_NUMBER] += flags.size - judged


@dataclass(slots=True)
class TopicQuality:
    """One topic's pings.

    Attributes:
        pings: How many were tested.
        flags: QARTOD flag to count of bins, after all tests.
        tests: By name, in the order in which they are made.
        lost: Pings without a bin that can be used: time [ns, UTC], log, position in it, reasons.
    """

    pings: int = 0
    flags: Counter[int] = field(default_factory=Counter)
    tests: dict[str, TestCount] = field(default_factory=dict)
    lost: list[tuple[int, int, int, Reason]] = field(default_factory=list)

    def add(self, checks: Sequence[Check], observation: Observation) -> None:
        """Count a ping."""
        self.pings += 1
        self.flags.update(observation.flags.tolist())
        present = observation.flags != Flag.MISSING
        for check in checks:
            self.tests.setdefault(check.test, TestCount(check.reason)).add(check, present)
        if not usable(observation.flags).any():
            source = observation.source
            reasons = Reason(int(np.bitwise_or.reduce(observation.reasons)))
            self.lost.append((source.time_ns, source.input, source.position, reasons))


@dataclass(frozen=True, slots=True, eq=False)
class QualityReport:
    """The quality control of some logs.

    Attributes:
        logs: What the readers met.
        settings: The thresholds.
        topics: By name.
        not_used: Topic to reason to count, of messages that give no profile.
        track: The dives, yos and profiles of the vehicle's depths.
        time_ns: shape (n,) [ns, UTC], of the depths.
        depth: shape (n,) [m], the vehicle's.
        late: Messages left out because they came later than the reorder window allows.
    """

    logs: tuple[LogReport, ...]
    settings: MeasurementConfig
    topics: Mapping[str, TopicQuality]
    not_used: Mapping[str, Mapping[str, int]]
    track: Segments
    time_ns: NDArray[np.int64]
    depth: Array
    late: int

    @property
    def exit_code(self) -> int:
        """4 when something was lost of the logs, else 0."""
        return 4 if self.late or any(log.losses for log in self.logs) else 0


def check_quality(logs: Sequence[Path], config: RunConfig, on_message: Callable[[int], None] | None = None) -> QualityReport:
    """Return what each test makes of the pings in one mission's logs; they are read to their end.

    Args:
        logs: Logs, merged by time.
        config: The settings; those of ``[logs]`` and ``[measurements]`` count.
        on_message: Called with each message's time [ns], for progress.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: No ping can be tested.
    """
    settings, readers = config.measurements, open_readers(logs, config)
    merged = merge(readers, config.logs.reorder_window, config.logs.start_ns, config.logs.end_ns)
    topics: dict[str, TopicQuality] = defaultdict(TopicQuality)
    not_used: dict[str, Counter[str]] = defaultdict(Counter)
    state, track = initial_state(config.logs.system), _Track()
    for message in merged:
        state, events = interpret(state, message, settings)
        track.add(message, state)
        _count(events, topics, not_used)
        if on_message is not None:
            on_message(message.time_ns)
    _count(finish(state, settings), topics, not_used)
    if not topics:
        raise MeasurementError(_nothing(logs, not_used))
    time_ns, depth = np.array(track.time_ns, np.int64), np.array(track.depth)
    found = segments(time_ns, depth, settings.surface_depth, settings.quality.leg, settings.quality.gap)
    reports = tuple(reader.report() for reader in readers)
    return QualityReport(reports, settings, dict(sorted(topics.items())), not_used, found, time_ns, depth, sum(merged.late.values()))


@dataclass(slots=True)
class _Track:
    time_ns: list[int] = field(default_factory=list)
    depth: list[float] = field(default_factory=list)

    def add(self, message: Message, state: MeasurementState) -> None:
        """Take in the depth after a message: the vehicle's, or that of the ping's own pressure where a log states nothing else."""
        depth = state.depth
        if not np.isfinite(depth) and message.schema == PING_SCHEMA:
            depth = depth_of_pressure(number(message.payload.get("pressure")), state.latitude)
        # many messages come between two depths
        if np.isfinite(depth) and (not self.depth or depth != self.depth[-1] or message.time_ns - self.time_ns[-1] >= _REPEATED_NS):
            self.time_ns.append(message.time_ns)
            self.depth.append(depth)


def _count(events: Sequence[object], topics: dict[str, TopicQuality], not_used: dict[str, Counter[str]]) -> None:
    """Count the events of a message; a ping's tests come right before its bins."""
    checks: Sequence[Check] = ()
    for event in events:
        if isinstance(event, Used) and event.checks:
            checks = event.checks
        elif isinstance(event, Observation):
            topics[event.source.topic].add(checks, event)
        elif isinstance(event, Skipped) and event.reason != NOT_A_KIND:
            not_used[event.topic][event.reason] += 1


def _nothing(logs: Sequence[Path], not_used: Mapping[str, Counter[str]]) -> str:
    names = ", ".join(map(str, logs))
    why = "; ".join(f"{count} x {topic}: {reason}" for topic, reasons in not_used.items() for reason, count in reasons.items())
    return f"{names}: expected ADCP pings whose bins can be tested, got none; not used: {why or 'nothing that could be a ping'}"
