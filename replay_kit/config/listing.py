"""The list of all settings: for the options of the command line, for what an unknown option is told, and as TOML to be edited."""

import json
import textwrap
from collections.abc import Iterator, Sequence

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError


def every_setting(
    model: type[BaseModel] = RunConfig, prefix: str = ""
) -> Iterator[tuple[str, FieldInfo]]:
    """Yield each setting with its path, such as ``planner.depth``, in the order of the tables."""
    for name, setting in model.model_fields.items():
        kind = setting.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from every_setting(kind, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", setting


def settings_named(name: str) -> list[tuple[str, str]]:
    """Return section and key of the settings of a name, which may have its section before it, as in ``planner.depth``."""
    wanted = name.replace("-", "_")
    paths = [path.rpartition(".") for path, _ in every_setting()]
    return [(section, key) for section, _, key in paths if wanted in (key, f"{section}.{key}")]


def annotated_toml(sections: Sequence[str] = ()) -> str:
    """Return the settings as TOML with their descriptions and defaults in comments, so that a line counts once it is uncommented.

    Args:
        sections: Those wanted, such as ``measurements.quality``; all when empty.

    Raises:
        ConfigError: There is no such section.
    """
    tables: dict[str, list[str]] = {}
    for path, setting in every_setting():
        section, _, key = path.rpartition(".")
        default = setting.get_default(call_default_factory=True)
        value = "" if default is None else json.dumps(default, default=str)
        about = textwrap.wrap(setting.description or "", 100, break_on_hyphens=False)
        tables.setdefault(section, []).extend(
            [*(f"# {line}" for line in about), f"#{key} = {value}"]
        )
    if unknown := [section for section in sections if section not in tables]:
        raise ConfigError(f"config: expected sections of {', '.join(tables)}, got {unknown[0]}")
    return "\n".join(
        "\n".join([f"[{section}]", *lines, ""])
        for section, lines in tables.items()
        if section in (sections or tables)
    )
