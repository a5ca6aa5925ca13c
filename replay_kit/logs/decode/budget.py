"""What one message and one schema may cost: the same budget for every encoding.

A few bytes can claim billions of values: an array of messages without fields takes no bytes at all, and compressed JSON a thousandth of its
length. A decoder therefore pays for values before it makes them, and a message that cannot pay is undecodable.
"""

from replay_kit.core.errors import ReplayKitError

#: Values that one message may hold: numbers, texts and lists count one each, mappings ``MAPPING``. They take about 80 MB at most.
MOST_VALUES = 1 << 20
#: What a mapping costs, in values: its memory is that of so many numbers.
MAPPING = 4
#: Values for each byte of a message, and for a message without bytes: what is encoded in bytes has fewer in any encoding.
PER_BYTE, FREE = 16, 1024
#: Largest schema that is parsed [bytes]; those in use have some kB.
MOST_SCHEMA = 1 << 20


class BudgetError(ReplayKitError, ValueError):
    """A message or schema that claims more than the budget allows."""


class Budget:
    """What one message may still cost; mutable, as a decoder spends from it while it reads."""

    __slots__ = ("left",)

    def __init__(self, size: int) -> None:
        """Begin with the budget of a message of that many bytes."""
        self.left = min(MOST_VALUES, FREE + PER_BYTE * size)

    def spend(self, values: int) -> None:
        """Pay for values before they are made.

        Raises:
            BudgetError: The message holds more than it may.
        """
        self.left -= values
        if self.left < 0:
            raise BudgetError(f"more values than a message may hold ({PER_BYTE} a byte, {MOST_VALUES} in all)")


def check_schema(schema: bytes) -> None:
    """Raise BudgetError when a schema is larger than any that is parsed."""
    if len(schema) > MOST_SCHEMA:
        raise BudgetError(f"{len(schema)} bytes, more than the {MOST_SCHEMA} that a schema may have")
