"""The estimate that all vehicles of a replay give their measurements to: their events in order of time, assimilated in blocks.

Each vehicle's events come in the order of its log, but not when they happened: those of a dive come when it has surfaced. So an event
waits until every vehicle that goes on has a later one; of equal times that of the first vehicle comes first. With one vehicle none waits.
"""

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from itertools import groupby
from operator import itemgetter
from typing import Any, Protocol

from replay_kit.core.arrays import replace
from replay_kit.core.observation import (
    LinearMeasurement,
    Measurement,
    Observation,
    PathMean,
    VehicleState,
)
from replay_kit.core.progress import Stopwatch
from replay_kit.estimator import Estimator
from replay_kit.workflows.replay.stages.consistency import MonitoringState
from replay_kit.workflows.replay.stages.estimation import (
    Contributor,
    EstimationState,
    Step,
    assimilate_together,
    state_after,
)
from replay_kit.workflows.replay.stages.publishing import PublishingState

#: Events that wait at most: a log may hold positions and nothing else.
BUFFERED = 4096
# Mean currents of several vehicles that are assimilated together, where the estimator takes blocks.
_MEANS_TOGETHER = 8

Input = VehicleState | Measurement


class Vehicle(Protocol):
    """What gives events, and goes on with the steps that are made of them."""

    estimator: Estimator[Any]
    estimation: EstimationState
    publishing: PublishingState
    monitoring: MonitoringState

    def after_steps(self, steps: Sequence[Step]) -> None:
        """Count the steps of a block."""
        ...

    def count_again(self, steps: Sequence[Step]) -> None:
        """Count the steps of an estimate that was rebuilt."""
        ...

    def follow_up(self, steps: Sequence[Step]) -> None:
        """Publish steps, and what follows from them."""
        ...

    def after_block(self) -> None:
        """Publish what the estimate has left behind."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Queued:
    """What waits, and what was given.

    Attributes:
        queues: Of each vehicle, events with the time at which they are due [ns, UTC].
        due_ns: Of each vehicle, when its last event was due; None before its first message.
        ended: Of each vehicle, whether its logs have ended.
        kept: Measurements so far in their order, with their vehicles; none with one vehicle.
        next_slices_ns: Of each window, when its next depth slices are due [ns, UTC].
        waiting: Events of the block that is not complete, with their vehicles.
    """

    queues: tuple[tuple[tuple[int, Input], ...], ...]
    due_ns: tuple[int | None, ...]
    ended: tuple[bool, ...]
    kept: tuple[tuple[int, Measurement], ...]
    next_slices_ns: Mapping[Hashable, int | None]
    waiting: tuple[tuple[int, Input], ...]


class SharedEstimate:
    """Events on their way into one estimate: mutable, as they go through it.

    Attributes:
        vehicles: In the order of their names.
        clock: Wall time of each stage so far.
        kept: As in ``Queued``.
        next_slices_ns: As in ``Queued``.
    """

    def __init__(self, clock: Stopwatch) -> None:
        """Begin without a vehicle; the clock counts the time of the estimate."""
        self.vehicles: list[Vehicle] = []
        self.kept: list[tuple[int, Measurement]] = []
        self.next_slices_ns: dict[Hashable, int | None] = {}
        self.clock = clock
        # events that wait, first the one that is due first: when, vehicle, number of the event
        self._queue: list[tuple[int, int, int, Input]] = []
        self._n_given = 0
        self._n_queued: list[int] = []
        # vehicles that go on and have no event that waits, which the others wait for
        self._awaited: set[int] = set()
        self._due_ns: list[int | None] = []
        self._ended: list[bool] = []
        self._buffer: list[tuple[int, Input]] = []
        self._n_observations = 0

    def add(self, vehicle: Vehicle) -> int:
        """Take up a vehicle, and return its number."""
        self.vehicles.append(vehicle)
        self._n_queued.append(0)
        self._due_ns.append(None)
        self._ended.append(False)
        return len(self.vehicles) - 1

    @property
    def is_pooled(self) -> bool:
        """Whether there are several vehicles."""
        return len(self.vehicles) > 1

    @property
    def queued(self) -> Queued:
        """What a checkpoint keeps."""
        each: list[list[tuple[int, Input]]] = [[] for _ in self.vehicles]
        for due_ns, number, _, event in sorted(self._queue):
            each[number].append((due_ns, event))
        return Queued(
            tuple(map(tuple, each)),
            tuple(self._due_ns),
            tuple(self._ended),
            tuple(self.kept),
            dict(self.next_slices_ns),
            tuple(self._buffer),
        )

    def restore(self, queued: Queued) -> None:
        """Go on from a checkpoint."""
        self._due_ns, self._ended = list(queued.due_ns), list(queued.ended)
        self.kept, self.next_slices_ns = list(queued.kept), dict(queued.next_slices_ns)
        self._queue, self._n_queued = [], list(map(len, queued.queues))
        for number, event in queued.waiting:
            self._take(number, event)
        for number, queue in enumerate(queued.queues):
            for due_ns, event in queue:
                self._push(due_ns, number, event)
            self._await(number)

    def _await(self, number: int) -> None:
        """Note whether the others wait for a vehicle."""
        begun = self._due_ns[number] is not None
        waits = begun and not (self._ended[number] or self._n_queued[number])
        change = self._awaited.add if waits else self._awaited.discard
        change(number)

    def _push(self, due_ns: int, number: int, event: Input) -> None:
        self._n_given += 1
        heappush(self._queue, (due_ns, number, self._n_given, event))

    def begin(self, number: int, time_ns: int) -> None:
        """Take note of a vehicle's first message [ns, UTC], before which the others need not wait for it."""
        if self._due_ns[number] is None:
            self._due_ns[number] = time_ns
            self._await(number)

    def give(self, number: int, event: Input) -> None:
        """Take the next event of a vehicle's log."""
        if not self.is_pooled:
            self._take(number, event)
            return
        due_ns = max(self._due_ns[number] or event.time_ns, event.time_ns)
        self._due_ns[number] = due_ns
        self._push(due_ns, number, event)
        self._n_queued[number] += 1
        self._await(number)
        self._release()

    def end(self, number: int) -> None:
        """Take note that a vehicle's logs have ended."""
        self._ended[number] = True
        self._await(number)
        self._release()

    def _release(self) -> None:
        """Take the events that no other can precede any more."""
        while self._queue and not self._awaited:
            _, number, _, event = heappop(self._queue)
            self._n_queued[number] -= 1
            self._await(number)
            self._take(number, event)

    def _take(self, number: int, event: Input) -> None:
        """Put an event into the block, and assimilate it when it is complete."""
        self._buffer.append((number, event))
        block = self.vehicles[number].estimator.block_size
        # after values at many places the state has a covariance of its own, tens of megabytes: of a block all states are held
        large = isinstance(event, LinearMeasurement) and not event.at_one_place
        # each block asks all vehicles
        whole = max(block // _MEANS_TOGETHER, 1) if self.is_pooled else block
        self._n_observations += whole if large else isinstance(event, Measurement)
        if self._n_observations >= block or len(self._buffer) == BUFFERED:
            self.assimilate()

    def assimilate(self, last: bool = False) -> None:
        """Assimilate the observations that wait, then let their vehicles publish everything in the order of the events.

        Args:
            last: Whether profiles that others might join wait no longer.
        """
        with self.clock.stage("estimate"):
            states, steps = assimilate_together(self._contributors(), self._buffer, last)
        if self.is_pooled:
            self.kept += [
                (number, _light(event))
                for number, event in self._buffer
                if isinstance(event, Measurement)
            ]
        self._buffer, self._n_observations = [], 0
        by_vehicle: dict[int, list[Step]] = {}
        for number, step in steps:
            by_vehicle.setdefault(number, []).append(step)
        for number, (vehicle, state) in enumerate(zip(self.vehicles, states, strict=True)):
            vehicle.estimation = state
            if number in by_vehicle:
                vehicle.after_steps(by_vehicle[number])
        for number, of_vehicle in groupby(steps, key=itemgetter(0)):
            self.vehicles[number].follow_up([step for _, step in of_vehicle])
        self.vehicles[0].after_block()

    def spread(self, current: Any) -> None:
        """Make a state of the estimator that of all vehicles."""
        for vehicle in self.vehicles:
            vehicle.estimation = replace(vehicle.estimation, current=current)

    def has_others(self, number: int) -> bool:
        """Return whether another vehicle than one measures what is used."""
        return any(
            not vehicle.monitoring.left_out
            for other, vehicle in enumerate(self.vehicles)
            if other != number
        )

    def rebuild(self, number: int, means: Sequence[PathMean]) -> None:
        """Make the estimate again without the profiles of a vehicle, or without all that it measured if it is left out.

        Args:
            number: Of the vehicle.
            means: Its mean currents so far.
        """
        # with one vehicle its mean currents are all there is
        kept: Iterable[tuple[int, Measurement]] = ((number, mean) for mean in means)
        if self.is_pooled:
            unused = Measurement if self.vehicles[number].monitoring.left_out else Observation
            self.kept = [
                one for one in self.kept if one[0] != number or not isinstance(one[1], unused)
            ]
            self._queue = [
                one for one in self._queue if one[1] != number or not isinstance(one[3], unused)
            ]
            heapify(self._queue)
            self._n_queued[number] = sum(one[1] == number for one in self._queue)
            self._await(number)
            kept = self.kept
        with self.clock.stage("estimate"):
            states, steps = assimilate_together(self._contributors(begun=True), list(kept))
        for other, (vehicle, state) in enumerate(zip(self.vehicles, states, strict=True)):
            vehicle.estimation = state
            vehicle.count_again([step for of, step in steps if of == other])

    def without(self, number: int) -> Any:
        """Return the state of the estimator that all measurements but those of a vehicle lead to, in the same windows."""
        begun = self._contributors(begun=True)
        windowed = begun[0].estimator.window(begun[0].state.current) is not None
        kept = [one for one in self.kept if windowed or one[0] != number]
        size = max(self.vehicles[0].estimator.block_size, 1)
        return state_after(begun, kept, size, number)

    def _contributors(self, begun: bool = False) -> list[Contributor]:
        """Return the vehicles with their states, or with the prior."""
        return [
            Contributor(
                vehicle.estimator,
                EstimationState(*[vehicle.estimator.initial()] * 2)
                if begun
                else vehicle.estimation,
            )
            for vehicle in self.vehicles
        ]


def _light(event: Measurement) -> Measurement:
    """Return a measurement without what only its checks, or a result, needed."""
    if isinstance(event, LinearMeasurement):
        return replace(event, label=replace(event.label, vectors=None))
    return event
