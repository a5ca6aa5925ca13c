"""Missions of a fleet: the table, its entries, and their jobs with absolute paths, checked before the first begins."""

import glob
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from replay_kit.config.file import Section, explain, read_toml
from replay_kit.config.run import RunConfig, laid_over, load_config
from replay_kit.core.errors import ConfigError, LogError, ReplayKitError
from replay_kit.core.files.paths import Address, check_paths, path_of
from replay_kit.core.plan import Place
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle
from replay_kit.workflows.replay.inputs.provenance import with_bathymetry


def _several(value: object) -> object:
    """Return a single text as a list."""
    return [value] if isinstance(value, str) else value


_Files = Annotated[tuple[str, ...], BeforeValidator(_several), Field(min_length=1)]


class MissionEntry(Section):
    """``[[mission]]``, or ``[all]`` with defaults for all missions."""

    name: Annotated[str, Field(pattern=r"^[\w][\w. -]*$")] | None = Field(
        default=None,
        description="Name of the result. Default: that of the first log, without its ending.",
    )
    logs: _Files | None = Field(default=None, description="Logs of one mission.")
    vehicles: Annotated[Mapping[str, _Files], Field(min_length=2)] | None = Field(
        default=None, description="Logs of several vehicles that share an estimate, by their names."
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
    """Complete table of a fleet."""

    all: MissionEntry = Field(
        default_factory=MissionEntry, description="What all missions have unless they state it."
    )
    mission: tuple[MissionEntry, ...] = Field(min_length=1, description="The missions.")

    @model_validator(mode="after")
    def _checked_logs(self) -> Self:
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
    """Return the fleet table of a TOML file.

    Raises:
        ConfigError: The file is missing or no TOML, or a key or value is wrong.
    """
    try:
        return FleetTable.model_validate(read_toml(path))
    except ValidationError as error:
        raise ConfigError(explain(error, FleetTable, path, {})) from error


@dataclass(frozen=True, slots=True)
class Mission:
    """Mission of a fleet: one replay.

    Attributes:
        name: Unique name, and prefix of its files.
        job: Inputs, as absolute paths, and the result.
        config: Settings.
    """

    name: str
    job: ReplayJob
    config: RunConfig

    @property
    def result(self) -> Path:
        """File of the result."""
        assert self.job.out is not None
        return self.job.out

    @property
    def record(self) -> Path:
        """JSON answer of the replay, with the hashes of its inputs and its result; written once the result is complete."""
        return self.result.with_suffix(".json")

    @property
    def files(self) -> tuple[Path, ...]:
        """All files read.

        Raises:
            ReplayKitError: A file is missing.
        """
        bathymetry = filter(None, [self.config.planner.bathymetry_path])
        return (*self.job.log_files, *self.job.forecasts, *bathymetry)


def missions_of(
    table: FleetTable, folder: Path, config: Path | None, out: Path
) -> tuple[Mission, ...]:
    """Return the missions of a table.

    Args:
        table: The table.
        folder: Base of relative paths in it.
        config: File of settings for missions that name none.
        out: Folder of the results.

    Raises:
        ConfigError: A setting is wrong, two results share a name, or a mission has no ensemble.
        LogError: No log matches a pattern.
    """
    names: dict[str, Mission] = {}
    for entry in (_completed(entry, table.all) for entry in table.mission):
        settings = _config(entry, folder, config)
        for name, vehicles in _vehicles(entry, folder):
            mission = Mission(name, _job(entry, name, vehicles, folder, out.absolute()), settings)
            # file systems that ignore case would have one file for both
            if (other := names.setdefault(name.casefold(), mission)) is not mission:
                first, second = (str(each.job.logs[0]) for each in (other, mission))
                raise ConfigError(
                    f"{name}: two missions have this name, those of {first} and {second}; give one of them another name"
                )
    return tuple(names.values())


def check_missions(missions: Sequence[Mission], overwrite: bool, resume: bool) -> None:
    """Raise an error unless every input exists and every result may be written.

    Args:
        missions: All missions.
        overwrite: Whether existing results are replaced.
        resume: Whether existing results of the same inputs are kept.

    Raises:
        ConfigError: An input is missing, or a result may not be written.
    """
    for mission in missions:
        try:
            for path in mission.files:
                if not path.exists():
                    raise LogError(f"{path}: file not found; correct its name")
            check_paths(mission.files, (mission.result, mission.record), overwrite or resume)
        except ReplayKitError as error:
            raise ConfigError(f"{mission.name}: cannot begin: {error}") from error


def _completed(entry: MissionEntry, common: MissionEntry) -> MissionEntry:
    """Return an entry completed with the common values."""
    filled = {
        name: getattr(common, name)
        for name in type(entry).model_fields
        if getattr(entry, name) is None
    }
    return entry.model_copy(
        update=filled | {"settings": laid_over(common.settings, entry.settings)}
    )


def _config(entry: MissionEntry, folder: Path, config: Path | None) -> RunConfig:
    try:
        settings = load_config(
            config if entry.config is None else folder / entry.config, entry.settings
        )
    except ConfigError as error:
        raise ConfigError(
            f"mission {entry.name or (entry.logs or entry.each or ('',))[0]}: {error}"
        ) from error
    bathymetry = settings.planner.bathymetry_path
    # workers may be in another folder
    return settings if bathymetry is None else with_bathymetry(settings, bathymetry.absolute())


def _vehicles(entry: MissionEntry, folder: Path) -> Iterator[tuple[str, tuple[Vehicle, ...]]]:
    """Yield the name and the vehicles with their logs of each mission of an entry; a single vehicle has no name."""
    given = entry.vehicles or ({} if entry.logs is None else {"": entry.logs})
    vehicles = tuple(
        Vehicle(name, tuple((folder / log).absolute() for log in logs))
        for name, logs in given.items()
    )
    if vehicles:
        yield entry.name or "-".join(given) or vehicles[0].logs[0].stem, vehicles
    found = {
        pattern: sorted(glob.glob(str((folder / pattern).absolute())))
        for pattern in entry.each or ()
    }
    for path in map(Path, chain.from_iterable(found.values())):
        yield path.stem, (Vehicle("", (path,)),)
    if without := [pattern for pattern, paths in found.items() if not paths]:
        raise LogError(
            f"{', '.join(without)}: no log has such a name in {folder.absolute()}; correct the pattern"
        )


def _source(folder: Path, text: str) -> Path:
    """Return a file or an address in a table."""
    path = path_of(text)
    return path if isinstance(path, Address) else (folder / path).absolute()


def _job(
    entry: MissionEntry, name: str, vehicles: tuple[Vehicle, ...], folder: Path, out: Path
) -> ReplayJob:
    if entry.ensemble is None:
        raise ConfigError(
            f"{name}: no ensemble is given; name it in [all], in the mission, or with --ensemble"
        )
    truth = None
    if entry.truth is not None:
        path, mark, member = entry.truth.partition("#")
        truth = f"{(folder / path).absolute()}{mark}{member}"
    return ReplayJob(
        tuple(log for vehicle in vehicles for log in vehicle.logs),
        tuple(_source(folder, text) for text in entry.ensemble),
        out / f"{name}.mcap",
        goal=None if entry.goal is None else Place(*entry.goal),
        truth=truth,
        vehicles=vehicles if len(vehicles) > 1 else (),
    )
