"""How logs are followed."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, slots=True)
class FollowOptions:
    """How logs are followed.

    Attributes:
        states: Folder of what is kept between replays; it must outlive them.
        status: Page of the status.
        interval_s: Between two looks [s].
        until_idle_s: Ends after so many seconds without anything new; None never ends.
        goal_file: File that holds the goal, and may be changed; None without.
        command: Run with each alarm; empty for none.
        report: Page of the report; None without.
        tell: Called with what a person should read.
    """

    states: Path
    status: Path
    interval_s: float = 60.0
    until_idle_s: float | None = None
    goal_file: Path | None = None
    command: str = ""
    report: Path | None = None
    tell: Callable[[str], None] = field(default=lambda text: None, repr=False)
