"""Logs, read and written: the rows of each format that has some."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

_FORMATS = ("logs_mcap", "logs_replay", "logs_mavlink")


def rows(tiny: bool) -> list[dict[str, Any]]:
    """The rows of the formats."""
    modules = [import_module(f"tests.benchmarks.{name}") for name in _FORMATS if find_spec(f"tests.benchmarks.{name}")]
    return [row for module in modules for row in module.rows(tiny)]
