"""The run's configuration: frozen, nested, every default visible here, an unknown key is an error.

One TOML file holds it; each table is one class below. Command-line options override the file.
"""

import re
import tomllib
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_serializer, field_validator, model_validator

from replay_kit.config.gating import RENAMED_KEYS, GatingConfig
from replay_kit.config.mapping import TopicMap
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.quality import QualityConfig
from replay_kit.config.time import TimeConfig
from replay_kit.core.errors import ConfigError

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_NS = 2**63 - 1


def parse_time(text: str) -> int:
    """Return a time [ns, UTC] written in ISO 8601; without an offset it is UTC, with one it is converted.

    Raises:
        ConfigError: The text is no such time, or lies outside 1970..2262, the years that 64 bits of nanoseconds hold.
    """
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError as error:
        raise ConfigError(f"'{text}' is no time; write ISO 8601 UTC such as 2018-11-16T00:00:00Z") from error
    # a time with an offset is moved by hand, as datetime itself fails on those that leave its years 1..9999
    offset = moment.utcoffset() or timedelta(0)
    since = moment.replace(tzinfo=UTC) - _EPOCH - offset
    # datetime ends at microseconds; logs are stamped in nanoseconds
    digits = re.search(r"[.,]\d{6}(\d{1,3})", text)
    time_ns = since // timedelta(microseconds=1) * 1000 + (int(digits[1].ljust(3, "0")) if digits else 0)
    if not 0 <= time_ns <= _LAST_NS:
        raise ConfigError(f"'{text}' is outside 1970..2262; write a time of the mission such as 2018-11-16T00:00:00Z")
    return time_ns


def _checked_time(text: str) -> str:
    try:
        parse_time(text)
    except ConfigError as error:
        # the kind of error that pydantic gathers and names the key of
        raise ValueError(str(error)) from error
    return text


