"""Running replay: messages in, events in order of time into the estimate, and what follows from its steps out.

The stages are functions of frozen states, independent of the clock; what they find goes to the writer. Several vehicles share one
estimate: each has its own messages, checks, counts and plans, and its observations are assimilated in order of time.
"""

from bisect import bisect_right
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from functools import partial
from operator import itemgetter, methodcaller
from typing import Any, Literal

import numpy as np

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.arrays import replace
from replay_kit.core.errors import finding_json
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.message import Message
from replay_kit.core.observation import LinearMeasurement, Profiles, VehicleState
from replay_kit.core.observation.table import LINEAR, PING, Block
from replay_kit.core.words.progress import Stopwatch
from replay_kit.measurements.observed import measure_messages, new_stream
from replay_kit.results.mcap.writer import ResultWriter
from replay_kit.workflows.replay import consistency, plans
from replay_kit.workflows.replay.events import Aside, Events, Item, Track, lightened, ready_items
from replay_kit.workflows.replay.publishing import (
    FlowAt,
    Output,
    depth_slices,
    publish_surface,
    publish_track,
)
from replay_kit.workflows.replay.steps import Dive, Given, Step, assimilate, counts_with
from replay_kit.workflows.replay.surfacings import (
    ForecastState,
    forecast_end,
    forecast_step,
    forecast_track,
)
from replay_kit.workflows.replay.vehicle import Setup, VehicleRun

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
    *("next_slices_ns", "messages", "last_ns", "windows", "withdrawn"),
)


