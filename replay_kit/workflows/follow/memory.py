"""What a followed mission remembers beside its states: files, goals, what was said, which alarms were given. It outlives the process."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from pydantic import TypeAdapter

from replay_kit.core.plan import Place
from replay_kit.core.sealed import Kind, read_store, unusable, write_store
from replay_kit.workflows.follow.sources import Source

_NAME = "mission"
_KIND = Kind("memory of a followed mission", 1, "delete its folder to begin anew")
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


_FORM = TypeAdapter(Memory)


def read_memory(folder: Path) -> Memory:
    """Return what is remembered in a folder; nothing where nothing is there.

    Raises:
        LogError: It cannot be used: without the goals and the forecast so far the result would be another.
    """
    if not (folder / _NAME).exists():
        return Memory()
    _, (body,) = read_store(folder / _NAME, _KIND)
    try:
        return _FORM.validate_json(bytes(body))
    except ValueError as error:
        raise unusable(folder / _NAME, _KIND, error) from error


def write_memory(folder: Path, memory: Memory) -> None:
    """Write what is to be remembered, whole or not at all."""
    held = replace(memory, said=memory.said[-_SAID:])
    write_store(folder / _NAME, _KIND, {}, [_FORM.dump_json(held)])
