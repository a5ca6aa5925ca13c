"""Events one by one, for what does not read blocks yet: positions, measurements, and whether each message was used."""

from collections.abc import Sequence
from dataclasses import dataclass

from replay_kit.core.observation import Measurement, VehicleState

# Words that ``measurements.ledger`` writes.
_LEFT_OUT, _BY = "left out: ", " (measurements.without)"


@dataclass(frozen=True, slots=True)
class Used:
    """A message was understood and used.

    Attributes:
        topic: Its topic.
    """

    topic: str


@dataclass(frozen=True, slots=True)
class Skipped:
    """A message was not used.

    Attributes:
        topic: Its topic.
        reason: Why, in a few words that are the same for all such messages.
    """

    topic: str
    reason: str


Event = VehicleState | Measurement | Used | Skipped


def left_out_rules(reason: str) -> Sequence[str]:
    """Return the rules of the settings that a reason names; none where it is another."""
    if not reason.startswith(_LEFT_OUT):
        return []
    return reason.removeprefix(_LEFT_OUT).removesuffix(_BY).split(", ")
