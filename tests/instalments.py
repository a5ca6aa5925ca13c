"""A glider's mission as it comes in: one file a dive, some of them late, one corrected."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from replay_kit.core.message import Message
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log


@dataclass(frozen=True)
class Instalment:
    """A file that arrives: its name, and what it holds."""

    name: str
    data: bytes


def dives_of(log: Path, folder: Path) -> list[Instalment]:
    """Return the messages of a twin's log as one file a dive, each up to and with the mean current that ends the dive."""
    groups: list[list[Message]] = [[]]
    with open_log(log) as reader:
        for message in reader.messages():
            groups[-1].append(message)
            if message.topic == "/dac":
                groups.append([])
    made = []
    for number, messages in enumerate((group for group in groups if group), start=1):
        path = folder / f"dive{number:03d}.mcap"
        write_mcap_log(path, messages)
        made.append(Instalment(path.name, path.read_bytes()))
        path.unlink()
    return made


def delivered(
    dives: Sequence[Instalment], swapped: Sequence[int], corrected: int, wrong: Instalment
) -> list[Instalment]:
    """Return dives in the order in which they arrive: some change places with the next one, one is wrong at first and comes again later.

    Args:
        dives: In their own order.
        swapped: Places of those that come after the next one.
        corrected: Place of the one that is wrong at first; it comes again, right, three instalments later.
        wrong: What it is at first.
    """
    order = list(dives)
    order[corrected] = wrong
    for k in swapped:
        order[k], order[k + 1] = order[k + 1], order[k]
    at = order.index(wrong)
    order.insert(min(at + 4, len(order)), dives[corrected])
    return order
