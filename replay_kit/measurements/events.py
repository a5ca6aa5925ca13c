"""The events of the measurement step: positions, measurements, and whether each message was used."""

from collections.abc import Sequence
from dataclasses import dataclass

from replay_kit.core.observation import Measurement, VehicleState
from replay_kit.measurements.quality.qartod import Check, Checks

# What code that trusts a payload's types raises when they are not what they should be.
MALFORMED = (ValueError, TypeError, LookupError, AttributeError, OverflowError)

#: The reason of a message of a kind that is not known.
NOT_A_KIND = "message type not used by the estimator"
#: Begins the reason for which a ping is not used that nothing places.
NO_POSITION = "no position within"


@dataclass(frozen=True, slots=True)
class Used:
    """A message was understood and used.

    Attributes:
        topic: Its topic.
        tests: Results of the quality tests of the pings among which is the one that it completed.
        at: Which of them that is.
    """

    topic: str
    tests: Sequence[Checks] = ()
    at: int = 0

    @property
    def checks(self) -> tuple[Check, ...]:
        """Results of the quality tests of its own ping."""
        return tuple(test.of(self.at) for test in self.tests)


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


_LEFT_OUT, _BY = "left out: ", " (measurements.without)"


def left_out_reason(rules: Sequence[str]) -> str:
    """Return the reason of a message whose measurement rules of the settings leave out."""
    return f"{_LEFT_OUT}{', '.join(rules)}{_BY}"


def left_out_rules(reason: str) -> list[str]:
    """Return the rules that a reason names; none where it is another."""
    return (
        reason.removeprefix(_LEFT_OUT).removesuffix(_BY).split(", ")
        if reason.startswith(_LEFT_OUT)
        else []
    )


def malformed(error: Exception) -> str:
    """Return the reason of a message that raised one of ``MALFORMED``; the values stay out, so that alike messages count as one."""
    return f"malformed: a field is missing or of the wrong kind ({type(error).__name__})"