class Run:
    """Running replay, mutable. Without a ``writer`` nothing is published.

    Attributes:
        clock: Wall time of each stage so far.
        writer: Writer of the result; None writes nothing.
        follow_up: Called with each block of steps and their vehicles.
        rebuilt: Called with those of an estimate that is rebuilt without a source, in place of all before.
        current: Estimator's state.
        vehicles: The vehicles, in order of name.
        kept: Observations of several vehicles so far, in order; empty for a single one.
        next_slices_ns: Due time of the next depth slices of each window [ns, UTC].
        messages: Number of processed messages.
        last_ns: Time of the last one [ns, UTC].
        windows: Number of windows left and published.
        withdrawn: Number of these, the first ones, from before a rebuild of the estimate.
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
        self.rebuilt = self.follow_up
        self._measured_by, self._owners = measured_by, owners
        prior, logs = setups[0].estimator.initial(), setups[0].config.logs
        stream, self.current = new_stream(logs.system, logs.component), prior
        self.vehicles = [VehicleRun(setup, stream, Dive(prior)) for setup in setups]
        self._waiting, self._n_waiting, self.kept = list[Given](), 0, list[Given]()
        self.next_slices_ns = dict[Hashable, int | None]()
        self.messages = self.last_ns = self.windows = self.withdrawn = 0

    @property
    def state(self) -> dict[str, Any]:
        """State kept in a checkpoint: what changes with messages, by name."""
        of_run = {name: copy(getattr(self, name)) for name in _STATE}
        return {**of_run, "vehicles": [vehicle.state for vehicle in self.vehicles]}

    @state.setter
    def state(self, state: Mapping[str, Any]) -> None:
        for name in _STATE:
            setattr(self, name, copy(state[name]))
        self.vehicles = [
            VehicleRun(vehicle.setup, **states)
            for vehicle, states in zip(self.vehicles, state["vehicles"], strict=True)
        ]

    @property
    def config(self) -> RunConfig:
        """Settings of the run."""
        return self.vehicles[0].setup.config

    @property
    def is_pooled(self) -> bool:
        """Whether there are several vehicles."""
        return len(self.vehicles) > 1

    # ---- messages in

    def take(self, messages: Sequence[Message]) -> None:
        """Process messages of all vehicles in order of time, with schema ``END`` at the end of a vehicle's logs.

        Raises:
            MeasurementError: Messages are unusable, or contradict each other and ``consistency.on_failure`` is ``stop``.
        """
        at = dict[int, list[int]]()
        for place, message in enumerate(messages):
            at.setdefault(self._owners[message.input] if self._owners else 0, []).append(place)
        measured = dict[int, tuple[Block, list[int]]]()
        # the last passes on what is left
        cuts: list[tuple[int, int, int, consistency.FoundWith]] = [(len(messages), -1, 0, ())]
        for number, places in at.items():
            block, found, due = self._measured(number, [messages[k] for k in places])
            measured[number] = block, [places[k] for k in due]
            cuts += [(places[due[event]], number, event, each) for event, each in found.items()]
        given = dict.fromkeys(measured, 0)
        for place, number, event, told in sorted(cuts, key=itemgetter(0, 1, 2)):
            for other, (block, places) in measured.items():
                end = event if other == number else bisect_right(places, place - 1)
                self.give(other, block, given[other], end)
                given[other] = max(end, given[other])
                vehicle, seen = self.vehicles[other], [messages[k] for k in at[other] if k < place]
                if seen:
                    vehicle.due_ns = seen[0].time_ns if vehicle.due_ns is None else vehicle.due_ns
                    vehicle.ended = vehicle.ended or seen[-1].schema == END
            if told:
                self._act_on(self.vehicles[number], told, messages[place].time_ns)
        self.messages += len(messages)
        if messages:
            self.last_ns = messages[-1].time_ns
        self._release()

    def _measured(
        self, number: int, messages: Sequence[Message]
    ) -> tuple[Block, Mapping[int, consistency.FoundWith], list[int]]:
        """Return the block measured by messages of a vehicle, the findings by event, and the number of each event's message."""
        vehicle = self.vehicles[number]
        read = [message for message in messages if message.schema != END]
        first = vehicle.stream.order
        with self.clock.stage("measure"):
            vehicle.stream, block = measure_messages(
                vehicle.stream, read, self._measured_by, len(read) < len(messages)
            )
        with self.clock.stage("check"):
            vehicle.monitoring, block, found = consistency.checked_block(
                vehicle.monitoring, block, vehicle.setup.config, vehicle.setup.speeds
            )
        counted = counts_with(vehicle.counts.messages, block.counts().items())
        vehicle.counts = replace(vehicle.counts, messages=counted)
        # what waited for the end of the logs comes with it
        return block, found, np.minimum(block.events[:, 0] - first, len(messages) - 1).tolist()

    def give(self, number: int, block: Block, begin: int, end: int) -> None:
        """Process events of a vehicle, from ``begin`` to before ``end`` of a checked block."""
        if end > begin:
            self.vehicles[number].admit(block, block.events[begin:end])

    def _act_on(self, vehicle: VehicleRun, found: consistency.FoundWith, time_ns: int) -> None:
        """Apply findings: rebuild the estimate without a faulty instrument, or open the gate between two sources.

        Raises:
            MeasurementError: The log is unusable, or a contradiction is set to stop the run.
        """
        others = [one.monitoring.left_out for one in self.vehicles if one is not vehicle]
        if any(contradict for _, contradict in found) and not all(others):
            vehicle.monitoring, found = consistency.left_out(vehicle.monitoring, found)
        vehicle.monitoring = consistency.with_findings(
            vehicle.monitoring, found, vehicle.setup.config
        )
        self._release(close=True)
        self._assimilate()
        if any(finding.distrusts for finding, _ in found):
            self._rebuild(vehicle)
        self.current, vehicle.monitoring, vehicle.counts = consistency.readmitted(
            vehicle.estimator, self.current, vehicle.monitoring, vehicle.counts
        )
        every = [*map(finding_json, vehicle.monitoring.findings)]

        def write(writer: ResultWriter) -> None:
            for finding, _ in found:
                writer.log(finding.since_ns, "warning", str(finding))
            writer.consistency(time_ns, every)

        self.write(vehicle, (write,))

    def _rebuild(self, vehicle: VehicleRun) -> None:
        """Rebuild the estimate without the profiles of a vehicle, or without all its observations if excluded.

        With a single vehicle only its DACs remain.
        """
        number, every = self.vehicles.index(vehicle), vehicle.monitoring.left_out
        if self.is_pooled:
            self.kept = [
                (other, event)
                for other, event in self.kept
                if other != number or not (every or isinstance(event, Profiles))
            ]
            kinds = (PING, LINEAR) if every else (PING,)
            vehicle.waiting = vehicle.waiting.without(np.isin(vehicle.waiting.kind, kinds))
            given = self.kept
        else:
            means = vehicle.monitoring.means if vehicle.estimator.supports_path_means else ()
            given = [(number, mean) for mean in means]
        prior = self.vehicles[0].setup.estimator.initial()
        self.current = prior
        for one in self.vehicles:
            one.dive = Dive(prior)
        steps, each = self._stepped(given)
        self.rebuilt(self, steps)
        for one, own_steps in each:
            one.counts = one.counts.rebuilt(own_steps)
            one.monitoring = consistency.with_gated(replace(one.monitoring, gated=()), own_steps)
        self.withdrawn = self.windows

    # ---- events into the estimate

    def _stepped(
        self, given: Sequence[Given]
    ) -> tuple[list[tuple[int, Step]], list[tuple[VehicleRun, list[Step]]]]:
        """Assimilate events, and return the steps in order, and those of each vehicle."""
        with self.clock.stage("estimate"):
            self.current, dives, steps = assimilate(
                [vehicle.estimator for vehicle in self.vehicles],
                self.current,
                [vehicle.dive for vehicle in self.vehicles],
                given,
            )
        each = list[tuple[VehicleRun, list[Step]]]()
        for number, (vehicle, dive) in enumerate(zip(self.vehicles, dives, strict=True)):
            vehicle.dive = dive
            each.append((vehicle, [step for other, step in steps if other == number]))
        return steps, each

    def _release(self, close: bool = False) -> None:
        """Pass on the events that no other can precede any more.

        Args:
            close: Whether to close groups of profiles that others might join.
        """
        for item in self._released(close):
            event, size = item.event, self.vehicles[item.vehicle].setup.estimator.block_size
            self._waiting.append((item.vehicle, event))
            if not isinstance(event, Track | Aside):
                # after values at many places the state has a covariance of its own, tens of megabytes: of a block all states are held
                large = isinstance(event, LinearMeasurement) and not event.at_one_place
                # each block asks all vehicles
                alone = max(size // _MEANS_TOGETHER, 1) if self.is_pooled else size
                self._n_waiting += alone if large else 1
            if self._n_waiting >= size or len(self._waiting) >= _BUFFERED:
                self._assimilate()

    def _released(self, close: bool) -> list[Item]:
        """Return and remove, in order, the items that no event of another vehicle can precede any more."""
        running = [
            (vehicle.due_ns, number)
            for number, vehicle in enumerate(self.vehicles)
            if vehicle.due_ns is not None and not vehicle.ended
        ]
        (until_ns, first), last = min(running, default=(_NEVER, 0)), not running or close
        some, due, found = list[Events](), list[tuple[int, int]](), list[Item]()
        for number, vehicle in enumerate(self.vehicles):
            side: Literal["left", "right"] = "right" if number <= first else "left"
            free = np.searchsorted(vehicle.waiting.due, until_ns, side=side)
            some.append(vehicle.waiting.part(0, int(free)))
            due += [(at, number) for at in some[-1].due.tolist()] if self.is_pooled else []
        due.sort()
        for number, (vehicle, events) in enumerate(zip(self.vehicles, some, strict=True)):
            beside = [one for one in due if one[1] != number]
            ready, n = ready_items(events, vehicle.setup.estimator.grouping, number, beside, last)
            found += ready
            if n:
                vehicle.waiting = vehicle.waiting.part(n, len(vehicle.waiting))
        if self.is_pooled:
            # a group that another vehicle's event ends comes before that
            found.sort(key=lambda one: (one.due_ns, one.closed_by, one.closed_by == one.vehicle))
        return found

    def _assimilate(self) -> None:
        """Assimilate the waiting items, then publish all in the order of the events."""
        given, self._waiting, self._n_waiting = self._waiting, [], 0
        steps, each = self._stepped(given)
        if self.is_pooled:
            self.kept += [
                (number, lightened(event))
                for number, event in given
                if not isinstance(event, Track | Aside)
            ]
        for vehicle, own_steps in each:
            vehicle.counts = vehicle.counts.after(own_steps) if own_steps else vehicle.counts
            vehicle.monitoring = consistency.with_gated(vehicle.monitoring, own_steps)
            if found := [one for step in own_steps if (one := step.innovation) is not None]:
                self.write(vehicle, [methodcaller("innovations", found)])
        self.follow_up(self, steps)
        self.current = self.vehicles[0].estimator.without_left(self.current)
        for vehicle in self.vehicles:
            # of its start, each keeps its own window
            estimator = vehicle.estimator
            start = estimator.own_window(estimator.without_left(vehicle.dive.start))
            vehicle.dive = replace(vehicle.dive, start=start)

    def finish(self) -> None:
        """Pass on all waiting events."""
        self._release(close=True)
        self._assimilate()

    def finished(self) -> "Run":
        """Return a copy for a single vehicle to which all waiting events were passed on; they keep waiting here."""
        found = copy(self)
        found.vehicles = [copy(vehicle) for vehicle in self.vehicles]
        found._waiting = [*self._waiting]
        found.finish()
        return found

    def flow_now(self) -> FlowEstimate:
        """Return the estimate at the time of the last message; without one the prior."""
        if not self.messages:
            return self.vehicles[0].estimator.flow(self.current)
        return self.dated(self.vehicles[0].flow(self.current, self.last_ns))

    def dated(self, flow: FlowEstimate) -> FlowEstimate:
        """Return an estimate with the surface current of radars and the span of its data, which ends at its time."""
        first_ns, flow = self.vehicles[0].first_ns, self.vehicles[0].publishing.surface.added(flow)
        if first_ns is None or flow.time_ns is None:
            return flow
        return replace(flow, span_ns=(first_ns, max(first_ns, flow.time_ns)))

    def write(self, vehicle: VehicleRun, outputs: Iterable[Output]) -> None:
        """Write outputs, if there is a result."""
        if self.writer is not None:
            with self.writing(vehicle) as writer:
                for output in outputs:
                    output(writer)

    @contextmanager
    def writing(self, vehicle: VehicleRun) -> Iterator[ResultWriter]:
        """Yield the writer of a result for what is of a vehicle."""
        assert self.writer is not None
        with self.writer.for_vehicle(vehicle.setup.name), self.clock.stage("write"):
            yield self.writer


# ---- what follows from a step


def follow_up(run: Run, steps: Sequence[tuple[int, Step]]) -> None:
    """Publish a block of steps by vehicle with their consequences, then the last estimates of finished windows."""
    for number, step in steps:
        vehicle, track = run.vehicles[number], step.event
        if not isinstance(track, Track):
            _follow(run, vehicle, step)
        elif not _passed(run, vehicle, step, track):
            for position in track:
                _follow(run, vehicle, replace(step, event=position))
    if run.writer is not None:
        left_windows(run, map(run.dated, run.vehicles[0].estimator.left_flows(run.current)))


def _passed(run: Run, vehicle: VehicleRun, step: Step, track: Track) -> bool:
    """Publish consecutive positions without further consequences, and return whether the step was that."""
    depth = vehicle.setup.config.measurements.surface_depth
    forecasts = forecast_track(vehicle.forecasts, track, depth)
    if vehicle.setup.problem or run.is_pooled or forecasts is None:
        return False
    vehicle.forecasts = forecasts
    _publish(run, vehicle, step, partial(vehicle.flow, step.after))
    return True


def _follow(run: Run, vehicle: VehicleRun, step: Step) -> None:
    """Publish a position or observation with its consequences."""
    before, after = partial(vehicle.flow, step.before), partial(vehicle.flow, step.after)
    depth, event = vehicle.setup.config.measurements.surface_depth, step.event
    used = not isinstance(event, Aside)
    if used:
        _plan(run, vehicle, plans.before_event, event, before)
        _publish(run, vehicle, step, after)
    _expect(
        run, vehicle, forecast_step(vehicle.forecasts, step, before, depth, vehicle.flight.inverted)
    )
    if used:
        _plan(run, vehicle, plans.after_event, event, after)


def _publish(run: Run, vehicle: VehicleRun, step: Step, flow_after: FlowAt) -> None:
    """Publish positions, or the surface current and due depth slices after an observation."""
    if run.writer is None:
        return
    event, settings, now_ns = step.event, vehicle.setup.config.output, step.event.time_ns
    with run.writing(vehicle) as writer:
        if isinstance(event, Track | VehicleState):
            track = event if isinstance(event, Track) else [event]
            vehicle.publishing = publish_track(writer, vehicle.publishing, track, flow_after)
        else:
            vehicle.publishing = publish_surface(writer, vehicle.publishing, step, flow_after)
        # vehicles share the slices of a window
        window = vehicle.estimator.window(step.after) if run.is_pooled else None
        due_ns = run.next_slices_ns.get(window)
        if step.innovation is not None and (due_ns is None or now_ns >= due_ns):
            run.next_slices_ns[window] = now_ns + int(settings.interval * 1e9)
            depth_slices(now_ns, flow_after(now_ns), settings)(writer)


def _plan(
    run: Run,
    vehicle: VehicleRun,
    stage: Callable[..., tuple[plans.PlanningState, tuple[Output, ...]]],
    *arguments: Any,
) -> None:
    """Run one step of the planning stage, if there is a goal."""
    if (problem := vehicle.problem) is not None:
        with run.clock.stage("plan"):
            vehicle.planning, outputs = stage(problem, vehicle.planning, *arguments)
        run.write(vehicle, outputs)


def _expect(run: Run, vehicle: VehicleRun, forecasts: ForecastState) -> None:
    """Store the state of the surfacing forecasts, and write the outcomes that are new."""
    fresh, vehicle.forecasts = forecasts.outcomes[len(vehicle.forecasts.outcomes) :], forecasts
    run.write(vehicle, (methodcaller("dive_outcome", one) for one in fresh))


def left_windows(run: Run, flows: Iterable[FlowEstimate]) -> list[int]:
    """Publish the last estimates of windows; return their numbers."""
    numbers = list[int]()
    for flow in flows:
        run.windows += 1
        run.write(run.vehicles[0], [methodcaller("window", run.windows, flow)])
        numbers.append(run.windows)
    return numbers


def finish_vehicle(run: Run, vehicle: VehicleRun) -> FlowEstimate:
    """Finish a surfacing of a vehicle and plan from its last position, of several at its own time; return the estimate used."""
    _expect(run, vehicle, forecast_end(vehicle.forecasts))
    flow, at = vehicle.flow(run.current, run.last_ns), vehicle.planning.position
    begin_ns = at.time_ns if run.is_pooled and at is not None else run.last_ns
    _plan(run, vehicle, plans.plan_at_end, partial(vehicle.flow, run.current), flow, begin_ns)
    return flow
