"""The replay of several vehicles: a session for each, and one estimate of what all of them measured."""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import merge as merged_by
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.message import Message
from replay_kit.estimator import Estimator
from replay_kit.results.mcap_writer import ResultWriter
from replay_kit.results.slices import depth_slice
from replay_kit.workflows.replay.inputs.estimator import flow_at
from replay_kit.workflows.replay.session import ReplayState, Session
from replay_kit.workflows.replay.shared import Queued
from replay_kit.workflows.replay.stages.publishing import published_depths

# Measurements times vehicles up to which the estimate is made without each: it takes as many updates.
_MOST_DENIED = 20_000
#: Schema of what stands in the stream where the logs of a vehicle end.
END = "replay_kit.EndOfLogs"


@dataclass(frozen=True, slots=True, eq=False)
class ArrayState:
    """The states of the sessions of several vehicles, and what waits between them.

    Attributes:
        states: Of each vehicle.
        queued: Of the common estimate.
        last_ns: Time of the last message [ns, UTC].
    """

    states: tuple[ReplayState, ...]
    queued: Queued
    last_ns: int


class ArraySession:
    """The sessions of several vehicles that share an estimate; what a replay asks of one, asked of all.

    Attributes:
        vehicles: The sessions, in the order of their names.
        last_ns: Time of the last message [ns, UTC].
        flows: At the end, the estimate of each vehicle, by name: of its window, or of all.
        windows: At the end, the numbers of the windows of vehicles that are in another one than the first.
    """

    def __init__(self, sessions: Sequence[Session]) -> None:
        """Begin with sessions of one estimate."""
        self.vehicles = tuple(sessions)
        first = sessions[0]
        self.shared, self.clock, self.config = first.shared, first.clock, first.config
        self.last_ns = 0
        self.flows: dict[str, FlowEstimate] = {}
        self.windows: dict[str, int] = {}

    @property
    def estimator(self) -> Estimator[Any]:
        """Of all."""
        return self.vehicles[0].built

    @property
    def writer(self) -> ResultWriter | None:
        """Of the result; None where nothing is written."""
        return self.vehicles[0].writer

    @writer.setter
    def writer(self, writer: ResultWriter | None) -> None:
        for session in self.vehicles:
            session.writer = writer

    @property
    def state(self) -> ArrayState:
        """What a checkpoint keeps."""
        states = tuple(session.state_with(None) for session in self.vehicles)
        return ArrayState(states, self.shared.queued, self.last_ns)

    def restore(self, state: ReplayState | ArrayState) -> None:
        """Continue from a state of several vehicles."""
        if not isinstance(state, ArrayState):
            raise TypeError("the state of one vehicle")
        for session, own in zip(self.vehicles, state.states, strict=True):
            session.restore(own)
        self.shared.restore(state.queued)
        self.last_ns = state.last_ns

    def conclude(self, about: Mapping[str, str]) -> FlowEstimate:
        """Finish surfacings, plan for each vehicle, publish slices and others' windows; return the first's estimate, with its citation."""
        held = dict[Hashable, FlowEstimate]()
        begun = [each.first_ns for each in self.vehicles if each.first_ns is not None]
        first_ns = min(begun, default=self.last_ns)
        for session in self.vehicles:
            session.end()
            state = session.estimation.current
            if (window := session.built.window(state)) not in held:
                flow = flow_at(session.built, state, self.last_ns)
                held[window] = replace(flow, about=about, span_ns=(first_ns, self.last_ns))
            self.flows[session.name] = held[window]
        flow, *others = held.values()
        if self.writer is not None:
            first = self.vehicles[0]
            numbers = dict(zip(map(id, others), first.publish_windows(iter(others)), strict=True))
            self.windows = {
                name: numbers[id(one)] for name, one in self.flows.items() if one is not flow
            }
            for one in (*others, flow):
                first.publish(one, self.last_ns)
        return flow


def streams(each: Sequence[Iterator[Message]], first_inputs: Sequence[int]) -> Iterator[Message]:
    """Yield the messages of several vehicles in order of time, those of one time in the order of the inputs, and where each one's end.

    Args:
        each: The messages of each vehicle.
        first_inputs: The first input of each.
    """
    ended = [_to_end(messages, number) for messages, number in zip(each, first_inputs, strict=True)]
    return merged_by(*ended, key=lambda message: (message.time_ns, message.input))


def _to_end(messages: Iterator[Message], number: int) -> Iterator[Message]:
    last_ns = 0
    for message in messages:
        last_ns = message.time_ns
        yield message
    yield Message(last_ns, "", END, {}, number, 2**62)


def value_of_each(session: ArraySession) -> dict[str, Mapping[str, float | int | None]]:
    """Return what each vehicle gives to the estimate, after all: what it would be without the vehicle's measurements (data denial)."""
    found: dict[str, Mapping[str, float | int | None]] = {}
    if len(session.vehicles) * len(session.shared.kept) > _MOST_DENIED:
        return found
    with session.clock.stage("value"):
        windows = {id(session.flows[one.name]): one for one in session.vehicles}.values()
        pooled = _on_slices([session.flows[one.name] for one in windows], session)
        for number, vehicle in enumerate(session.vehicles):
            state = session.shared.without(number)
            flows = [flow_at(one.built, state, session.last_ns) for one in windows]
            without = _on_slices(flows, session)
            error, error_without = (_rms(one[1]) for one in (pooled, without))
            found[vehicle.name] = {
                "measurements": sum(of == number for of, _ in session.shared.kept),
                "rms_change": _rms(np.hypot(*np.moveaxis(without[0] - pooled[0], -1, 0))),
                "standard_error": error,
                "standard_error_without": error_without,
            }
    return found


def _on_slices(flows: Sequence[FlowEstimate], session: ArraySession) -> tuple[Array, Array]:
    """Return the velocity at the published depths, shape (n, 2), and the length of its standard error, shape (n,) [m/s]."""
    depths = published_depths(flows[0], session.config.output)
    each = [depth_slice(flow, depth) for flow in flows for depth in depths]
    velocity = np.concatenate([one.velocity.reshape(-1, 2) for one in each])
    known = [one.standard_error for one in each if one.standard_error is not None]
    errors = (
        np.concatenate([np.hypot(*np.moveaxis(one, -1, 0)).ravel() for one in known])
        if known
        else np.full(len(velocity), np.nan)
    )
    return velocity, errors


def _rms(values: Array) -> float | None:
    """Return the RMS of the values that are known; None without any."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None
