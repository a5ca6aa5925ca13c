"""What one message and one schema may cost: the same budget for every encoding.

A few bytes can claim billions of values: an array of messages without fields takes no bytes at all, and compressed JSON a thousandth of its
length. A decoder therefore pays for values before it makes them, and a message that cannot pay is undecodable.
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
    """A message or schema that claims more than the budget allows."""


class Budget:
    """What one message may still cost; mutable, as a decoder spends from it while it reads."""

    __slots__ = ("left",)

    def __init__(self, size: int) -> None:
        """Begin with the budget of a message of that many bytes.

        Raises:
            BudgetError: It is longer than any that is decoded.
        """
        check_size(size, MOST_BYTES, "a message")
        self.left = min(MOST_VALUES, FREE + PER_BYTE * size)

    def spend(self, values: int) -> None:
        """Pay for values before they are made.

        Raises:
            BudgetError: The message holds more than it may.
        """
        self.left -= values
        if self.left < 0:
            raise BudgetError(
                f"more values than a message may hold ({PER_BYTE} a byte, {MOST_VALUES} in all)"
            )


def check_size(size: int, most: int, what: str) -> None:
    """Raise BudgetError when something has more bytes than it may.

    Args:
        size: Its length [bytes].
        most: What it may have.
        what: What it is, as a sentence begins.
    """
    if size > most:
        raise BudgetError(f"{what}: {size} bytes, more than the {most} that are read")
