"""Running replay: messages in, events in order of time into the estimate, steps out.

The stages are functions of frozen states, independent of writer and clock; their outputs go to the writer. Several vehicles share one
estimate: each has its own messages, checks, counts and plans, and its observations are assimilated in order of time.
"""

from bisect import bisect_right
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from copy import copy
from operator import itemgetter
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.arrays import replace
from replay_kit.core.errors import Finding, finding_json
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.message import Message
from replay_kit.core.observation import LinearMeasurement, Profiles
from replay_kit.core.observation.block import LINEAR, PING, Block
from replay_kit.core.words.progress import Stopwatch
from replay_kit.estimator import Estimator
from replay_kit.measurements.observed import begun, taken
from replay_kit.results.mcap.writer import ResultWriter
from replay_kit.workflows.replay.events import Aside, Event, Item, Track, items
from replay_kit.workflows.replay.stages import consistency
from replay_kit.workflows.replay.stages.consistency import FoundWith
from replay_kit.workflows.replay.stages.estimation import (
    Dive,
    Given,
    Step,
    assimilate,
    kept,
)
from replay_kit.workflows.replay.stages.publishing import (
    Output,
    publish_innovations,
    withdraw_windows,
)
from replay_kit.workflows.replay.vehicle import OfVehicle, Setup

#: Schema of what stands in the stream where the logs of a vehicle end.
END = "replay_kit.EndOfLogs"
# Positions that wait at most: a log may hold nothing else.
_BUFFERED = 4096
# Mean currents of several vehicles that are assimilated together, where the estimator takes blocks.
_MEANS_TOGETHER = 8
# After every time [ns, UTC].
_NEVER = 2**63 - 1
# What of a run changes with its messages.
_STATE = (
    *("current", "_waiting", "_n_waiting", "kept"),
    *("next_slices_ns", "messages", "last_ns"),
)


