"""Provenance of a result: input hashes, versions, region, configuration."""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

from replay_kit.config.run import RunConfig
from replay_kit.core import __version__
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.inputs import Stamp, open_input, stamps_of
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place
from replay_kit.forecast import ensemble_files, find_sources
from replay_kit.forecast.remote.kept import record_of
from replay_kit.logs.reader import LogFile
from replay_kit.results.losses import iso_time
from replay_kit.results.reader import VEHICLES_RECORD, VehicleRecord, vehicle_records
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.region import REGION_RECORD

_BLOCK = 1 << 20
#: Begin the keys of the files of competing forecasts among the inputs.
RIVAL = "against"
#: Key of the bathymetry among the inputs.
BATHYMETRY = "bathymetry"
#: Option of a result that names the parts that a script gave, without which it cannot be made again.
PROVIDED = "provided"
#: Record of the result of ``plan``: what was asked for.
PLAN_RECORD = "replay_kit.plan"
#: Record of a result whose logs may grow: what happened to its inputs.
FOLLOWED = "replay_kit.followed"
_PACKAGES = ("numpy", "scipy", "casadi", "pyproj", "foxglove-sdk", "mcap", "pymavlink")


def input_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or of all files of a store in the order of their names; computed once for equal stamps.

    Missions of a fleet share forecasts of gigabytes, and a mission that is followed is replayed with the same one.
    """
    parts = _parts(path)
    return _known_hash(parts, tuple(stamps_of(parts).values()))


def _parts(path: Path) -> tuple[Path, ...]:
    return (*sorted(p for p in path.rglob("*") if p.is_file()),) if path.is_dir() else (path,)


@lru_cache(maxsize=256)
def _known_hash(parts: tuple[Path, ...], stamps: tuple[Stamp, ...]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        with open_input(part) as stream:
            while block := stream.read(_BLOCK):
                digest.update(block)
    return digest.hexdigest()


def named_hash(path: Path) -> str:
    """Return the name of an input and its SHA-256, as results record them."""
    return f"{path.name} sha256:{input_hash(path)}"


def run_metadata(
    job: ReplayJob,
    forecasts: Forecasts,
    readers: Iterable[LogFile],
    options: Mapping[str, str],
    bathymetry: Path | None = None,
) -> dict[str, Mapping[str, str]]:
    """Return the metadata records of a result; names without folders, so that the bytes do not depend on the place.

    Args:
        job: The run; its logs are hashed.
        forecasts: Forecast read.
        readers: Its logs, opened, whose notes are recorded.
        options: Options of the run apart from its configuration.
        bathymetry: Bathymetry file; None without one.

    Raises:
        ConfigError: Two logs hold the same bytes.
    """
    ensemble, hashes = forecasts.ensemble, dict[str, Path]()
    for path in job.logs:
        if (other := hashes.setdefault(input_hash(path), path)) is not path:
            raise ConfigError(f"{path}: identical to {other}; remove one")
    grid, arguments = ensemble.grid, find_sources(job.ensemble).arguments
    files = _keyed("ensemble", [path for argument in arguments for path in argument])
    if ensemble.made_from == "models":
        files = {
            f"ensemble{number}_{i}": path
            for number, argument in enumerate(arguments)
            for i, path in enumerate(argument)
        }
    fetched = {
        key: json.dumps(record, sort_keys=True)
        for key, path in files.items()
        if (record := record_of(path))
    }
    named = {f"log{i}": path for i, path in enumerate(job.logs)} | files
    if bathymetry is not None:
        named[BATHYMETRY] = bathymetry
    for number, each in enumerate(job.against):
        named |= _keyed(f"{RIVAL}{number}", ensemble_files(each), "_")
    reports = {Path(log.path).name: log.report().notes for log in readers}
    records = {
        "replay_kit.inputs": {key: named_hash(path) for key, path in named.items()},
        "replay_kit.fetched": fetched,
        "replay_kit.options": options,
        "replay_kit.region": {
            "projection": "azimuthal equidistant, WGS84",
            "centre_longitude": repr(grid.projection.longitude),
            "centre_latitude": repr(grid.projection.latitude),
            "levels": ", ".join(repr(float(level)) for level in grid.levels),
            "grid": " x ".join(str(n) for n in grid.east.shape),
            "members": str(ensemble.n_members),
        },
        "replay_kit.members": {str(k): label for k, label in enumerate(ensemble.members)},
        "replay_kit.versions": package_versions(),
        REGION_RECORD: {} if forecasts.region is None else forecasts.region.to_record(),
        VEHICLES_RECORD: _vehicles_record(job),
        "replay_kit.reading": {name: "; ".join(notes) for name, notes in reports.items() if notes},
        "replay_kit.forecast": _forecast_times(forecasts),
        FOLLOWED: {} if job.following is None else job.following.record,
    }
    always = "replay_kit.members", FOLLOWED if job.following is not None else ""
    return {name: record for name, record in records.items() if record or name in always}


def _keyed(key: str, files: Sequence[Path], mark: str = "") -> dict[str, Path]:
    """Return files by input key, with a mark and a number for several."""
    if len(files) == 1:
        return {key: files[0]}
    return {f"{key}{mark}{number}": path for number, path in enumerate(files)}


def _vehicles_record(job: ReplayJob) -> dict[str, str]:
    """Return the record of a job's vehicles by name: keys of their logs, and goals."""
    found, number = {}, 0
    for vehicle in job.vehicles:
        logs = () if vehicle.why_not else vehicle.logs
        keys = tuple(f"log{number + k}" for k in range(len(logs)))
        goal, number = _goal_text(vehicle.goal), number + len(logs)
        found[vehicle.name] = VehicleRecord(vehicle.name, keys, goal, vehicle.why_not).to_text()
    return found


