"""The model of a table of settings."""

from typing import Any

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A table of settings."""

    # built when first used: a command's help needs the fields alone
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

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
