"""Settings of a result, and statistics of its plan."""

import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

from replay_kit.results.result import ResultFile
from replay_kit.results.schemas import decode


def bathymetry_name(metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Return the name of the bathymetry file, or "the bathymetry" if the result does not state it."""
    return (
        metadata.get("replay_kit.inputs", {})
        .get("bathymetry", "the bathymetry")
        .partition(" sha256:")[0]
    )


def changed_settings(config_toml: str) -> list[tuple[str, Any, Any]]:
    """Return the settings that differ from their defaults: table and key, value, default (None without one).

    Settings unknown to this version count as changed.
    """
    # an export needs no settings
    from replay_kit.config.run import RunConfig

    defaults, changed = RunConfig().model_dump(mode="json"), []
    for section, values in tomllib.loads(config_toml).items():
        known = defaults.get(section, {})
        changed += [
            (f"{section}.{key}", value, known.get(key))
            for key, value in values.items()
            if known.get(key) != value
        ]
    return changed


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each single value of nested mappings and lists with its path, such as ``by_dive.0.bins``."""
    if isinstance(value, Mapping):
        items = list(value.items())
    elif isinstance(value, list):
        items = [(str(number), item) for number, item in enumerate(value)]
    else:
        yield path, value
        return
    for key, item in items:
        yield from leaves(item, f"{path}.{key}" if path else str(key))


def plan_statistics(result: ResultFile) -> dict[str, str]:
    """Return the statistics of the last plan of a result with a plan."""
    _, data = next(result.reader.messages("/plan/controls", newest=True))
    # Any: the fields are those of the table
    plan: Any = decode("Plan", data)
    return {pair.name: pair.value for pair in plan.statistics}
