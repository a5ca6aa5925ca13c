"""Quality control of a mission's logs: the results of each test, and the pings that lose every bin."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import LogReport
from replay_kit.core.observation import Flag, Observation, Reason, usable
from replay_kit.logs import merge
from replay_kit.measurements.events import NOT_A_KIND, Skipped, Used
from replay_kit.measurements.interpret import finish, initial_state, interpret
from replay_kit.measurements.quality.qartod import Check
from replay_kit.workflows.info.inspect import by_topic
from replay_kit.workflows.replay.inputs.scan import open_readers

_NO_NUMBER = "no number in the bin"


@dataclass(frozen=True, slots=True)
class TestCount:
    """Results of one test over all bins of a topic that have a velocity.

    Attributes:
        reason: The reason that the test gives to bins.
        evaluated: Number of bins tested.
        suspect: Of these, suspect ones.
        failed: Of these, failed ones.
        not_evaluated: Reason to number of the others.
    """

    reason: Reason
    evaluated: int = 0
    suspect: int = 0
    failed: int = 0
    not_evaluated: Mapping[str, int] = field(default_factory=dict)

    def extended(self, check: Check, present: NDArray[np.bool_]) -> "TestCount":
        """Return the count with a ping's bins added.

        Args:
            check: The test's result for the ping.
            present: Which bins have a velocity, shape (n,).
        """
        flags = Counter(check.flags[present].tolist())
        skipped = flags[Flag.NOT_EVALUATED]
        why = check.why_not or _NO_NUMBER
        return TestCount(
            self.reason,
            self.evaluated + flags.total() - skipped,
            self.suspect + flags[Flag.SUSPECT],
            self.failed + flags[Flag.FAIL],
            {**self.not_evaluated, why: self.not_evaluated.get(why, 0) + skipped}
            if skipped
            else self.not_evaluated,
        )


class LostPing(NamedTuple):
    """A ping without a usable bin: its time [ns, UTC], log, position in the log, and the reasons of its bins."""

    time_ns: int
    input: int
    position: int
    reasons: Reason


@dataclass(frozen=True, slots=True)
class TopicQuality:
    """One topic's pings.

    Attributes:
        pings: Number of pings tested.
        flags: QARTOD flag to number of bins, after all tests.
        tests: By name, in the order in which they are made.
        lost: Pings without a usable bin.
    """

    pings: int = 0
    flags: Mapping[int, int] = field(default_factory=Counter)
    tests: Mapping[str, TestCount] = field(default_factory=dict)
    lost: Sequence[LostPing] = ()

    def extended(self, checks: Sequence[Check], observation: Observation) -> "TopicQuality":
        """Return the counts with a ping added, save that ``lost`` stays."""
        present = observation.flags != Flag.MISSING
        tests = {
            check.test: self.tests.get(check.test, TestCount(check.reason)).extended(check, present)
            for check in checks
        }
        flags = Counter(self.flags) + Counter(observation.flags.tolist())
        return replace(self, pings=self.pings + 1, flags=flags, tests={**self.tests, **tests})


@dataclass(frozen=True, slots=True, eq=False)
class QualityReport:
    """The quality control of some logs.

    Attributes:
        logs: What the readers found.
        settings: The thresholds.
        topics: By name.
        not_used: Topic to reason to count, of messages that give no profile.
        late: Number of messages left out because they came later than the reorder window allows.
    """

    logs: tuple[LogReport, ...]
    settings: MeasurementConfig
    topics: Mapping[str, TopicQuality]
    not_used: Mapping[str, Mapping[str, int]]
    late: int

    @property
    def exit_code(self) -> int:
        """4 when something was lost of the logs, else 0."""
        return 4 if self.late or any(log.losses for log in self.logs) else 0


def check_quality(
    logs: Sequence[Path], config: RunConfig, on_message: Callable[[int], None] | None = None
) -> QualityReport:
    """Return the results of each test on the pings of one mission's logs, which are read to their end.

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
    topics: dict[str, TopicQuality] = {}
    lost: dict[str, list[LostPing]] = defaultdict(list)
    not_used: Counter[tuple[str, str]] = Counter()
    state = initial_state(config.logs.system, config.logs.component)

    def count(events: Sequence[object]) -> None:
        for checks, observation in _tested(events):
            topic = observation.source.topic
            topics[topic] = topics.get(topic, TopicQuality()).extended(checks, observation)
            lost[topic] += _lost(observation)
        not_used.update(
            (e.topic, e.reason) for e in events if isinstance(e, Skipped) and e.reason != NOT_A_KIND
        )

    for message in merged:
        state, events = interpret(state, message, settings)
        count(events)
        if on_message is not None:
            on_message(message.time_ns)
    count(finish(state, settings))
    if not topics:
        raise MeasurementError(
            _nothing(logs, [reader.report() for reader in readers], by_topic(not_used))
        )
    quality = {topic: replace(topics[topic], lost=tuple(lost[topic])) for topic in sorted(topics)}
    reports = tuple(reader.report() for reader in readers)
    return QualityReport(
        reports,
        settings,
        quality,
        by_topic(not_used),
        sum(merged.late.values()),
    )


def _tested(events: Sequence[object]) -> Iterator[tuple[Sequence[Check], Observation]]:
    """Yield the profiles among the events of a message with their tests, which come right before the profile."""
    checks: Sequence[Check] = ()
    for event in events:
        if isinstance(event, Used) and event.tests:
            checks = event.checks
        elif isinstance(event, Observation):
            yield checks, event


def _lost(observation: Observation) -> list[LostPing]:
    """Return the ping when it has no usable bin, else nothing."""
    if usable(observation.flags).any():
        return []
    source = observation.source
    return [
        LostPing(
            source.time_ns,
            source.input,
            source.position,
            Reason(int(np.bitwise_or.reduce(observation.reasons))),
        )
    ]


def _nothing(
    logs: Sequence[Path], reports: Sequence[LogReport], not_used: Mapping[str, Mapping[str, int]]
) -> str:
    names = ", ".join(map(str, logs))
    if any("/dac" in report.read for report in reports):
        return f"{names}: expected ADCP pings whose bins can be tested, got mean currents alone, which a replay uses as they are"
    why = "; ".join(
        f"{count} x {topic}: {reason}"
        for topic, reasons in not_used.items()
        for reason, count in reasons.items()
    )
    return f"{names}: expected ADCP pings whose bins can be tested, got none; not used: {why or 'nothing that could be a ping'}"
