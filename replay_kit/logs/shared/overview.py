"""What a log's own index says of it, before its messages are read."""

from collections.abc import Mapping
from dataclasses import dataclass

from replay_kit.core.message import Message


@dataclass(frozen=True, slots=True)
class TopicExtent:
    """One topic of a file, by its index.

    Attributes:
        schema: Name of its schema.
        messages: Number of messages.
        first_ns: Earliest log time [ns]; None when the index does not say it in a few reads.
        last_ns: Latest.
    """

    schema: str
    messages: int
    first_ns: int | None
    last_ns: int | None

    def joined(self, other: "TopicExtent") -> "TopicExtent":
        """Return this topic with the messages of another channel."""
        firsts, lasts = (self.first_ns, other.first_ns), (self.last_ns, other.last_ns)
        first_ns = None if None in firsts else min(firsts)  # type: ignore[type-var]
        last_ns = None if None in lasts else max(lasts)  # type: ignore[type-var]
        return TopicExtent(self.schema, self.messages + other.messages, first_ns, last_ns)


@dataclass(frozen=True, slots=True)
class Overview:
    """A file by its index.

    Attributes:
        topics: By name.
        undecodable: Topic to the reason why none of its messages can be decoded.
        first: The first messages of each other topic, in the order of the file.
    """

    topics: Mapping[str, TopicExtent]
    undecodable: Mapping[str, str]
    first: tuple[Message, ...]

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(topic.messages for topic in self.topics.values())
