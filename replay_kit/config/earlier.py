"""Settings of earlier versions: what is written today in their place, and configurations recorded in results."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from replay_kit.core.errors import ConfigError

# Keys of the table [trust], which is [gating] since version 0.2.0.
_RENAMED = {"watch": "inflate", "watch_profiles": "inflation_profiles"}
# Keys that are no more, by table: the value that changed nothing, and what to write for another.
_REMOVED = {
    "measurements": {
        "use_dac": ("true", 'without = ["dac"] leaves depth-averaged currents out'),
        "drift_depth": ("0.5", "drift is that of the current at 0.5 m"),
    },
    "forecast": {"level_step": ("1", "name the levels, as in levels = [0, 100, 300]")},
    "gating": {
        "soften_factor": (
            "2.0",
            "a softened profile moves the estimate by two prior standard deviations",
        )
    },
    "planner": {"flight_model": ("false", "a script plans with Glider(flight=fit_flight(...))")},
}


def refuse_earlier(tables: Mapping[str, Any], path: Path | None) -> None:
    """Refuse a configuration that has tables or keys of an earlier version.

    Args:
        tables: As in the file.
        path: The file, for the message.

    Raises:
        ConfigError: It has one; the message says what to write instead.
    """
    if "trust" in tables:
        keys = ", ".join(f"{old} is {new}" for old, new in _RENAMED.items())
        raise ConfigError(
            f"{path}: the table [trust] is now called [gating], and of its keys {keys}; rename them"
        )
    for name, removed in _REMOVED.items():
        table: Any = tables
        for part in name.split("."):
            table = table.get(part, {}) if isinstance(table, Mapping) else {}
        for key, (_, instead) in removed.items():
            if isinstance(table, Mapping) and key in table:
                raise ConfigError(f"{path}: [{name}] has no {key} any more: {instead}")


def with_current_keys(toml: str) -> str:
    """Return a result's configuration, as TOML, with tables and keys by their current names.

    A key that is no more is left out where it had the value that changed nothing; with another value it stays, and is refused when
    the configuration is read.
    """
    tables = re.split(r"(?m)^(?=\[)", toml)
    return "".join(_current(table) for table in tables)


def _current(table: str) -> str:
    """Return a table, as TOML with its heading, with current names."""
    if table.startswith("[trust]\n"):
        table = re.sub(r"(?m)^\w+(?= =)", lambda key: _RENAMED.get(key[0], key[0]), table).replace(
            "[trust]", "[gating]", 1
        )
    name = table.partition("]")[0].removeprefix("[")
    for key, (value, _) in _REMOVED.get(name, {}).items():
        table = re.sub(rf"(?m)^{key} = {re.escape(value)}\n", "", table)
    return table
