"""Parts shared by the commands: option groups, endings of outputs, and parsing of compound values."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

from cyclopts import App, ArgumentCollection, Group, Parameter, Token
from cyclopts.validators import Number

from replay_kit.cli import console
from replay_kit.config.option import PLACE, Numbers, numbers
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import check_paths, is_stream, path_of
from replay_kit.core.words.quantities import parse_duration

if TYPE_CHECKING:
    from rich.console import Console

    from replay_kit.core.plan import Place
    from replay_kit.results.outcome.outcome import Outcome

INPUTS = Group("Inputs", sort_key=1)
OUTPUTS = Group("Outputs", sort_key=2)
CHOICES = Group("Options", sort_key=3)
REPORTING = Group("Reporting", sort_key=9)

# Endings of file names, which the name of a folder does not have.
_FILE_ENDINGS = ".mcap .tlog .nc .json .csv .geojson .toml .html .png .svg .pdf .kml"

# Of a group of values: each of its fields is an option of its own, under the group's heading.
TO_INPUTS, TO_OUTPUTS, TO_OPTIONS = (
    Parameter(name="*", group=group) for group in (INPUTS, OUTPUTS, CHOICES)
)


def option(
    metavar: str | None = None, *, least: float | None = None, seconds: bool = False, **more: Any
) -> Parameter:
    """Return an option with one value, named after the parameter; its help is in the docstring.

    Args:
        metavar: Form of the value; None for the type's own. A value whose form is stated may begin with a minus, as a longitude does.
        least: Least number accepted; None for no bound.
        seconds: Whether a duration such as 36h is accepted too.
        more: Arguments of ``Parameter``: another name, an alias, a group, a shared help.
    """
    if least is not None:
        more["validator"] = Number(gte=least)
    if seconds:
        more["converter"] = _seconds
    return Parameter(metavar=metavar, allow_leading_hyphen=metavar is not None, **more)


def _seconds(_: type, tokens: Sequence[Token]) -> float:
    for read in (float, parse_duration):
        with suppress(ValueError, ConfigError):
            return read(tokens[0].value)
    raise ValueError("expected a number, or a duration such as 90s, 36h, 2d")


def argument(name: str, **more: Any) -> Parameter:
    """Return a required positional argument."""
    return Parameter(name=name, group=INPUTS, required=True, **more)


def output(metavar: str) -> Parameter:
    """Return the option of a command's main output."""
    return option(metavar, alias="-o", group=OUTPUTS)


def flag(**more: Any) -> Parameter:
    """Return an option without a value; it may be repeated."""
    return Parameter(allow_repeating=True, **more)


#: Option without a value.
Switch = Annotated[bool, flag()]


@dataclass(frozen=True, slots=True)
class Ending:
    """Mark of an output's annotation: possible endings of its name. Without endings the output is a folder.

    Attributes:
        endings: Possible endings in lower case, with their dots; a bare name such as ``targets`` has the ending ``.targets``.
        stream: Whether the output can be a pipe, a device, or ``-``, standard output. Other outputs are written under a temporary name and
            renamed, which would replace a device by a file.
    """

    endings: tuple[str, ...] = ()
    stream: bool = False

    def check(self, name: str, text: str) -> None:
        """Raise ConfigError for a name with the wrong ending.

        A name without an ending fits a single format; where the ending selects the format, it is required. Case is ignored. A folder may
        not have the ending of a file.

        Args:
            name: Name of the option.
            text: Its value.

        Raises:
            ConfigError: The ending does not fit, or the output cannot be written to a stream.
        """
        path = Path(text)
        ending, streamed = path.suffix.lower(), str(path) == "-" or is_stream(path)
        if not self.endings:
            if ending and ending in _FILE_ENDINGS.split():
                raise ConfigError(
                    f"{name}: expected the name of a folder, got '{path}' with the ending {path.suffix}; leave the ending out"
                )
            return
        kind = f"the name of a file that ends in {'one of ' if len(self.endings) > 1 else ''}{', '.join(self.endings)}"
        if streamed:
            if not self.stream:
                raise ConfigError(
                    f"{name}: expected {kind}, got the stream '{path}'; this output cannot be written to a stream"
                )
        elif not (
            ending in self.endings
            or f".{path.name.lower()}" in self.endings
            or (not ending and len(self.endings) == 1)
        ):
            got = f"the ending {path.suffix}" if ending else "no ending"
            raise ConfigError(
                f"{name}: expected {kind}, got '{path}' with {got}; choose another name"
            )