_Time = Annotated[str, AfterValidator(_checked_time)]
_Depth = Annotated[float, Field(ge=0.0)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class LogConfig(_Section):
    """``[logs]``: how logs are read."""

    clock: Literal["log", "publish", "header"] = Field(default="log", description="which stamp orders the replay")
    system: int | None = Field(default=None, ge=0, le=255, description="MAVLink system to read; a log with positions of several needs it")
    start: _Time | None = Field(default=None, description="first time used, ISO 8601 UTC")
    end: _Time | None = Field(default=None, description="last time used, ISO 8601 UTC")
    reorder_window: float = Field(default=1.0, ge=0.0, description="s; messages later than this are counted as late and left out")
    remap: dict[str, str] = Field(default_factory=dict, description="topics to call by another name, old = new")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.start_ns is not None and self.end_ns is not None and self.start_ns > self.end_ns:
            raise ValueError(f"start {self.start} is after end {self.end}; give them in order")
        return self

    @property
    def start_ns(self) -> int | None:
        """First time used [ns, UTC]; None for no limit."""
        return None if self.start is None else parse_time(self.start)

    @property
    def end_ns(self) -> int | None:
        """Last time used [ns, UTC]; None for no limit."""
        return None if self.end is None else parse_time(self.end)


class MeasurementConfig(_Section):
    """``[measurements]``: how messages become observations."""

    position_max_age: float = Field(default=600.0, gt=0.0, description="s; a ping farther than this from any fix is not used")
    surface_depth: float = Field(default=3.0, gt=0.0, description="m; shallower than this the vehicle is at the surface")
    velocity_std: float = Field(default=0.09, gt=0.0, description="m/s; error of a bin whose message states none")
    reference: Literal["earth", "platform"] | None = Field(
        default=None, description="what profiles are relative to whose message does not say so; without it they are not used"
    )
    use_relative: bool = Field(default=True, description="whether profiles are used that nothing makes absolute, for their shear")
    use_dac: bool = Field(default=True, description="whether dives' depth-averaged currents are used")
    use_inverted: bool = Field(
        default=True,
        description="whether profiles that were computed from a dive's pings and mean current are used instead of these",
    )
    dead_reckoning: Literal["corrected", "through_water"] = Field(
        default="corrected",
        description="through_water: it knows of no current, and gives the mean one of dives whose log states none",
    )
    dac_std: float = Field(default=0.02, gt=0.0, description="m/s; error of a dive's mean current that states none, beside its fixes'")
    use_drift: bool = Field(
        default=False, description="whether the way between fixes at the surface counts as the current's; not for vehicles under power"
    )
    drift_std: float = Field(default=0.07, gt=0.0, description="m/s; error of such a drift, the wind's, beside its fixes'")
    water_track_distance: Annotated[float, Field(ge=0.0)] | None = Field(
        default=None, description="m below the vehicle; where the layer of a DVL's water track is, which its message does not say"
    )
    drift_depth: float = Field(default=0.5, ge=0.0, description="m; where the current that drifts the vehicle is")
    fix_std: float = Field(default=20.0, gt=0.0, description="m; error of each component of a fix, in mean currents between fixes")
    correlation_depth: float = Field(
        default=0.0, ge=0.0, description="m; e-folding distance of the correlation of a ping's own errors, where it states none"
    )
    map: tuple[TopicMap, ...] = Field(default=(), description="how to read topics that no known kind covers; replay-kit info --suggest")
    max_speed: float = Field(default=5.0, gt=0.0, description="m/s; a bin with a faster component is not used")
    magnetic_declination: Annotated[float, Field(ge=-180.0, le=180.0)] | None = Field(
        default=None, description="degrees east; for pings whose heading is magnetic and that state none"
    )
    quality: QualityConfig = QualityConfig()


class ForecastConfig(_Section):
    """``[forecast]``: which part of the ensemble is used."""

    region: tuple[float, float, float, float] | None = Field(default=None, description="west, south, east, north [degrees]")
    levels: tuple[_Depth, ...] | None = Field(default=None, description="m; the nearest levels are taken")
    level_step: int = Field(default=1, ge=1, description="every n-th level is used")
    lead: float | None = Field(
        default=None,
        description="forecast period in the file's unit; the nearest is taken. Default: all dated leads where the estimate goes through "
        "time, else the dated lead nearest to the log's first message; the last lead without a log, or where leads have no date",
    )
    time: _Time | None = Field(
        default=None,
        description="ISO 8601 UTC; the nearest time is taken. Default: all times where the estimate goes through time, else the time "
        "nearest to the log's first message; the first time without a log",
    )
    reference_time: _Time | None = Field(default=None, description="ISO 8601 UTC, for a file of leads that has none")
    place: bool = Field(default=False, description="move the ensemble's centre to the mean fix of the log")


class EstimatorConfig(_Section):
    """``[estimator]``: the basis, the prior and the error model; ``None`` means the preset's own value."""

    name: str = Field(default="reduced_basis", description="the project's own, or a baseline: naive3d, nearest, etkf, ...")
    preset: Literal["default", "paper"] = "default"
    modes: int | None = Field(default=300, ge=1, description="basis flows a level; fewer when fewer exist; 'all' for all")
    speed: float | None = Field(
        default=None, gt=0.0, description="m/s, the kernel's amplitude mu; default the RMS component speed of the first level"
    )
    length_horizontal: float | None = Field(default=None, gt=0.0, description="m; default two cells, paper 10 km")
    length_vertical: float = Field(default=100.0, gt=0.0, description="m; paper only")
    nugget: float = Field(default=1e-6, ge=0.0, description="of the kernel's largest eigenvalue; default only")
    sample_share: float | None = Field(
        default=None,
        ge=0.0,
        le=1.0,
        description="of the sample covariance in the prior; the localised one has the rest; default: fitted by leaving members out",
    )
    shift_distance: float | None = Field(
        default=None, ge=0.0, description="m, of the members' shifted copies, 0 for none; default one correlation length; default only"
    )
    localisation_radius: float | None = Field(
        default=None, gt=0.0, description="m, where the taper ends; default 6.5 correlation lengths; default only"
    )
    representation_error_std: float | None = Field(default=None, ge=0.0, description="m/s; None: from what the truncated basis leaves out")
    paper_error_std: float = Field(default=0.12, gt=0.0, description="m/s; error of every bin under the paper preset")

    @field_validator("modes", mode="before")
    @classmethod
    def _all_is_none(cls, value: object) -> object:
        return None if value == "all" else value

    @field_serializer("modes")
    def _none_is_all(self, value: int | None) -> int | str:
        """Write None as the word, so that recorded settings, which leave out what is None, read back as they were."""
        return "all" if value is None else value


class OutputConfig(_Section):
    """``[output]``: what is published, and how often."""

    depths: tuple[_Depth, ...] | None = Field(default=None, description="m; depth slices published; three levels by default")
    interval: float = Field(default=21600.0, gt=0.0, description="s of log time between published grids")
    checkpoint_interval: float = Field(default=3600.0, gt=0.0, description="s of log time between checkpoints")
    threads: int = Field(default=1, ge=1, description="BLAS threads; other counts give other last bits")


class RunConfig(_Section):
    """All of a run's settings."""

    logs: LogConfig = LogConfig()
    measurements: MeasurementConfig = MeasurementConfig()
    forecast: ForecastConfig = ForecastConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    time: TimeConfig = TimeConfig()
    gating: GatingConfig = GatingConfig()
    planner: PlannerConfig = PlannerConfig()
    output: OutputConfig = OutputConfig()


def load_config(path: Path | None, overrides: Mapping[str, Mapping[str, Any]] | None = None) -> RunConfig:
    """Return the configuration of a TOML file with command-line options laid over it.

    Args:
        path: The TOML file; None for the defaults.
        overrides: Section name to option values; values of None are not options.

    Raises:
        ConfigError: The file is missing or no TOML, or a key or value is wrong.
    """
    tables: dict[str, Any] = {}
    if path is not None:
        try:
            tables = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"{path}: cannot read the configuration: {error.strerror}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path}: not TOML: {error}") from error
    if "trust" in tables:
        keys = ", ".join(f"{old} is {new}" for old, new in RENAMED_KEYS.items())
        raise ConfigError(f"{path}: the table [trust] is now called [gating], and of its keys {keys}; rename them")
    for section, values in (overrides or {}).items():
        given = {key: value for key, value in values.items() if value is not None}
        if given:
            table = tables.get(section, {})
            tables[section] = {**table, **given} if isinstance(table, dict) else given
    try:
        return RunConfig.model_validate(tables)
    except ValidationError as error:
        raise ConfigError(f"{path or 'options'}: {_explain(error)}") from error


def _explain(error: ValidationError) -> str:
    lines = []
    for item in error.errors():
        key = ".".join(str(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            known = sorted(_known_keys(item["loc"][:-1]))
            lines.append(f"unknown key '{key}'; known here: {', '.join(known)}")
        else:
            lines.append(f"'{key}': {item['msg'].removeprefix('Value error, ')}, got {item['input']!r}")
    return "; ".join(lines)


def _known_keys(location: tuple[int | str, ...]) -> list[str]:
    """Return the keys known at a place: of a section, or of an entry of a list whose kind is stated."""
    model: type[BaseModel] = RunConfig
    for part in location:
        if isinstance(part, int) or part not in model.model_fields:
            continue
        found = [kind for kind in _models_in(model.model_fields[part].annotation) if _is_kind(kind, location)]
        if not found:
            break
        model = found[0]
    return list(model.model_fields)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]


def _is_kind(model: type[BaseModel], location: tuple[int | str, ...]) -> bool:
    """Return whether a model is what a place in the configuration says: pydantic names an entry's kind in the place."""
    kinds = get_args(model.model_fields["kind"].annotation) if "kind" in model.model_fields else ()
    return len(kinds) != 1 or kinds[0] in location