def _goal_text(goal: Place | None) -> str:
    return "" if goal is None else f"{goal.longitude!r},{goal.latitude!r},{goal.depth!r}"


def _forecast_times(forecasts: Forecasts) -> dict[str, str]:
    """Return the first and last time of the used forecast, and whether the estimate changes in time; empty without times."""
    times = [ensemble.time_ns for ensemble in forecasts.series if ensemble.time_ns is not None]
    if not times:
        return {}
    used = times if forecasts.evolves else [forecasts.ensemble.time_ns or times[0]]
    return {
        "first": iso_time(min(used), "s"),
        "last": iso_time(max(used), "s"),
        "evolves": str(forecasts.evolves).lower(),
    }


def run_options(job: ReplayJob, flow: FlowEstimate) -> dict[str, str]:
    """Return the options of a run apart from its configuration, and its basis.

    Args:
        job: The run.
        flow: Estimate of the run.
    """
    return {
        "goal": _goal_text(job.goal),
        "include_inputs": str(job.include_inputs).lower(),
        **({PROVIDED: ", ".join(job.provided)} if job.provided else {}),
        "truth": "" if job.truth is None else Path(job.truth).name,
        "modes": str(flow.n_modes),
        "depth_functions": flow.depth_functions.kind,
        "kernel_length_east_m": repr(flow.horizontal.kernel.length_east),
        "kernel_length_north_m": repr(flow.horizontal.kernel.length_north),
        "kernel_speed": repr(flow.horizontal.kernel.speed),
    }


def lasting_records(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, Mapping[str, str]]:
    """Return the records of a result without those that change while logs grow: logs, goal, and reports on them."""
    held = {
        name: {key: value for key, value in record.items() if not key.startswith(("log", "goal"))}
        if name in ("replay_kit.inputs", "replay_kit.options")
        else record
        for name, record in metadata.items()
        if name not in ("replay_kit.reading", FOLLOWED)
    }
    # which logs there are may change, not which vehicles and goals
    goals = {one.name: one.goal for one in vehicle_records(metadata)}
    return {**held, VEHICLES_RECORD: goals} if goals else held


def package_versions() -> dict[str, str]:
    """Return the versions of this package and of those that affect the last bits of results."""
    return {"replay-kit": __version__, **{name: version(name) for name in _PACKAGES}}


def run_settings_toml(config: RunConfig) -> str:
    """Return the configuration as TOML with every value set and files by name; None is omitted, as TOML has no null."""
    lines: list[str] = []
    if (bathymetry := config.planner.bathymetry_path) is not None:
        config = with_bathymetry(config, Path(bathymetry.name))
    for section, values in config.model_dump(mode="json").items():
        lines += [
            f"[{section}]",
            *(f"{key} = {_toml(value)}" for key, value in values.items() if value is not None),
            "",
        ]
    return "\n".join(lines)


def with_bathymetry(config: RunConfig, path: Path) -> RunConfig:
    """Return a configuration with another bathymetry file."""
    return config.model_copy(
        update={"planner": config.planner.model_copy(update={"bathymetry": str(path)})}
    )


def _toml(value: object) -> str:
    if isinstance(value, bool | str):
        # TOML's escapes are those of JSON
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(
                f"{_toml(key)} = {_toml(item)}" for key, item in value.items() if item is not None
            )
            + "}"
        )
    return repr(value)
