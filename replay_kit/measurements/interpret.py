"""Messages to events, one by one or in blocks, as views of ``measure``'s blocks: for what does not read blocks yet."""

# keeps the signature in help() short
from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.block import Block
from replay_kit.core.message import Message
from replay_kit.core.observation import Measurement, PathMean
from replay_kit.logs.tables.frames import SCHEMA
from replay_kit.logs.tables.schemas import SENDERS
from replay_kit.measurements.events import Event, Skipped, Used
from replay_kit.measurements.measure import Memory
from replay_kit.measurements.observed import Stream, blocks, rows, taken

_BLOCK = 128
#: What a MAVLink reader needs to decode for measurements.
MAVLINK_NAMES = SENDERS | {SCHEMA}


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementState:
    """What is remembered after a message.

    Attributes:
        before: After the block before.
        messages: Of the block; they are measured again where the state is asked for, as blocks give the same in any cut.
        count: How many of them are before the state.
        config: How they become measurements.
    """

    before: Stream = field(default_factory=Stream)
    messages: Sequence[Message] = ()
    count: int = 0
    config: MeasurementConfig | None = None

    @property
    def stream(self) -> Stream:
        """What is carried on."""
        if self.config is None:
            return self.before
        return taken(self.before, self.messages[: self.count], self.config)[0]

    @property
    def settled(self) -> MeasurementState:
        """The same without messages to be measured again."""
        return MeasurementState(self.stream)

    @property
    def dive(self) -> int:
        """Number of dives begun."""
        return self.stream.memory.diving.dive


def initial_state(system: int | None = None, component: int | None = None) -> MeasurementState:
    """Return the state before the first message; ``system`` and ``component`` are those of MAVLink asked for, in logs that hold several."""
    asked = (None if number is None else str(number) for number in (system, component))
    return MeasurementState(Stream(Memory(sender=(next(asked), next(asked)))))


def observations(
    messages: Iterable[Message], config: MeasurementConfig | None = None
) -> Iterator[Measurement]:
    """Yield the profiles and mean currents in a stream of messages: what a post-mission script loops over.

    A mean current beside profiles that were computed from it is left out: without the flight model's bias it would count twice.
    """
    for block in blocks(messages, config or MeasurementConfig()):
        for event in rows(block):
            beside = isinstance(event, PathMean) and event.beside_profiles
            if isinstance(event, Measurement) and not beside:
                yield event


def events_of(
    messages: Iterable[Message],
    config: MeasurementConfig,
    system: int | None = None,
    component: int | None = None,
) -> Iterator[list[Event]]:
    """Yield the events that each message of a stream completes, and last those of what still waits at its end.

    Args:
        messages: In order of time; they are taken in blocks.
        config: How messages become observations.
        system: The MAVLink system that counts; None for the first that states a position.
        component: The component of it that counts; None for the first that states a position.
    """
    state, rest = initial_state(system, component), iter(messages)
    while block := list(islice(rest, _BLOCK)):
        steps = interpret_block(state, block, config)
        state = steps[-1][0]
        for _, events in steps:
            yield events
    yield finish(state, config)


def interpret(
    state: MeasurementState, message: Message, config: MeasurementConfig
) -> tuple[MeasurementState, list[Event]]:
    """Return the state after a message and the events it completes.

    Each message gives exactly one ``Used`` or ``Skipped``, at once or, for a ping, when its position is known. A message that is
    not what its schema says is skipped and leaves no trace in the state.
    """
    return interpret_block(state, [message], config)[0]


def interpret_block(
    state: MeasurementState, messages: Sequence[Message], config: MeasurementConfig
) -> list[tuple[MeasurementState, list[Event]]]:
    """Return the state after each message of a block and the events that it completes, as ``interpret`` does one by one.

    Args:
        state: Before the first message.
        messages: In order of time.
        config: How messages become observations.
    """
    before = state.stream
    after, block = taken(before, messages, config)
    found: list[list[Event]] = [[] for _ in messages]
    for order, event in _events(block):
        found[order - before.order].append(event)
    states = [MeasurementState(before, messages, k, config) for k in range(1, len(messages))]
    return list(zip([*states, MeasurementState(after)], found, strict=True)) if messages else []


def finish(state: MeasurementState, config: MeasurementConfig) -> list[Event]:
    """Return the events of what still waits when the log ends."""
    return [event for _, event in _events(taken(state.stream, [], config, last=True)[1])]


def _events(block: Block) -> Iterator[tuple[int, Event]]:
    """Yield the events of a block, each with the place in the stream of the message that completes it; first what became of messages."""
    for order, topic, reason in block.outcomes.tolist():
        name = block.topics[topic]
        yield order, Used(name) if reason < 0 else Skipped(name, block.reasons[reason])
    yield from zip(block.events[:, 0].tolist(), rows(block), strict=True)
