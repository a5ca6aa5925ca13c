"""Files of a followed mission, with reasons for exclusion; its goals and alarms; and the memory of it that outlives the process."""

import hashlib
import json
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from replay_kit.config.option import PLACE, numbers
from replay_kit.config.run import LogConfig
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.files.atomic import sealed, unsealed, write_whole
from replay_kit.core.files.inputs import Stamp, open_input, stamps_of
from replay_kit.core.plan import Place
from replay_kit.core.words.text import some_text, time_text
from replay_kit.logs import open_log
from replay_kit.logs.opening import in_folder, may_grow
from replay_kit.results.outcome.verdict import Alarm
from replay_kit.show.status.status import Status

_NAME = "mission"
# Sentences kept for the record.
_SAID = 500
#: A first message this much older or younger than those of all other files is a clock's error [ns].
_FAR_NS = 366 * 86_400 * 10**9
# How much later than the present a clock may be [ns].
_AHEAD_NS = 86_400 * 10**9
_BLOCK = 1 << 20
# files being written, and the sensor lists of a Slocum, which lie among its files
_NO_LOGS = (".part", ".cac", ".ccc")
# Between the two looks that a file must not change between, at most [s].
_SETTLING = 1.0
# A command that takes longer is stopped [s].
_PATIENCE = 60.0
#: Goals, each with the log time from which it holds [ns, UTC]; the first from the beginning.
Goals = tuple[tuple[int, Place], ...]


@dataclass(frozen=True, slots=True)
class Source:
    """File at the time of a look.

    Attributes:
        path: The file.
        stamp: Identity of this version of the file.
        sha256: SHA-256 of its bytes.
        mission: Mission that it states; empty without one.
        first_ns: Time of its first message [ns, UTC]; None without messages.
        aside: Reason for its exclusion; empty if used.
    """

    path: Path
    stamp: Stamp
    sha256: str
    mission: str = ""
    first_ns: int | None = None
    aside: str = ""


@dataclass(frozen=True, slots=True)
class Memory:
    """Memory of a followed mission.

    Attributes:
        sources: Files examined, by path.
        goals: Goals so far.
        said: Reports on the inputs, in order.
        given: Alarms given.
        forecast: Files of the forecast with their hashes; empty before the first replay.
        region: Part of the forecast that the first replay found, as JSON record or null; empty before it. It does not change, as the states
            depend on it.
    """

    sources: Mapping[Path, Source] = field(default_factory=dict)
    goals: Goals = ()
    said: tuple[str, ...] = ()
    given: tuple[str, ...] = ()
    forecast: str = ""
    region: str = ""

    @property
    def used(self) -> tuple[Path, ...]:
        """Used files, in the order of examination."""
        return tuple(path for path, source in self.sources.items() if not source.aside)


_FORM = TypeAdapter(Memory)


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


# ---- files


def look(paths: Iterable[Path], outputs: Iterable[Path]) -> dict[Path, Stamp]:
    """Return the present files, also those in folders, with a stamp of each.

    Args:
        paths: Followed files and folders.
        outputs: Other inputs and outputs of the run, which are not logs.
    """
    written, found = {path.resolve() for path in outputs}, list[Path]()
    for path in paths:
        held = [path]
        if path.is_dir():
            names = (part for part in path.iterdir() if not part.name.startswith("."))
            held = [part for part in names if part.suffix.lower() not in _NO_LOGS]
        found += sorted((part for part in held if part.resolve() not in written), key=in_folder)
    return stamps_of(dict.fromkeys(found))


def settled_files(before: Mapping[Path, Stamp], now: Mapping[Path, Stamp]) -> dict[Path, Stamp]:
    """Return the complete files at the second of two looks: unchanged between them, or of a growing kind."""
    return {path: at for path, at in now.items() if before.get(path) == at or may_grow(path)}


def look_again(
    looked: Callable[[], dict[Path, Stamp]],
    known: Mapping[Path, Source],
    config: LogConfig,
    clock: Clock,
    interval_s: float,
    vehicle_of: Callable[[Path], str] = lambda path: "",
) -> tuple[dict[Path, Source], list[str], bool]:
    """Return the present files, reports on them, and whether the messages of a replay may have changed.

    A file that arrives complete is accepted when unchanged between two looks; until then its former version holds.

    Args:
        looked: Returns the present files, as ``look`` does.
        known: The files at the look before.
        config: Settings of log reading.
        clock: Clock.
        interval_s: Time between two looks [s].
        vehicle_of: Function of the name of a file's vehicle; files of one vehicle are of one mission.
    """
    there = now = looked()
    stamps = {path: source.stamp for path, source in known.items()}
    if any(stamps.get(path) != stamp for path, stamp in now.items()):
        clock.wait(min(interval_s, _SETTLING))
        stamps |= settled_files(now, looked())
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
        vehicle = vehicle_of(path)
        of_vehicle = {other: one for other, one in sources.items() if vehicle_of(other) == vehicle}
        found = judged_file(of_vehicle, examine(path, stamp, config), clock.now_ns())
        if words := change_words(before, found):
            said.append(f"{path.name} {words}")
            changed |= not found.aside or (before is not None and not before.aside)
        sources[path] = found
    return {path: sources[path] for path in there}, said, changed


def examine(path: Path, stamp: Stamp, config: LogConfig) -> Source:
    """Return the description of a file; a file that is no readable log is excluded with the reason.

    Args:
        path: The file.
        stamp: Its stamp; of a file that grew since then only the bytes of that time are hashed.
        config: Settings of log reading.
    """
    digest, left = hashlib.sha256(), stamp[2]
    try:
        with open_input(path) as file:
            while left and (block := file.read(min(_BLOCK, left))):
                digest.update(block)
                left -= len(block)
        with open_log(path, 0, config) as log:
            first = next((message.time_ns for message in log.messages()), None)
            return Source(path, stamp, digest.hexdigest(), log.report().mission, first)
    except (LogError, OSError) as error:
        words = str(error).removeprefix(f"{path}: ")
        return Source(path, stamp, digest.hexdigest(), aside=f"is not a readable log: {words}")


