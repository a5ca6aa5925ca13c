"""Decoding budget of a message and a schema, equal for all encodings.

A few bytes can claim billions of values: empty messages in an array take no bytes, compressed JSON a thousandth of its length. Decoders
therefore charge values to a budget before creating them; a message beyond it is undecodable.
"""

from replay_kit.core.errors import ReplayKitError

#: Values that one message may hold: numbers, texts and lists count one each, mappings ``MAPPING``. They take about 40 MB at most.
MOST_VALUES = 1 << 19
#: Longest message that is decoded [bytes]; a longer one, such as a large image, can still be copied.
MOST_BYTES = 1 << 24
#: What a mapping costs, in values: its memory is that of so many numbers.
MAPPING = 4
#: Values for each byte of a message, and for a message without bytes: what is encoded in bytes has fewer in any encoding.
PER_BYTE, FREE = 16, 1024
#: Largest schema that is parsed, and all that are parsed of one log [bytes]: a schema in use has some kB, and parsed it takes 60 to 250
#: times its length. What a log may declare in all, schemas and channels [bytes].
MOST_SCHEMA, MOST_SCHEMAS, MOST_DECLARED = 1 << 18, 1 << 20, 1 << 23


class BudgetError(ReplayKitError, ValueError):
    """Message or schema beyond the budget."""


class Budget:
    """Remaining budget of one message; mutable, as decoders charge it while they read."""

    __slots__ = ("left",)

    def __init__(self, size: int) -> None:
        """Create the budget of a message.

        Raises:
            BudgetError: The message is longer than the limit.
        """
        check_size(size, MOST_BYTES, "a message")
        self.left = min(MOST_VALUES, FREE + PER_BYTE * size)

    def spend(self, values: int) -> None:
        """Charge values before they are created.

        Raises:
            BudgetError: The budget is exceeded.
        """
        self.left -= values
        if self.left < 0:
            raise BudgetError(
                f"more values than a message may hold ({PER_BYTE} a byte, {MOST_VALUES} in all)"
            )


def check_size(size: int, most: int, what: str) -> None:
    """Raise BudgetError if a size exceeds its limit.

    Args:
        size: Size [bytes].
        most: Limit [bytes].
        what: Subject of the message.
    """
    if size > most:
        raise BudgetError(f"{what}: {size} bytes, more than the {most} that are read")
