"""Polling of growing files, alarms from the status, and memory that outlives the process."""

import json
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.files.atomic import sealed, unsealed, write_whole
from replay_kit.core.files.inputs import open_input
from replay_kit.core.plan import Place
from replay_kit.core.words.text import some_text
from replay_kit.results.outcome.verdict import Alarm
from replay_kit.show.status.status import Status
from replay_kit.workflows.follow.sources import (
    Source,
    change_words,
    examine,
    judged,
    look,
    settled,
)

_NAME = "mission"
# Sentences kept for the record.
_SAID = 500


@dataclass(frozen=True, slots=True)
class Memory:
    """Memory of a followed mission.

    Attributes:
        sources: Files examined, by path.
        goals: Goals so far, each with the log time from which it holds [ns, UTC]; the first from the beginning.
        said: Reports on the inputs, in order.
        given: Alarms given.
        forecast: Files of the forecast with their hashes; empty before the first replay.
        region: Part of the forecast that the first replay found, as JSON record or null; empty before it. It does not change, as the states
            depend on it.
    """

    sources: Mapping[Path, Source] = field(default_factory=dict)
    goals: tuple[tuple[int, Place], ...] = ()
    said: tuple[str, ...] = ()
    given: tuple[str, ...] = ()
    forecast: str = ""
    region: str = ""

    @property
    def used(self) -> tuple[Path, ...]:
        """Used files, in the order of examination."""
        return tuple(path for path, source in self.sources.items() if not source.aside)


_FORM = TypeAdapter(Memory)


def read_memory(folder: Path) -> Memory:
    """Return the memory in a folder; empty if there is none.

    Raises:
        LogError: It is unusable: without the goals and the forecast so far the result would differ.
    """
    if not (path := folder / _NAME).exists():
        return Memory()
    try:
        with open_input(path) as file:
            data = unsealed(file.read())
        if data is None:
            raise ValueError("its checksum is missing")
        return _FORM.validate_json(data)
    except (OSError, ValueError) as error:
        why = " ".join(str(error).split())[:200]
        raise LogError(
            f"{path}: the memory of a followed mission cannot be used: {why}; delete its folder to begin anew"
        ) from error


def write_memory(folder: Path, memory: Memory) -> None:
    """Write the memory with its seal, completely or not at all."""
    data = _FORM.dump_json(replace(memory, said=memory.said[-_SAID:]))
    write_whole(folder / _NAME, sealed(data))


@dataclass(frozen=True, slots=True)
class FollowOptions:
    """Options for following logs.

    Attributes:
        states: Folder of the data kept between replays; it must outlive them.
        status: Status page.
        interval_s: Time between two looks [s].
        until_idle_s: Time without new data after which following ends [s]; None never ends.
        goal_file: Editable file with the goal; None without one.
        command: Shell command run with each alarm; empty for none.
        report: Page of the report; None without one.
        tell: Called with messages for the user.
    """

    states: Path
    status: Path
    interval_s: float = 60.0
    until_idle_s: float | None = None
    goal_file: Path | None = None
    command: str = ""
    report: Path | None = None
    tell: Callable[[str], None] = field(default=lambda text: None, repr=False)


# Between the two looks that a file must not change between, at most [s].
_SETTLING = 1.0


@dataclass(frozen=True, slots=True)
class Clock:
    """Clock, replaced in tests.

    Attributes:
        now_ns: Function of the present time [ns, UTC].
        idle_s: Function of a monotonic time [s].
        wait: Function that waits [s].
    """

    now_ns: Callable[[], int] = time.time_ns
    idle_s: Callable[[], float] = time.monotonic
    wait: Callable[[float], None] = time.sleep


@dataclass(frozen=True, slots=True)
class Watched:
    """Followed files and folders.

    Attributes:
        paths: Files and folders.
        own: Other inputs and outputs of the run, which are not logs.
        logs: Settings of log reading.
        clock: Clock.
        interval_s: Time between two looks [s].
        vehicle_of: Function of the name of a file's vehicle; files of one vehicle are of one mission.
    """

    paths: tuple[Path, ...]
    own: tuple[Path, ...]
    logs: LogConfig
    clock: Clock
    interval_s: float
    vehicle_of: Callable[[Path], str] = lambda path: ""