def before_conversion(app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """Check names of outputs and numbers before missing options are named and values converted; then begin to report.

    The arguments are those of the hooks that cyclopts calls between splitting and converting a command line.

    Raises:
        ConfigError: An ending or number does not fit, or the file of ``--log`` is another file of the command or cannot be written.
    """
    given = {
        argument.name: [token.value for token in argument.tokens]
        for argument in arguments
        if argument.tokens
    }
    for argument in arguments:
        for mark in get_args(argument.field_info.annotation)[1:]:
            if isinstance(mark, Ending | Numbers):
                for value in given.get(argument.name, []):
                    mark.check(argument.name, value)
    log = next((Path(value) for value in given.pop("--log", [])), None)
    others = (Path(value).resolve() for values in given.values() for value in values)
    if log is not None and log.resolve() in others:
        raise ConfigError(f"--log: '{log}' is another file of this command; choose another name")
    console.begin(console.Reporting("--quiet" in given, "--verbose" in given, log))


# Settings of the forecast that do not need a log.
_OF_FORECAST = "members axes region levels lead time reference_time offline max_download"
PART_OF_FORECAST = tuple(f"forecast.{key}" for key in _OF_FORECAST.split())
_LOGS = (
    "Logs of one mission: MCAP, MAVLink .tlog, DataFlash .BIN, Seaglider NetCDF, raw ADCP (PD0, AD2CP), other glider NetCDF files, "
    "SeaExplorer raw files, a table of pings (pings.csv or .nc with time, longitude, latitude, depth, u, v, error; --columns u=East names "
    "others), or folders of these; merged by time."
)
Log = Annotated[Path, argument("LOG", help=_LOGS)]
LogIfAny = Annotated[Path, Parameter(name="LOG", help=_LOGS, group=INPUTS, required=False)]
MCAP, NETCDF, HTML = Ending((".mcap",)), Ending((".nc",)), Ending((".html",))
ENSEMBLE_HELP = (
    "NetCDF files, Zarr stores, folders, patterns, or addresses (https:// of Zarr, OPeNDAP or griddap; cmems:DATASET); may be repeated. "
    "--members defines what a member is."
)


def _paths(_: object, tokens: Sequence[Token]) -> tuple[Path, ...]:
    """Return files and addresses."""
    return tuple(path_of(token.value) for token in tokens)


#: Of an option whose values are files or addresses.
SOURCES = Parameter(converter=_paths)
Ensemble = Annotated[
    tuple[Path, ...],
    option("FILE...", group=INPUTS, help=f"Ensemble forecast: {ENSEMBLE_HELP}"),
    SOURCES,
]
Truth = Annotated[
    str | None, option("T.nc[#member]", group=INPUTS, help="Known truth to score against.")
]
Noise = Annotated[
    float, option(least=0.0, help="Standard deviation of each velocity component of a bin [m/s].")
]
ConfigFile = Annotated[
    Path | None,
    option(
        "TOML", group=INPUTS, help="Settings of the run; options on the command line override them."
    ),
]


@TO_OUTPUTS
@dataclass(frozen=True, slots=True, kw_only=True)
class Replacing:
    """Replacement of existing outputs, and level of output.

    Attributes:
        overwrite: Replace outputs that exist. An input is never replaced.
        quiet: Print nothing but errors.
        verbose: Print whole tables, row by row.
        log: Append everything printed to a file, with timestamps.
    """

    overwrite: Switch = False
    quiet: Annotated[bool, flag(alias="-q", group=REPORTING)] = False
    verbose: Annotated[bool, flag(alias="-v", group=REPORTING)] = False
    log: Annotated[Path | None, option("FILE.log", group=REPORTING), Ending((".log", ".txt"))] = (
        None
    )

    def check(self, read: Iterable[Path | None], *made: Path | None) -> None:
        """Raise ConfigError if an input is missing, or an output is an input or exists and is not to be replaced."""
        check_paths(read, made, self.overwrite)


@TO_OUTPUTS
@dataclass(frozen=True, slots=True, kw_only=True)
class Answer(Replacing):
    """Additional output of a command's answer.

    Attributes:
        json_file: Write the answer as JSON; - is standard output.
    """

    json_file: Annotated[
        Path | None, option("FILE", name="--json"), Ending((".json",), stream=True)
    ] = None

    def check(self, read: Iterable[Path | None], *made: Path | None) -> None:
        """Check inputs and outputs, among them the answer's file."""
        check_paths(read, (*made, self.json_file), self.overwrite)

    def console(self, *streams: Path | None) -> "Console":
        """Return the console of tables and messages beside the answer and other streams."""
        return console.console_beside(self.json_file, *streams)

    def write(self, answer: Mapping[str, Any]) -> None:
        """Write the answer as JSON if that is asked for."""
        console.write_json(self.json_file, answer)

    def tell(self, result: Path, outcome: "Outcome") -> int:
        """Print the summary of a result, write its outcome as the answer, and return the exit code."""
        from replay_kit.show.summary import print_summary
        from replay_kit.workflows.status import read_status

        print_summary(read_status(result)[0], outcome, self.console(), verbose=self.verbose)
        self.write(outcome.to_json())
        return outcome.exit_code


def place(text: str, name: str) -> "Place":
    """Return the place of an option ``LON,LAT,DEPTH``."""
    # loads numpy, after what is quickly refused
    from replay_kit.core.plan import Place

    return Place(*numbers(text, name, PLACE.form))


@TO_OPTIONS
@dataclass(frozen=True, slots=True, kw_only=True)
class Processes:
    """Processes of the computation.

    Attributes:
        scheduler: Address of a Dask cluster's scheduler, such as tcp://10.0.0.1:8786.
        workers: Number of processes of this machine.
    """

    scheduler: Annotated[str | None, option("ADDRESS")] = None
    workers: Annotated[int | None, option("N", least=1)] = None
