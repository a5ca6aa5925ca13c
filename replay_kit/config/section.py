"""The model of a table of settings."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A table of settings."""

    # built when first used: a command's help needs the fields alone
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)
