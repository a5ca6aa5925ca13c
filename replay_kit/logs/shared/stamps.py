"""Stamps far from their neighbours, and jumps of a log's clock: which stamp is set aside, and what a later one stands for."""

from collections.abc import Sequence
from dataclasses import dataclass

from replay_kit.core.text import time_text

#: Nearer stamps are no matter of a wrong clock: messages are late by hours where data are buffered [ns].
FAR_NS = 86_400_000_000_000
#: Messages that are looked at before a far stamp is judged.
LOOK_AHEAD = 32
#: A gap that neither the log's last message nor its first alone may make [ns].
_ALONE_NS = 366 * FAR_NS


@dataclass(frozen=True, slots=True)
class LogClock:
    """Where one log's clock stands.

    Attributes:
        last_ns: Time of the last message [ns, UTC], corrected.
        offset_ns: What is added to stamps [ns]: the jumps back so far.
    """

    last_ns: int
    offset_ns: int = 0


@dataclass(frozen=True, slots=True)
class ClockJump:
    """A jump of one log's clock, after which a new segment begins.

    Attributes:
        input: Position of the log among the run's inputs.
        before_ns: Corrected time of the last message before it [ns, UTC].
        stamp_ns: Stamp of the first message after it [ns].
        offset_ns: What is added to the stamps of the new segment [ns].
    """

    input: int
    before_ns: int
    stamp_ns: int
    offset_ns: int

    def __str__(self) -> str:
        begin = f"the clock jumps from {time_text(self.before_ns)} to {time_text(self.stamp_ns)}"
        moved = f"{self.offset_ns / FAR_NS:.3f} days were added to their stamps" if self.offset_ns else "their stamps are used as they are"
        return f"{begin}: the messages after it are a new segment, {moved}"


def settle(clock: LogClock | None, stamp_ns: int, following: Sequence[int]) -> LogClock | None:
    """Return the clock after a message, whose time is its ``last_ns``; None when the stamp is far from its neighbours and set aside.

    A stamp more than a day from the one before is believed when most of those that follow are nearer to it than to the one before. One
    that goes back begins a new segment: it continues at the time of the message before, or at its own where that is within a day.

    Args:
        clock: After the message before; None at the log's first.
        stamp_ns: The message's stamp [ns].
        following: The next stamps, at most ``LOOK_AHEAD`` of them; fewer only where the log ends [ns].
    """
    if clock is None:
        astray = sum(stamp_ns - other > FAR_NS or other - stamp_ns > _ALONE_NS for other in following)
        return None if 2 * astray > len(following) else LogClock(stamp_ns)
    time_ns = stamp_ns + clock.offset_ns
    step = time_ns - clock.last_ns
    if abs(step) <= FAR_NS:
        return LogClock(time_ns, clock.offset_ns)
    others = [other + clock.offset_ns for other in following]
    agree = sum(abs(other - time_ns) < abs(other - clock.last_ns) for other in others)
    if 2 * agree <= len(others) and (others or not 0 < step <= _ALONE_NS):
        return None
    if abs(stamp_ns - clock.last_ns) <= FAR_NS:
        return LogClock(stamp_ns)
    return LogClock(max(time_ns, clock.last_ns), clock.offset_ns + max(0, -step))
