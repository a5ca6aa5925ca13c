"""A TOML file as tables, whatever its bytes are."""

import re
import tomllib
from pathlib import Path
from typing import Any

from replay_kit.core.errors import ConfigError

# A configuration has some kB; tomllib takes a hundred times the memory of its file.
_LARGEST = 1 << 18


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a file.

    Raises:
        ConfigError: The file is missing, too large, or no TOML.
    """
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the configuration: {error.strerror}") from error
    if len(data) > _LARGEST:
        raise ConfigError(
            f"{path}: expected a configuration of at most {_LARGEST} bytes, it has more; is it the right file?"
        )
    # tomllib lets through what Python says of numbers and nesting that are too long
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: {_explain(error, data)}") from error


def _explain(error: ValueError | RecursionError, data: bytes) -> str:
    """Return why bytes are not TOML; of a key or a table that stands twice its name and line."""
    if place := re.fullmatch(
        r"Cannot (?:overwrite a value|declare .* twice) \(at line (\d+), column \d+\)", str(error)
    ):
        line = data.decode("utf-8").splitlines()[int(place[1]) - 1].strip()
        what = (
            f"the table {line}"
            if line.startswith("[")
            else f"the key '{line.partition('=')[0].strip()}'"
        )
        return f"line {place[1]}: {what} stands twice; keep one"
    if isinstance(error, RecursionError):
        return "not TOML: its values are nested too deeply"
    return f"not TOML: {str(error)[:200]}"
