"""The run's configuration: frozen, nested, with every default here; unknown keys are errors.

One TOML file holds it; each table is one class below. Command-line options override the file.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    Field,
    ValidationError,
    field_serializer,
    field_validator,
    model_validator,
)

from replay_kit.config.estimation import ConsistencyConfig, GatingConfig, TimeConfig
from replay_kit.config.file import Count, NotNegative, Positive, Section, explain, read_toml
from replay_kit.config.mapping import TopicMap
from replay_kit.config.option import Option
from replay_kit.config.plan import PlanRequest
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.quality import QualityConfig, checked_rules
from replay_kit.core.errors import ConfigError
from replay_kit.core.words.quantities import parse_time


def _checked_time(text: str) -> str:
    try:
        parse_time(text)
    except ConfigError as error:
        # the kind of error that pydantic gathers and names the key of
        raise ValueError(str(error)) from error
    return text


#: A setting that is a time, ISO 8601 UTC.
Moment = Annotated[str, AfterValidator(_checked_time)]
#: The region that ``--region all`` stands for.
EVERYWHERE = (-180.0, -90.0, 180.0, 90.0)
_Longitude = Annotated[float, Field(ge=-180.0, le=360.0)]
_Latitude = Annotated[float, Field(ge=-90.0, le=90.0)]


class LogConfig(Section):
    """``[logs]``: how logs are read.

    Attributes:
        clock: Timestamp by which messages are ordered.
        system: MAVLink system to read; required for a log with positions of several systems.
        component: MAVLink component of the system whose positions are read; by default the first that states one.
        start: First time used, ISO 8601 UTC.
        end: Last time used, ISO 8601 UTC.
        reorder_window: Largest delay at which a message is still sorted in [s]; later messages are counted and excluded.
        remap: New names of topics, by their old names; the option may be repeated.
        columns: Columns of a table of pings that have neither the standard name nor that of the quantity; a number stands for all rows.
            The option may be repeated.
        caches: Folder with the sensor lists (.cac) of a Slocum's files, if not in cac or cache next to them or in the three folders above.
    """

    clock: Annotated[Literal["log", "publish", "header"], Option()] = "log"
    system: Annotated[Annotated[int, Field(ge=0, le=255)] | None, Option("ID")] = None
    component: Annotated[int, Field(ge=0, le=255)] | None = None
    start: Annotated[Moment | None, Option("TIME")] = None
    end: Annotated[Moment | None, Option("TIME")] = None
    reorder_window: NotNegative = 1.0
    remap: Annotated[dict[str, str], Option("OLD=NEW")] = Field(default_factory=dict)
    columns: Annotated[
        dict[
            Literal["time", "longitude", "latitude", "depth", "height", "u", "v", "error"],
            Annotated[float | str, Field(union_mode="left_to_right")],
        ],
        Option("QUANTITY=COLUMN"),
    ] = Field(default_factory=dict)
    caches: str | None = None

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


class MeasurementConfig(Section):
    """``[measurements]``: how messages become observations.

    Attributes:
        position_max_age: Longest time from a ping to the nearest fix [s]; beyond it pings are used only within a dive.
        position_max_gap: Longest time between the positions before and after a dive between which its pings are interpolated [s].
        origin: Longitude and latitude of the origin of local positions (LOCAL_POSITION_NED, odometry), for a log that states none.
        dvl_axes: Axes of a DVL's velocity; by default those that its frame_id names, else forward, starboard and down.
        surface_depth: Depth above which the vehicle is at the surface [m].
        velocity_std: Standard error of each velocity component of a bin whose message states none [m/s].
        reference: Velocity reference of profiles whose message states none; without this setting they are not used.
        use_relative: Use profiles relative to a platform of unknown velocity, for their shear.
        use_inverted: Use profiles computed from a dive's pings and depth-averaged current instead of the pings and the current.
        flight_bias: Correct depth-averaged currents for the flight-model error that earlier dives show; they are then used in
            addition to profiles computed from them.
        dead_reckoning: Whether dead-reckoned positions include a current; through_water: they do not, and give the depth-averaged current
            of dives without one in the log.
        dac_std: Standard error of a depth-averaged current that states none [m/s], in addition to that of its fixes.
        water_track_distance: Distance of the DVL's water-track layer below the vehicle [m]; its message does not state it.
        fix_std: Standard error of each component of a fix [m], for currents averaged between fixes.
        correlation_depth: E-folding distance of the correlation of the errors within a ping that states none [m].
        regional_speed: Rms speed of the region's currents [m/s], for the errors of geostrophic shear. Default: the ensemble's.
        surface_tide_std: Speed of surface tides and inertial motion absent from the forecast [m/s]: an error of radars and drifters.
            Default: 0.08.
        surface_spacing: Width of the boxes in which radar currents are averaged [m]. Default: two of the ensemble's cells.
        surface_box: West, south, east and north bound of the radar currents and drifters used [degrees]. Default: the ensemble's.
        without: Withhold measurements (data denial): dac, profiles, shear, radar, drifters, sensors, dives:3-5.
        map: How to read topics of unknown type; replay-kit info --suggest writes a draft.
        max_speed: Largest velocity component of a bin that is used [m/s].
        magnetic_declination: Declination for pings with a magnetic heading that state none [degrees east].
        velocity_unit: Override the velocity unit of pings mislabelled as m/s; also accepts implausible speeds.
    """

    position_max_age: Positive = 600.0
    position_max_gap: Positive = 86400.0
    origin: Annotated[tuple[_Longitude, _Latitude] | None, Option("LON,LAT")] = None
    dvl_axes: Literal["forward-starboard-down", "forward-left-up"] | None = None
    surface_depth: Positive = 3.0
    velocity_std: Positive = 0.09
    reference: Literal["earth", "platform"] | None = None
    use_relative: bool = True
    use_inverted: bool = True
    flight_bias: bool = True
    dead_reckoning: Annotated[Literal["corrected", "through_water"], Option()] = "corrected"
    dac_std: Positive = 0.02
    water_track_distance: NotNegative | None = None
    fix_std: Positive = 20.0
    correlation_depth: NotNegative = 0.0
    regional_speed: Positive | None = None
    surface_tide_std: NotNegative | None = None
    surface_spacing: Positive | None = None
    surface_box: tuple[float, float, float, float] | None = None
    without: Annotated[tuple[str, ...], Option("WHAT,...")] = ()
    map: tuple[TopicMap, ...] = ()
    max_speed: Positive = 5.0
    magnetic_declination: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None
    velocity_unit: Literal["m/s", "cm/s", "mm/s", "knots"] | None = None
    quality: QualityConfig = Field(default_factory=QualityConfig)

    @field_validator("without")
    @classmethod
    def _are_rules(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        checked_rules(value)
        return value


class ForecastConfig(Section):
    """``[forecast]``: members of the ensemble, and the part used.

    Attributes:
        members: Source of the members. dim[:NAME]: a position along a dimension; files[:REGEX]: a file or a label; suffix: variables such
            as
            uo_glor and uo_oras; lags: forecasts of several starts; times:15d: fields within so many days of the season; models: several
            products. Default: found from the files.
        axes: Whether velocities lie along the grid's axes or along true east and north; auto: as stated in the file.
        region: West, south, east and north bound of the part used [degrees], or all. Default: all of a small forecast, else the
            surroundings of the log and the goal.
        window_points: Largest region [points per level] that is estimated at once; in a larger one windows follow each vehicle.
            Default: a square of 14 correlation lengths.
        levels: Depth levels used [m]; the nearest are taken. Default: all.
        lead: Forecast period in the file's unit, or as a duration since the first time; the nearest is taken. Default: as --time.
        time: Time of the forecast, ISO 8601 UTC; the nearest is taken. Default: all times where the estimate changes in time, else that
            nearest to the log's start.
        reference_time: Start of the forecast, ISO 8601 UTC, for a file of leads that states none.
        place: Move the ensemble's centre to the mean fix of the log.
        offline: Use fetched forecasts only.
        max_download: Largest download of a forecast given by address [MB], before packing. Default: 1000.
        cache: Folder of fetched forecasts. Default: replay-kit in XDG_CACHE_HOME, else in .cache of the home folder.
    """

    members: Annotated[str | None, Option("RULE")] = None
    axes: Annotated[Literal["auto", "grid", "true"], Option()] = "auto"
    region: Annotated[tuple[float, float, float, float] | None, Option("W,S,E,N|all")] = None
    window_points: Annotated[int, Field(ge=100)] | None = None
    levels: Annotated[tuple[NotNegative, ...] | None, Option("Z1,Z2,...")] = None
    lead: Annotated[float | None, Option("LEAD")] = None
    time: Annotated[Moment | None, Option("TIME")] = None
    reference_time: Annotated[Moment | None, Option("TIME")] = None
    place: Annotated[bool, Option(name="--place-ensemble")] = False
    # how a forecast comes here changes no result, so results do not record it
    offline: Annotated[bool, Option()] = Field(default=False, exclude=True)
    max_download: Annotated[Positive | None, Option("MB")] = Field(default=None, exclude=True)
    cache: str | None = Field(default=None, exclude=True)

    @field_validator("region", mode="before")
    @classmethod
    def _all_is_the_earth(cls, value: object) -> object:
        # an option is split at its commas
        return EVERYWHERE if value in ("all", ["all"]) else value

    @field_validator("members")
    @classmethod
    def _is_a_rule(cls, value: str | None) -> str | None:
        if value is not None and not re.fullmatch(
            r"dim(:.+)?|files(:.+)?|suffix|lags|times:\d+(\.\d+)?d?|models", value
        ):
            raise ValueError(
                "expected dim[:NAME], files[:REGEX], suffix, lags, times:15d or models"
            )
        return value


class EstimatorConfig(Section):
    """``[estimator]``: the basis, the prior and the error model; ``None`` means the preset's own value.

    Attributes:
        name: The project's own estimator, reduced_basis, or a baseline: naive3d, nearest.
        preset: Settings of the estimator: the project's own, or exactly those of Kong et al. (IROS 2021).
        modes: Number of modes per level, fewer where fewer exist; 'all' for all.
        speed: Amplitude of the kernel [m/s]. Default: RMS component speed of the first level.
        length_horizontal: Horizontal length of the kernel [m]. Default: two cells; 10 km with the preset paper.
        length_vertical: Vertical length of the kernel [m]; preset paper only.
        nugget: Share of the kernel's largest eigenvalue added to all; preset default only.
        sample_share: Share of the sample covariance in the prior, as fit writes it. Default: fitted by leaving members out.
        mean_variance: Variance of the amplitude of the ensemble mean; 0 takes it as certain. Default: by the first profiles; 0.1
            through time or with a stated spread.
        shift_distance: Distance of the members' shifted copies [m], 0 for none, as fit writes it. Default: one correlation length, or
            half of it.
        localisation_radius: Distance at which the localisation's taper is zero [m], as fit writes it. Default: 6.5 correlation lengths.
        representation_error_std: Representation error [m/s]. Default: what the truncated basis cannot represent.
        spread: Factor on the prior's variance; fit: by the first profiles; as_given: 1. Default: fit for members made of lags, times or
            models.
        dropped_std: Largest standard deviation of all directions of the prior dropped together [m/s]; smaller is slower and more exact.
        paper_error_std: Standard error of every bin with the preset paper [m/s].
    """

    name: Annotated[str, Option("NAME", name="--estimator")] = "reduced_basis"
    preset: Annotated[Literal["default", "paper"], Option()] = "default"
    modes: Annotated[Count | None, Option("N|all")] = 300
    speed: Positive | None = None
    length_horizontal: Positive | None = None
    length_vertical: Positive = 100.0
    nugget: NotNegative = 1e-6
    sample_share: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    mean_variance: NotNegative | None = None
    shift_distance: NotNegative | None = None
    localisation_radius: Positive | None = None
    representation_error_std: NotNegative | None = None
    spread: Literal["as_given", "fit"] | Positive | None = None
    dropped_std: NotNegative = 9e-3
    paper_error_std: Positive = 0.12

    @field_validator("modes", mode="before")
    @classmethod
    def _all_is_none(cls, value: object) -> object:
        return None if value == "all" else value

    @field_serializer("modes")
    def _none_is_all(self, value: int | None) -> int | str:
        """Return the word for None, so that recorded settings, which omit None, read back unchanged."""
        return "all" if value is None else value


class OutputConfig(Section):
    """``[output]``: content and interval of publication.

    Attributes:
        depths: Depths of the published slices [m]. Default: three levels.
        interval: Log time between published grids [s].
        checkpoint_interval: Log time of a block [s].
        threads: Number of BLAS threads; another number changes the last bits of the results.
        metadata: Global attributes (ACDD) of the NetCDF files written, such as creator_name and license.
    """

    depths: tuple[NotNegative, ...] | None = None
    interval: Positive = 21600.0
    checkpoint_interval: Positive = 10_800.0
    threads: Annotated[int, Field(ge=1, le=1024)] = 1
    metadata: dict[str, str] = Field(default_factory=dict)


class RunConfig(Section):
    """All settings of a run."""

    logs: LogConfig = Field(default_factory=LogConfig)
    measurements: MeasurementConfig = Field(default_factory=MeasurementConfig)
    forecast: ForecastConfig = Field(default_factory=ForecastConfig)
    estimator: EstimatorConfig = Field(default_factory=EstimatorConfig)
    time: TimeConfig = Field(default_factory=TimeConfig)
    gating: GatingConfig = Field(default_factory=GatingConfig)
    consistency: ConsistencyConfig = Field(default_factory=ConsistencyConfig)
    planner: PlannerConfig = Field(default_factory=PlannerConfig)
    output: OutputConfig = Field(default_factory=OutputConfig)
    # a run does not depend on it, and does not record it
    plan: PlanRequest = Field(default_factory=PlanRequest, exclude=True)


def load_config(path: Path | None, overrides: Mapping[str, Any] | None = None) -> RunConfig:
    """Return the configuration of a TOML file, overridden by command-line options.

    Args:
        path: The TOML file; None for the defaults.
        overrides: Tables of option values as in the file; None means not given.

    Raises:
        ConfigError: The file is missing or no TOML, or a key or value is wrong.
    """
    tables: dict[str, Any] = {}
    if path is not None:
        tables = read_toml(path)
    try:
        return RunConfig.model_validate(laid_over(tables, overrides or {}))
    except ValidationError as error:
        raise ConfigError(explain(error, RunConfig, path, overrides or {})) from error


def laid_over(table: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table overridden by given values; tables are merged, None means not given."""
    merged = dict(table)
    for key, value in given.items():
        below = merged.get(key, {})
        if isinstance(value, Mapping) and isinstance(below, Mapping) and key != "remap":
            merged[key] = laid_over(below, value)
        elif value is not None:
            merged[key] = value
    return merged
