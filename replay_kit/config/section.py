"""The model of a table of settings."""

import re
from typing import Any

from pydantic import BaseModel, ConfigDict, model_validator

from replay_kit.core.time import parse_duration

_UNIT = re.compile(r"\[(s|min|h|d)\]")
_DURATION = re.compile(r"\s*\d+(\.\d*)?\s*(s|min|h|d)\s*")


def in_unit(value: object, description: str) -> object:
    """Return a duration, such as 36h, in the unit that a description states in brackets; anything else as it is."""
    unit = _UNIT.search(description)
    if unit and isinstance(value, str) and _DURATION.fullmatch(value):
        return parse_duration(value) / parse_duration(f"1{unit[1]}")
    return value


class Section(BaseModel):
    """A table of settings."""

    # built when first used: a command's help needs the fields alone
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _in_units(cls, given: object) -> object:
        """Return settings with durations, such as 36h, in the units that their descriptions state."""
        if not isinstance(given, dict):
            return given
        return {name: cls._in_unit(name, value) for name, value in given.items()}

    @classmethod
    def _in_unit(cls, name: str, value: object) -> object:
        setting = cls.model_fields.get(name)
        return in_unit(value, setting.description or "") if setting else value

    def __str__(self) -> str:
        """Return the same as ``repr``."""
        return repr(self)

    def __repr_args__(self) -> list[tuple[str | None, Any]]:
        """Return the settings that are not the defaults: a whole configuration has some two hundred."""
        defaults = {
            name: field.get_default(call_default_factory=True)
            for name, field in type(self).model_fields.items()
        }
        return [
            (name, getattr(self, name))
            for name in defaults
            if getattr(self, name) != defaults[name]
        ]