class Run:
    """Running replay, mutable. Without a ``writer`` nothing is published.

    Attributes:
        clock: Wall time of each stage so far.
        writer: Writer of the result; None writes nothing.
        follow_up: Called with each block of steps and their vehicles.
        current: Estimator's state.
        of: The vehicles, in order of name.
        kept: Observations of several vehicles so far, in order; empty for a single one.
        next_slices_ns: Due time of the next depth slices of each window [ns, UTC].
        messages: Number of processed messages.
        last_ns: Time of the last one [ns, UTC].
    """

    def __init__(
        self,
        setups: Sequence[Setup],
        measured_by: MeasurementConfig,
        clock: Stopwatch,
        owners: Sequence[int] = (),
    ) -> None:
        """Begin with the prior.

        Args:
            setups: Setup of each vehicle.
            measured_by: Settings of observations.
            clock: Measures the time of stages.
            owners: Number of the vehicle of each log; empty for a single vehicle.
        """
        self.clock = clock
        self.writer: ResultWriter | None = None
        self.follow_up: Callable[[Run, Sequence[tuple[int, Step]]], None] = lambda run, steps: None
        self._measured_by, self._owners = measured_by, owners
        prior, logs = setups[0].estimator.initial(), setups[0].config.logs
        stream, self.current = begun(logs.system, logs.component), prior
        self.of = [OfVehicle(setup, stream, Dive(prior)) for setup in setups]
        self._waiting, self._n_waiting, self.kept = list[Given](), 0, list[Given]()
        self.next_slices_ns = dict[Hashable, int | None]()
        self.messages = self.last_ns = 0

    @property
    def state(self) -> dict[str, Any]:
        """State kept in a checkpoint: what changes with messages, by name."""
        of_run = {name: copy(getattr(self, name)) for name in _STATE}
        return {**of_run, "of": [of.state for of in self.of]}

    @state.setter
    def state(self, state: Mapping[str, Any]) -> None:
        for name in _STATE:
            setattr(self, name, copy(state[name]))
        self.of = [OfVehicle(of.setup, **own) for of, own in zip(self.of, state["of"], strict=True)]

    @property
    def config(self) -> RunConfig:
        """Settings of the run."""
        return self.of[0].setup.config

    @property
    def is_pooled(self) -> bool:
        """Whether there are several vehicles."""
        return len(self.of) > 1

    @property
    def _estimators(self) -> list[Estimator[Any]]:
        return [of.estimator for of in self.of]

    # ---- messages in

    def take(self, messages: Sequence[Message]) -> None:
        """Process messages of all vehicles in order of time, with schema ``END`` at the end of a vehicle's logs.

        Raises:
            MeasurementError: Messages are unusable, or contradict each other and ``consistency.on_failure`` is ``stop``.
        """
        at = dict[int, list[int]]()
        for place, message in enumerate(messages):
            at.setdefault(self._owners[message.input] if self._owners else 0, []).append(place)
        measured = dict[int, tuple[Block, Sequence[int]]]()
        cuts = list[tuple[int, int, int, FoundWith]]()
        for number, places in at.items():
            own = [messages[place] for place in places]
            block, found, places_of = self._measured(number, own, places)
            measured[number] = block, places_of
            cuts += [(places_of[event], number, event, each) for event, each in found.items()]
        given = dict.fromkeys(measured, 0)
        for place, number, event, told in sorted(cuts, key=itemgetter(0, 1, 2)):
            for other, (block, places_of) in measured.items():
                end = event if other == number else bisect_right(places_of, place - 1)
                self.give(other, block, given[other], end)
                given[other] = max(end, given[other])
                self._reach(other, [messages[k] for k in at[other] if k < place])
            self._act_on(self.of[number], told, messages[place].time_ns)
        for number, (block, _) in measured.items():
            self.give(number, block, given[number], len(block.events))
            self._reach(number, [messages[k] for k in at[number]])
        self.messages += len(messages)
        if messages:
            self.last_ns = messages[-1].time_ns
        self._release()

    def _reach(self, number: int, messages: Sequence[Message]) -> None:
        """Mark a vehicle as begun with the first of some messages, until when others need not wait for it, or as ended."""
        if messages:
            of = self.of[number]
            of.due_ns = messages[0].time_ns if of.due_ns is None else of.due_ns
            of.ended = of.ended or messages[-1].schema == END

    def _measured(
        self, number: int, own: Sequence[Message], places: Sequence[int]
    ) -> tuple[Block, Mapping[int, FoundWith], Sequence[int]]:
        """Return the block measured by messages of a vehicle, the findings by event, and the position of each event's message."""
        of, read = self.of[number], [message for message in own if message.schema != END]
        first = of.stream.order
        with self.clock.stage("measure"):
            of.stream, block = taken(of.stream, read, self._measured_by, len(read) < len(own))
        with self.clock.stage("check"):
            of.monitoring, block, found = consistency.checked(
                of.monitoring, block, of.setup.config, of.setup.speeds
            )
        of.counts = of.counts.after_messages(block.counts())
        # what waited for the end of the logs comes with it
        due = np.minimum(block.events[:, 0] - first, len(places) - 1)
        return block, found, [places[k] for k in due.tolist()]

    def give(self, number: int, block: Block, begin: int, end: int) -> None:
        """Process events of a vehicle, from ``begin`` to before ``end`` of a checked block."""
        if end > begin:
            self.of[number].admit(block, block.events[begin:end])

    def _act_on(self, of: OfVehicle, found: FoundWith, time_ns: int) -> None:
        """Apply findings: rebuild the estimate without a faulty instrument, or open the gate between two sources.

        Raises:
            MeasurementError: The log is unusable, or a contradiction is set to stop the run.
        """
        others, monitoring = [one for one in self.of if one is not of], of.monitoring
        if any(contradict for _, contradict in found) and not all(
            one.monitoring.left_out for one in others
        ):
            monitoring, found = consistency.left_out(monitoring, found)
        of.monitoring = consistency.noted(monitoring, found, of.setup.config)
        named = [finding for finding, _ in found]
        self._release(close=True)
        self._assimilate()
        if any(finding.distrusts for finding in named):
            self._rebuild(of)
        self.current, of.monitoring, of.counts = consistency.readmitted(
            of.estimator, self.current, of.monitoring, of.counts
        )
        self.write(of, map(_warning, named))
        every = [*map(finding_json, of.monitoring.findings)]
        self.write(of, (lambda writer: writer.consistency(time_ns, every),))

    def _rebuild(self, of: OfVehicle) -> None:
        """Rebuild the estimate without the profiles of a vehicle, or without all its observations if excluded.

        With a single vehicle only its DACs remain.
        """
        number = self.of.index(of)
        given: list[Given] = [(number, mean) for mean in of.monitoring.means]
        if self.is_pooled:
            every = of.monitoring.left_out
            self.kept = [
                one
                for one in self.kept
                if one[0] != number or not (every or isinstance(one[1], Profiles))
            ]
            unused = of.waiting.kind == PING
            if every:
                unused |= of.waiting.kind == LINEAR
            of.waiting = of.waiting.without(unused)
            given = self.kept
        elif not of.estimator.supports_path_means:
            given = []
        prior = self.of[0].setup.estimator.initial()
        with self.clock.stage("estimate"):
            self.current, dives, steps = assimilate(
                self._estimators, prior, [Dive(prior)] * len(self.of), given
            )
        for other, (one, dive) in enumerate(zip(self.of, dives, strict=True)):
            own = [step for of_step, step in steps if of_step == other]
            one.dive, one.counts = dive, one.counts.rebuilt(own)
            fresh = replace(one.monitoring, gated=(), decisions={})
            one.monitoring = consistency.with_gated(fresh, own)
        self.of[0].publishing = withdraw_windows(self.of[0].publishing)

    # ---- events into the estimate

    def _weight(self, number: int, event: Event) -> int:
        """Return the number of observations that an event counts for in a block."""
        if isinstance(event, Track | Aside):
            return 0
        size = self.of[number].setup.estimator.block_size
        # after values at many places the state has a covariance of its own, tens of megabytes: of a block all states are held
        large = isinstance(event, LinearMeasurement) and not event.at_one_place
        # each block asks all vehicles
        return (max(size // _MEANS_TOGETHER, 1) if self.is_pooled else size) if large else 1

    def _release(self, close: bool = False) -> None:
        """Pass on the events that no other can precede any more.

        Args:
            close: Whether to close groups of profiles that others might join.
        """
        for item in self._released(close):
            self._waiting.append((item.vehicle, item.event))
            self._n_waiting += self._weight(item.vehicle, item.event)
            size = self.of[item.vehicle].setup.estimator.block_size
            if self._n_waiting >= size or len(self._waiting) >= _BUFFERED:
                self._assimilate()

    def _released(self, close: bool) -> list[Item]:
        """Return and remove, in order, the items that no event of another vehicle can precede any more."""
        running = [
            (of.due_ns, number)
            for number, of in enumerate(self.of)
            if of.due_ns is not None and not of.ended
        ]
        (until_ns, first), last = min(running, default=(_NEVER, 0)), not running or close
        free = [
            np.searchsorted(of.waiting.due, until_ns, side="right" if number <= first else "left")
            for number, of in enumerate(self.of)
        ]
        some = [of.waiting.part(0, int(n)) for of, n in zip(self.of, free, strict=True)]
        due = [(at, number) for number, one in enumerate(some) for at in one.due.tolist()]
        due = sorted(due) if self.is_pooled else []
        found = list[Item]()
        for number, (of, events) in enumerate(zip(self.of, some, strict=True)):
            beside = [one for one in due if one[1] != number]
            of_vehicle, n = items(events, of.setup.estimator.grouping, number, beside, last)
            found += of_vehicle
            if n:
                of.waiting = of.waiting.part(n, len(of.waiting))
        if self.is_pooled:
            # a group that another vehicle's event ends comes before that
            found.sort(key=lambda one: (one.due_ns, one.of, one.of == one.vehicle))
        return found

    def _assimilate(self) -> None:
        """Assimilate the waiting items, then publish all in the order of the events."""
        given, self._waiting, self._n_waiting = self._waiting, [], 0
        with self.clock.stage("estimate"):
            self.current, dives, steps = assimilate(
                self._estimators, self.current, [of.dive for of in self.of], given
            )
        if self.is_pooled:
            self.kept += [
                (number, _light(event))
                for number, event in given
                if not isinstance(event, Track | Aside)
            ]
        for number, (of, dive) in enumerate(zip(self.of, dives, strict=True)):
            own = [step for other, step in steps if other == number]
            of.dive, of.counts = dive, of.counts.after(own) if own else of.counts
            of.monitoring = consistency.with_gated(of.monitoring, own)
            self.write(of, publish_innovations(own))
        self.follow_up(self, steps)
        self.current = self.of[0].estimator.without_left(self.current)
        for of in self.of:
            of.dive = kept(of.estimator, of.dive)

    def finish(self) -> None:
        """Pass on all waiting events."""
        self._release(close=True)
        self._assimilate()

    def finished(self) -> "Run":
        """Return a copy for a single vehicle to which all waiting events were passed on; they keep waiting here."""
        found = copy(self)
        found.of, found._waiting = [copy(of) for of in self.of], [*self._waiting]
        found.finish()
        return found

    def flow_now(self) -> FlowEstimate:
        """Return the estimate at the time of the last message; without one the prior."""
        if not self.messages:
            return self.of[0].estimator.flow(self.current)
        return self.dated(self.of[0].flow(self.current, self.last_ns))

    def dated(self, flow: FlowEstimate) -> FlowEstimate:
        """Return an estimate with the surface current of radars and the span of its data, which ends at its time."""
        first_ns, flow = self.of[0].first_ns, self.of[0].publishing.surface.added(flow)
        if first_ns is None or flow.time_ns is None:
            return flow
        return replace(flow, span_ns=(first_ns, max(first_ns, flow.time_ns)))

    def write(self, of: OfVehicle, outputs: Iterable[Output]) -> None:
        """Write outputs, if there is a result."""
        if self.writer is not None:
            with self.writer.of(of.setup.name), self.clock.stage("write"):
                for output in outputs:
                    output(self.writer)


def _light(event: Event) -> Event:
    """Return an observation without data needed only by its checks or a result, detached from its block."""
    if isinstance(event, LinearMeasurement):
        return replace(event, label=replace(event.label, vectors=None))
    if isinstance(event, Profiles):
        columns = {name: column.copy() for name, column in event.columns.items()}
        return Profiles(columns, event.topics)
    return event


def _warning(finding: Finding) -> Output:
    return lambda writer: writer.log(finding.since_ns, "warning", str(finding))
