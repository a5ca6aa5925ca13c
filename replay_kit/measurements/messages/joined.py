"""Velocities of which each message carries one component under a name: east and north joined by their stamps."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from replay_kit.config.mapping import ProfileMap, VelocityMap
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.measurements.messages.fields import number
from replay_kit.measurements.messages.mapped import mapped
from replay_kit.measurements.messages.profiles import StatedPing

_NS_PER_MS = 1e6


@dataclass(frozen=True, slots=True)
class Component:
    """One component of a velocity.

    Attributes:
        entry: The mapping that covers it; None while it waits, because a checkpoint holds values alone.
        name: Its name, the mapping's ``east`` or ``north``.
        stamp_ns: By the sender's clock where the message has one, else by the log's [ns].
        value: A number, or a list of one a cell.
    """

    entry: ProfileMap | VelocityMap | None
    name: str
    stamp_ns: float
    value: Any

    def fits(self, other: "Component") -> bool:
        """Return whether this one, which has its mapping, and one that waited are components of one velocity."""
        assert self.entry is not None, "it has just come"
        assert self.entry.join_within is not None, "only such mappings make components"
        return (
            self.name != other.name
            and abs(self.stamp_ns - other.stamp_ns) <= 1e9 * self.entry.join_within
        )


def component(message: Message, entry: ProfileMap | VelocityMap) -> Component:
    """Return the component that a message carries.

    Raises:
        MeasurementError: It carries neither ``value`` nor ``data``.
    """
    payload = message.payload
    held = next((payload[key] for key in ("value", "data") if key in payload), None)
    if held is None:
        raise MeasurementError(
            f"measurements.map: join_within: expected 'value' or 'data' in the message, it holds {', '.join(payload)}"
        )
    boot_ms = number(payload.get("time_boot_ms"))
    return Component(
        entry,
        str(payload["name"]),
        boot_ms * _NS_PER_MS if boot_ms == boot_ms else float(message.time_ns),
        held,
    )


def joined(part: Component, other: Component) -> StatedPing | str:
    """Return the velocity of a component, which has its mapping, and the other; or why there is none."""
    assert part.entry is not None, "it has just come"
    values: Mapping[str, Any] = {each.name: each.value for each in (part, other)}
    east, north = values[str(part.entry.east)], values[str(part.entry.north)]
    found = mapped(
        {"east": east, "north": north},
        part.entry.model_copy(update={"east": "east", "north": "north"}),
    )
    assert isinstance(found, StatedPing | str), "profiles and velocities are pings"
    return found