def judged_file(known: Mapping[Path, Source], found: Source, now_ns: int) -> Source:
    """Return a file, excluded if it does not belong to the mission.

    Args:
        known: The other files.
        found: The file.
        now_ns: The present time [ns, UTC].
    """
    others = [one for path, one in known.items() if path != found.path and not one.aside]
    missions = {one.mission for one in others if one.mission}
    times = [one.first_ns for one in others if one.first_ns is not None]
    same, first_ns = (one for one in others if one.sha256 == found.sha256), found.first_ns
    if found.aside:
        return found
    if first_ns is None:
        why = "has no message yet"
    elif (other := next(same, None)) is not None:
        why = f"is identical to {other.path.name} and counts once"
    elif found.mission and missions and found.mission not in missions:
        why = f"is of {found.mission}, not of {', '.join(sorted(missions))}; follow it separately"
    else:
        than = ""
        if first_ns > now_ns + _AHEAD_NS:
            than = "the present"
        elif times and not min(times) - _FAR_NS <= first_ns <= max(times) + _FAR_NS:
            than = f"the others, from {time_text(min(times))}"
        why = than and (
            f"begins at {time_text(first_ns)}, far from {than}: its clock was wrong; correct it to use it"
        )
    return replace(found, aside=why)


def change_words(before: Source | None, now: Source) -> str:
    """Return the change of a file, as words to follow its name; empty without a relevant change.

    Args:
        before: The file at the look before; None for a new file.
        now: The file now.
    """
    if now.aside:
        known = before is not None and before.aside == now.aside
        return "" if known else f"not used: it {now.aside}"
    if before is None or before.aside:
        return "new"
    sizes = f"changed, from {before.stamp[2]} to {now.stamp[2]} bytes"
    return "" if now.sha256 == before.sha256 else sizes


# ---- memory and goals


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


def read_goal(path: Path) -> Place:
    """Return the goal in a file: the first line that is not empty or a comment (#), ``LON,LAT,DEPTH`` [degrees, degrees, m].

    Raises:
        ConfigError: The file cannot be read, or has no such line.
    """
    try:
        with open_input(path) as file:
            lines = [line.strip() for line in file.read(_BLOCK).decode().splitlines()]
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: the goal cannot be read: {error}") from error
    text = next((line for line in lines if line and not line.startswith("#")), "")
    PLACE.check(str(path), text[:80])
    longitude, latitude, depth = numbers(text, str(path), PLACE.form)
    if not (abs(longitude) <= 360.0 and depth >= 0.0):
        raise ConfigError(
            f"{path}: '{text[:80]}' is not a place in the ocean; write LON,LAT,DEPTH [degrees, degrees, m]"
        )
    return Place(longitude, latitude, depth)


def with_goal(goals: Goals, goal: Place, since_ns: int) -> Goals:
    """Return the goals with another one from a log time on [ns, UTC]; unchanged if it equals the last one."""
    if not goals:
        return ((0, goal),)
    if goals[-1][1] == goal:
        return goals
    return (*(one for one in goals if one[0] < since_ns or one is goals[0]), (since_ns, goal))


# ---- alarms


def with_vehicle_name(name: str, text: str) -> str:
    """Return a text preceded by the vehicle's name; unchanged for a single vehicle."""
    return f"{name}: {text}" if name else text


def key_of(alarm: Alarm, name: str = "") -> str:
    """Return the key of an alarm, which is given once per plan, surfacing, finding or forecast concerned."""
    return with_vehicle_name(name, f"{alarm.kind}: {alarm.about}")


def new_alarms(status: Status, given: Sequence[str], name: str = "") -> tuple[Alarm, ...]:
    """Return the alarms of a vehicle's status that were not given yet."""
    return tuple(alarm for alarm in status.alarms if key_of(alarm, name) not in given)


def standing_alarms(statuses: Mapping[str, Status], given: Sequence[str]) -> tuple[str, ...]:
    """Return the given alarms that persist, so that a recurring one is given again; alarms of surfacings only once."""
    now = {key_of(alarm, name) for name, status in statuses.items() for alarm in status.alarms}
    once = tuple(
        with_vehicle_name(name, kind) for name in statuses for kind in ("surfacing", "outside")
    )
    return tuple(key for key in given if key in now or key.startswith(once))


def alarm_line(alarm: Alarm, status: Status, name: str = "") -> str:
    """Return an alarm as a JSON line, with the position, the heading to steer, and the name of one of several vehicles."""
    shown, vehicle = ("result", "now", "position", "command"), {"vehicle": name} if name else {}
    figures: dict[str, Any] = {key: status.figures[key] for key in shown if key in status.figures}
    return json.dumps({**vehicle, **alarm.record(), **figures}, allow_nan=False) + "\n"


def notify(command: str, line: str) -> str:
    """Run a shell command with a line on its standard input, and return its error; empty on success."""
    how: dict[str, Any] = {"shell": True, "text": True, "capture_output": True, "check": False}
    try:
        done = subprocess.run(command, input=line, timeout=_PATIENCE, **how)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"--notify: the command failed: {error}"
    if not done.returncode:
        return ""
    words = done.stderr.strip().splitlines()
    return f"--notify: the command ended with {done.returncode}{': ' + words[-1] if words else ''}"
