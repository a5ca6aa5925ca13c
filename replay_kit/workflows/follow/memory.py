"""What a followed mission remembers beside its states: files, goals, what was said, which alarms were given. It outlives the process."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from replay_kit.core.atomic import atomic_file
from replay_kit.core.plan import Place
from replay_kit.workflows.follow.sources import Source

_NAME = "follow.json"
# Sentences kept for the record.
_SAID = 500


@dataclass(frozen=True, slots=True)
class Memory:
    """What a followed mission remembers.

    Attributes:
        sources: Files that were looked at, by path.
        goals: The goals so far, each with the time of the log from which on it holds [ns, UTC]; the first from the beginning.
        said: What was reported of the inputs, in order.
        given: Alarms that were given.
        forecast: The forecast's files with their hashes; empty before the first replay.
        archives: Number of results that were kept when the forecast was replaced.
        region: The part of the forecast that the first replay found, as JSON of its record or of null; empty before it. It stays: the
            states belong to it.
    """

    sources: Mapping[Path, Source] = field(default_factory=dict)
    goals: tuple[tuple[int, Place], ...] = ()
    said: tuple[str, ...] = ()
    given: tuple[str, ...] = ()
    forecast: str = ""
    archives: int = 0
    region: str = ""

    @property
    def used(self) -> tuple[Path, ...]:
        """The files that are used, in the order in which they were looked at."""
        return tuple(path for path, source in self.sources.items() if not source.aside)


def read_memory(folder: Path) -> Memory:
    """Return what is remembered in a folder; nothing where nothing, or nothing that can be read, is there."""
    try:
        held: dict[str, Any] = json.loads((folder / _NAME).read_text(encoding="utf-8"))
        sources = [
            Source(
                Path(one["path"]),
                tuple(one["stamp"]),
                one["sha256"],
                one["mission"],
                one["first_ns"],
                one["aside"],
            )
            for one in held["sources"]
        ]
        goals = tuple((int(since), Place(*place)) for since, place in held["goals"])
        texts = tuple(map(str, held["said"])), tuple(map(str, held["given"]))
        return Memory(
            {source.path: source for source in sources},
            goals,
            *texts,
            str(held["forecast"]),
            int(held["archives"]),
            str(held["region"]),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return Memory()


def write_memory(folder: Path, memory: Memory) -> None:
    """Write what is to be remembered, whole or not at all."""
    sources = [
        {
            "path": str(source.path),
            "stamp": list(source.stamp),
            "sha256": source.sha256,
            "mission": source.mission,
            "first_ns": source.first_ns,
            "aside": source.aside,
        }
        for source in memory.sources.values()
    ]
    goals = [
        [since, [place.longitude, place.latitude, place.depth]] for since, place in memory.goals
    ]
    held: dict[str, Any] = {
        "sources": sources,
        "goals": goals,
        "said": list(memory.said[-_SAID:]),
        "given": list(memory.given),
    }
    held |= {"forecast": memory.forecast, "archives": memory.archives, "region": memory.region}
    with atomic_file(folder / _NAME) as file:
        file.write(json.dumps(held, indent=1).encode())
