"""Checks of options that several studies have."""

import math
from collections.abc import Collection, Sequence

from replay_kit.core.errors import ConfigError


def check_names(option: str, chosen: Sequence[str], known: Collection[str]) -> None:
    """Raise ConfigError unless some known names are chosen, each once.

    Args:
        option: That they come from.
        chosen: As given.
        known: All there are.
    """
    if not chosen or not set(chosen) <= set(known) or len(set(chosen)) < len(chosen):
        raise ConfigError(
            f"{option}: expected some of {', '.join(known)}, each once, got {', '.join(chosen) or 'none'}"
        )


def check_positive(**options: float) -> None:
    """Raise ConfigError unless every option, by its name without dashes, is a finite number above 0."""
    for name, value in options.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigError(f"--{name}: expected a finite number above 0, got {value:g}")


def check_not_negative(**options: float) -> None:
    """Raise ConfigError unless every option, by its name without dashes, is a finite number of at least 0."""
    for name, value in options.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ConfigError(f"--{name}: expected a finite number of at least 0, got {value:g}")


def check_counts(pings: Sequence[int]) -> None:
    """Raise ConfigError unless the numbers of pings at which estimates are scored increase from at least 1."""
    if not pings or min(pings) < 1 or list(pings) != sorted(set(pings)):
        raise ConfigError(
            f"--pings: expected increasing numbers of at least 1, got {', '.join(map(str, pings)) or 'none'}"
        )
