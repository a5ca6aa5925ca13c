"""Logs, read and written: the rows of each format."""

from typing import Any

from tests.benchmarks import logs_large, logs_mavlink, logs_mcap


def rows(tiny: bool) -> list[dict[str, Any]]:
    """The rows of the formats."""
    return [row for module in (logs_mavlink, logs_mcap, logs_large) for row in module.rows(tiny)]
