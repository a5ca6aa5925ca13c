"""Files of a followed mission: identity, use, and reasons for exclusion."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from replay_kit.config.option import PLACE, numbers
from replay_kit.config.run import LogConfig
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.files.inputs import Stamp, open_input, stamps_of
from replay_kit.core.plan import Place
from replay_kit.core.words.text import time_text
from replay_kit.logs import open_log
from replay_kit.logs.opening import in_folder, may_grow

#: A first message this much older or younger than those of all other files is a clock's error [ns].
_FAR_NS = 366 * 86_400 * 10**9
# How much later than the present a clock may be [ns].
_AHEAD_NS = 86_400 * 10**9
_BLOCK = 1 << 20
# files being written, and the sensor lists of a Slocum, which lie among its files
_NO_LOGS = (".part", ".cac", ".ccc")


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


def look(paths: Iterable[Path], own: Iterable[Path]) -> dict[Path, Stamp]:
    """Return the present files, also those in folders, with a stamp of each.

    Args:
        paths: Followed files and folders.
        own: Outputs of the run.
    """
    written = {path.resolve() for path in own}
    found: list[Path] = []
    for path in paths:
        held = (
            [
                part
                for part in path.iterdir()
                if not part.name.startswith(".") and part.suffix.lower() not in _NO_LOGS
            ]
            if path.is_dir()
            else [path]
        )
        found += sorted((part for part in held if part.resolve() not in written), key=in_folder)
    return stamps_of(dict.fromkeys(found))


def settled(before: Mapping[Path, Stamp], now: Mapping[Path, Stamp]) -> dict[Path, Stamp]:
    """Return the complete files at the second of two looks: unchanged between them, or of a growing kind."""
    return {
        path: stamp for path, stamp in now.items() if before.get(path) == stamp or may_grow(path)
    }


def examine(path: Path, stamp: Stamp, config: LogConfig) -> Source:
    """Return the description of a file; a file that is no readable log is excluded with the reason.

    Args:
        path: The file.
        stamp: Its stamp.
        config: Settings of log reading.
    """
    digest = ""
    try:
        digest = _sha256(path, stamp[2])
        with open_log(path, 0, config) as log:
            first = next((message.time_ns for message in log.messages()), None)
            return Source(path, stamp, digest, log.report().mission, first)
    except (LogError, OSError) as error:
        words = str(error).removeprefix(f"{path}: ")
        return Source(path, stamp, digest, aside=f"is not a readable log: {words}")


def judged(known: Mapping[Path, Source], found: Source, now_ns: int) -> Source:
    """Return a file, excluded if it does not belong to the mission.

    Args:
        known: The other files.
        found: The file.
        now_ns: The present time [ns, UTC].
    """
    others = [source for path, source in known.items() if path != found.path and not source.aside]
    if found.aside:
        return found
    if found.first_ns is None:
        return replace(found, aside="has no message yet")
    same = next((source for source in others if source.sha256 == found.sha256), None)
    if same is not None:
        return replace(found, aside=f"is identical to {same.path.name} and counts once")
    missions = {source.mission for source in others if source.mission}
    if found.mission and missions and found.mission not in missions:
        return replace(
            found,
            aside=f"is of {found.mission}, not of {', '.join(sorted(missions))}; follow it separately",
        )
    times = [source.first_ns for source in others if source.first_ns is not None]
    far = bool(times) and not min(times) - _FAR_NS <= found.first_ns <= max(times) + _FAR_NS
    if found.first_ns > now_ns + _AHEAD_NS or far:
        than = (
            "the present"
            if found.first_ns > now_ns + _AHEAD_NS
            else f"the others, from {time_text(min(times))}"
        )
        return replace(
            found,
            aside=f"begins at {time_text(found.first_ns)}, far from {than}: its clock was wrong; correct it to use it",
        )
    return found


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


def _sha256(path: Path, size: int) -> str:
    """Return the SHA-256 of the first ``size`` bytes of a file."""
    digest, left = hashlib.sha256(), size
    with open_input(path) as file:
        while left and (block := file.read(min(_BLOCK, left))):
            digest.update(block)
            left -= len(block)
    return digest.hexdigest()


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


def with_goal(
    goals: tuple[tuple[int, Place], ...], goal: Place, since_ns: int
) -> tuple[tuple[int, Place], ...]:
    """Return the goals with another one from a log time on [ns, UTC]; unchanged if it equals the last one."""
    if goals and goals[-1][1] == goal:
        return goals
    return (
        *(one for one in goals if one[0] < since_ns or one is goals[0]),
        (since_ns if goals else 0, goal),
    )
