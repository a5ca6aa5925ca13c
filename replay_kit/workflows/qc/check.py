"""Quality control of a mission's logs: the results of each test, and the pings that lose every bin."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.block import BinTest, Block
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import LogReport, Message
from replay_kit.core.observation import Flag, Reason, usable
from replay_kit.logs import merge
from replay_kit.logs.tables.schemas import NOT_A_KIND
from replay_kit.measurements.observed import begun, blocks
from replay_kit.workflows.info.inspect import by_topic
from replay_kit.workflows.replay.inputs.scan import open_readers

_NO_NUMBER = "no number in the bin"
_NO_PINGS = np.empty(0, np.int64)
Present = NDArray[np.bool_]


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

    def extended(self, test: BinTest, rows: NDArray[np.intp], present: Present) -> "TestCount":
        """Return the count with the bins of some pings added.

        Args:
            test: The test's results for all pings of a block.
            rows: Numbers of the pings among them.
            present: Which of their bins have a velocity, shape (n, m).
        """
        flags = test.flags[rows]
        number = {flag: int(np.sum((flags == flag) & present)) for flag in Flag}
        skipped = np.sum((flags == Flag.NOT_EVALUATED) & present, axis=1)
        why = Counter(self.not_evaluated)
        for k in np.flatnonzero(skipped):
            why[test.why_not[rows[k]] or _NO_NUMBER] += int(skipped[k])
        return TestCount(
            self.reason,
            self.evaluated + int(present.sum() - skipped.sum()),
            self.suspect + number[Flag.SUSPECT],
            self.failed + number[Flag.FAIL],
            dict(why),
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

    def extended(self, block: Block, rows: NDArray[np.intp]) -> "TopicQuality":
        """Return the counts with some pings of a block added."""
        columns = block.ping
        flags = columns["flags"][rows]
        real = np.arange(flags.shape[1]) < columns["bins"][rows, None]
        tests = dict(self.tests)
        for test in block.tests:
            made = np.array([why is not None for why in test.why_not[rows]])
            if made.any():
                known = tests.get(test.name, TestCount(test.reason))
                present = flags[made] != Flag.MISSING
                tests[test.name] = known.extended(test, rows[made], present)
        unused = ~usable(flags).any(axis=1)
        lost = [
            LostPing(
                int(columns["time"][k]),
                int(columns["input"][k]),
                int(columns["ordinal"][k]),
                Reason(int(np.bitwise_or.reduce(columns["reasons"][k]))),
            )
            for k in rows[unused]
        ]
        return TopicQuality(
            self.pings + rows.size,
            Counter(self.flags) + Counter(flags[real].tolist()),
            tests,
            (*self.lost, *lost),
        )


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
    not_used: Counter[tuple[str, str]] = Counter()
    stream = begun(config.logs.system, config.logs.component)
    for block in blocks(_told(merged, on_message), settings, stream=stream):
        for number in np.unique(block.ping.get("topic", _NO_PINGS)).tolist():
            rows = np.flatnonzero(block.ping["topic"] == number)
            topic = block.topics[number]
            topics[topic] = topics.get(topic, TopicQuality()).extended(block, rows)
        said = block.counts().items()
        not_used.update({key: n for key, n in said if key[1] not in ("", NOT_A_KIND)})
    if not topics:
        raise MeasurementError(
            _nothing(logs, [reader.report() for reader in readers], by_topic(not_used))
        )
    quality = {topic: topics[topic] for topic in sorted(topics)}
    reports = tuple(reader.report() for reader in readers)
    return QualityReport(
        reports,
        settings,
        quality,
        by_topic(not_used),
        sum(merged.late.values()),
    )


def _told(
    messages: Iterable[Message], on_message: Callable[[int], None] | None
) -> Iterator[Message]:
    """Yield messages, each after its time was told."""
    for message in messages:
        if on_message is not None:
            on_message(message.time_ns)
        yield message


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
