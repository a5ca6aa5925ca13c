"""The table of a fleet: which logs are replayed with which ensemble and settings, a mission an entry."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from replay_kit.config.file import explain, read_toml
from replay_kit.config.section import Section
from replay_kit.core.errors import ConfigError


def _several(value: object) -> object:
    """Return one text as a list of it."""
    return [value] if isinstance(value, str) else value


_Files = Annotated[tuple[str, ...], BeforeValidator(_several), Field(min_length=1)]


class MissionEntry(Section):
    """``[[mission]]``, or ``[all]`` with what all missions have unless they state it themselves."""

    name: Annotated[str, Field(pattern=r"^[\w][\w. -]*$")] | None = Field(
        default=None,
        description="Name of the result. Default: that of the first log, without its ending.",
    )
    logs: _Files | None = Field(default=None, description="Logs of one mission.")
    vehicles: Annotated[Mapping[str, _Files], Field(min_length=2)] | None = Field(
        default=None,
        description="Logs of several vehicles that share an estimate, by their names.",
    )
    each: _Files | None = Field(
        default=None, description="Patterns of logs, each of which is a mission of its own."
    )
    ensemble: _Files | None = Field(
        default=None, description="Ensemble forecast: files, stores, folders or patterns."
    )
    goal: tuple[float, float, float] | None = Field(
        default=None, description="Longitude, latitude [degrees], depth [m] to plan for."
    )
    truth: str | None = Field(
        default=None, description="Known truth to score against, FILE or FILE#member."
    )
    config: str | None = Field(default=None, description="File of settings.")
    settings: Mapping[str, Any] = Field(
        default_factory=dict, description="Settings over those of the file, as tables."
    )


class FleetTable(Section):
    """The whole table."""

    all: MissionEntry = Field(
        default_factory=MissionEntry, description="What all missions have unless they state it."
    )
    mission: tuple[MissionEntry, ...] = Field(min_length=1, description="The missions.")

    @model_validator(mode="after")
    def _of_logs(self) -> Self:
        for number, entry in enumerate(self.mission, start=1):
            if sum(given is not None for given in (entry.logs, entry.vehicles, entry.each)) != 1:
                raise ValueError(f"mission {number}: expected one of logs, vehicles and each")
            if entry.each is not None and entry.name is not None:
                raise ValueError(
                    f"mission {number}: each log of 'each' has its own name; leave name {entry.name} out"
                )
        if self.all.name or self.all.logs or self.all.vehicles or self.all.each:
            raise ValueError("[all] has no name, logs, vehicles or each; these are a mission's own")
        return self


def load_fleet(path: Path) -> FleetTable:
    """Return the table of a TOML file.

    Raises:
        ConfigError: The file is missing or no TOML, or a key or value is wrong.
    """
    try:
        return FleetTable.model_validate(read_toml(path))
    except ValidationError as error:
        raise ConfigError(explain(error, FleetTable, path, {})) from error
