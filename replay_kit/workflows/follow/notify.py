"""Alarms to a command: one JSON line each on its standard input."""

import json
import subprocess
from collections.abc import Sequence
from typing import Any

from replay_kit.results.status.alarms import Alarm
from replay_kit.results.status.status import Status

# A command that takes longer is stopped [s].
_PATIENCE = 60.0


def key_of(alarm: Alarm) -> str:
    """Return what tells an alarm from others: one is given once for each plan, surfacing, finding or forecast that it is about."""
    return f"{alarm.kind}: {alarm.about}"


def new_alarms(status: Status, given: Sequence[str]) -> tuple[Alarm, ...]:
    """Return the alarms of a status that were not given yet."""
    return tuple(alarm for alarm in status.alarms if key_of(alarm) not in given)


def standing(status: Status, given: Sequence[str]) -> tuple[str, ...]:
    """Return the alarms given that still stand, so that one that comes back is given again; those of surfacings once."""
    now = {key_of(alarm) for alarm in status.alarms}
    return tuple(key for key in given if key in now or key.startswith(("surfacing", "outside")))


def alarm_line(alarm: Alarm, status: Status) -> str:
    """Return an alarm as a JSON line, with the position and what to steer."""
    figures: dict[str, Any] = {
        key: status.figures[key]
        for key in ("result", "now", "position", "command")
        if key in status.figures
    }
    return json.dumps({**alarm.record(), **figures}, allow_nan=False) + "\n"


def notify(command: str, line: str) -> str:
    """Run a command of the shell with a line on its standard input, and return what went wrong; empty when nothing did."""
    try:
        done = subprocess.run(
            command,
            shell=True,
            input=line,
            text=True,
            capture_output=True,
            timeout=_PATIENCE,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"--notify: the command did not end well: {error}"
    words = done.stderr.strip().splitlines()
    return (
        f"--notify: the command ended with {done.returncode}{': ' + words[-1] if words else ''}"
        if done.returncode
        else ""
    )