def look_again(
    watched: Watched, known: Mapping[Path, Source]
) -> tuple[dict[Path, Source], list[str], bool]:
    """Return the present files, reports on them, and whether the messages of a replay may have changed.

    A file that arrives complete is accepted when unchanged between two looks; until then its former version holds.

    Args:
        watched: Followed files and folders.
        known: The files at the look before.
    """
    now = look(watched.paths, watched.own)
    there = now
    if any(path not in known or known[path].stamp != stamp for path, stamp in now.items()):
        watched.clock.wait(min(watched.interval_s, _SETTLING))
        stamps = {path: source.stamp for path, source in known.items()} | settled(
            now, look(watched.paths, watched.own)
        )
        there = {path: stamps[path] for path in now if path in stamps}
    sources = {path: source for path, source in known.items() if path in now}
    lost = [path.name for path, one in known.items() if path not in now and not one.aside]
    said = [f"{some_text(lost)}: missing, so excluded"] if lost else []
    changed = bool(lost)
    for path, stamp in there.items():
        before = sources.get(path)
        # whether a file is set aside depends on the others
        if before is not None and before.stamp == stamp and not (lost and before.aside):
            continue
        own = {
            other: source
            for other, source in sources.items()
            if watched.vehicle_of(other) == watched.vehicle_of(path)
        }
        found = judged(own, examine(path, stamp, watched.logs), watched.clock.now_ns())
        words = change_words(before, found)
        said += [f"{path.name} {words}"] if words else []
        changed |= bool(words) and (not found.aside or (before is not None and not before.aside))
        sources[path] = found
    present = {path: sources[path] for path in there}
    return present, said, changed


# A command that takes longer is stopped [s].
_PATIENCE = 60.0


def of_vehicle(name: str, text: str) -> str:
    """Return a text preceded by the vehicle's name; unchanged for a single vehicle."""
    return f"{name}: {text}" if name else text


def key_of(alarm: Alarm, name: str = "") -> str:
    """Return the key of an alarm, which is given once per plan, surfacing, finding or forecast concerned."""
    return of_vehicle(name, f"{alarm.kind}: {alarm.about}")


def new_alarms(status: Status, given: Sequence[str], name: str = "") -> tuple[Alarm, ...]:
    """Return the alarms of a vehicle's status that were not given yet."""
    return tuple(alarm for alarm in status.alarms if key_of(alarm, name) not in given)


def standing(statuses: Mapping[str, Status], given: Sequence[str]) -> tuple[str, ...]:
    """Return the given alarms that persist, so that a recurring one is given again; alarms of surfacings only once."""
    now = {key_of(alarm, name) for name, status in statuses.items() for alarm in status.alarms}
    once = tuple(of_vehicle(name, kind) for name in statuses for kind in ("surfacing", "outside"))
    return tuple(key for key in given if key in now or key.startswith(once))


def alarm_line(alarm: Alarm, status: Status, name: str = "") -> str:
    """Return an alarm as a JSON line, with the position, the heading to steer, and the name of one of several vehicles."""
    figures: dict[str, Any] = {
        key: status.figures[key]
        for key in ("result", "now", "position", "command")
        if key in status.figures
    }
    of = {"vehicle": name} if name else {}
    return json.dumps({**of, **alarm.record(), **figures}, allow_nan=False) + "\n"


def notify(command: str, line: str) -> str:
    """Run a shell command with a line on its standard input, and return its error; empty on success."""
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
        return f"--notify: the command failed: {error}"
    words = done.stderr.strip().splitlines()
    return (
        f"--notify: the command ended with {done.returncode}{': ' + words[-1] if words else ''}"
        if done.returncode
        else ""
    )
