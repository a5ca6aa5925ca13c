"""The command line: parse, one call of a workflow or study, exit code.

Exit codes: 0 done; 1 the run failed inside; 2 bad option or configuration; 3 input unusable; 4 finished, but something was lost;
5 a result could not be made again; 130 interrupted.
"""

import gc
import os
import shutil
import sys
from typing import Any

from cyclopts import App, CycloptsError, Parameter
from cyclopts.exceptions import MissingArgumentError, RepeatArgumentError

from replay_kit.cli import console
from replay_kit.cli.help import (
    command_group,
    layout,
    option_groups,
    refuse_unknown,
    repeat_ensembles,
    spread_vehicles,
)
from replay_kit.cli.options import CHOICES, before_conversion
from replay_kit.config.removed import refuse_command
from replay_kit.core.errors import ConfigError, ReplayKitError
from replay_kit.core.text import printable
from replay_kit.core.version import __version__

# Loading modules and laying out help make many small objects that stay; looking for garbage among them takes a sixth of the help's time.
gc.set_threshold(50_000, 20, 20)

# The module of a command, where it is not of the command's own name.
_MODULES = {
    name: module
    for module, names in {
        "logs": ("info", "qc", "convert", "verify", "compare", "smooth"),
        "show": ("report", "status", "plot", "export", "layout"),
        "ensemble": ("fetch", "fit", "twin", "synthesize"),
        "experiment": ("paper",),
    }.items()
    for name in names
}
# What each command needs, and what it does.
_COMMANDS = {
    "replay": (
        "LOG... --ensemble FILE... -o OUT.mcap",
        "Estimate the ocean current from logs and a forecast, and plan on it; write one MCAP.",
    ),
    "smooth": (
        "LOG... --ensemble FILE... -o OUT.mcap",
        "Estimate the current at each time from measurements before and after it (smoothing), for a finished mission.",
    ),
    "info": (
        "LOG... | --ensemble FILE...",
        "List the contents of a log or forecast.",
    ),
    "qc": (
        "LOG...",
        "Report the quality tests of the ADCP bins, and the dives of the track.",
    ),
    "convert": (
        "LOG... -o OUT.mcap|OUT.tlog",
        "Convert logs to one MCAP or telemetry log without loss of what that format can hold; several logs are merged by time.",
    ),
    "report": (
        "RESULT.mcap",
        "Write a result as one HTML page: summary, map, section along the track, consistency, plan.",
    ),
    "status": (
        "RESULT.mcap",
        "One-screen status: position, steering, next surfacing, warnings.",
    ),
    "layout": (
        "RESULT.mcap -o LAYOUT.json",
        "Write a viewer layout (Foxglove, Lichtblick) for a result: map, 3D scene, plots, log and findings.",
    ),
    "plot": (
        "RESULT.mcap map|section|series|dac|trust|plan -o F.png|svg|pdf",
        "Draw a figure of a result for a paper.",
    ),
    "export": (
        "RESULT.mcap -o X.nc|csv|kml|geojson",
        "Export a result to other formats: time series at places, track, section, dives, innovations, surfacings, plans.",
    ),
    "plan": (
        "FLOW... [--start LON,LAT,DEPTH] [--goal LON,LAT,DEPTH]",
        "Plan a glider mission: headings, glide angles and surfacings to one or several goals, near a place, or along a line.",
    ),
    "twin": (
        "--truth FILE[#member] -o X.mcap|X.tlog",
        "Simulate the log of a vehicle with an ADCP in a known current (twin experiment).",
    ),
    "synthesize": (
        "--ensemble E.nc --truth T.nc",
        "Generate a synthetic ensemble (incompressible, eddying, baroclinic) and a withheld truth.",
    ),
    "fit": (
        "ENSEMBLE -o TOML",
        "Fit the prior to an ensemble by cross-validation over members, and report the fitted settings.",
    ),
    "fleet": (
        "MISSIONS.toml|LOG... -o DIR",
        "Replay many missions in parallel: one result each, and a summary table and page.",
    ),
    "fetch": (
        "[LOG...] --ensemble ADDRESS...",
        "Fetch the part of a forecast on a server that a replay of the logs needs, for later replays without a link.",
    ),
    "verify": (
        "OUT.mcap",
        "Reproduce a result from its recorded inputs and report differences (exit code 5).",
    ),
    "compare": (
        "A.mcap B.mcap",
        "Compare two results: settings, estimate, innovations, plans, findings (exit code 5 where values differ).",
    ),
}
_STUDIES = {
    "paper": (
        "--ensemble FILE (--truth FILE | --leave-out K) -o DIR",
        "Compute the study of Kong et al. (IROS 2021) on an ensemble: its tables, and a report of where its method holds.",
    ),
}
_EVERY = {**_COMMANDS, **{f"experiment {_name}": _words for _name, _words in _STUDIES.items()}}
_EVERY_OPTION = "--help-all"
_HELP = ("--help", "-h", _EVERY_OPTION)
_ANYWHERE = {*_HELP, "--version", "-q", "--quiet", "-v", "--verbose", "--log"}
_ROOT_OPTIONS = [
    ("-h, --help", "Show this help, or that of a command; --help-all shows all of its options."),
    ("--version", "Show the version."),
    ("--install-completion", "Install the completion of commands and options in the shell."),
]
# stands for a console where cyclopts is not to make one, which would load rich
_NO_CONSOLE: Any = object()


def _group(name: str, help: str, **more: Any) -> App:
    defaults = Parameter(negative="", show_env_var=False)
    version = f"replay-kit {__version__}"
    return App(
        name=name,
        help=help,
        version=version,
        default_parameter=defaults,
        group_parameters=CHOICES,
        **more,
    )


app = _group(
    "replay-kit",
    "Estimate the ocean current from a vehicle's logs and an ensemble forecast, and plan a glide over it.",
    config=before_conversion,
    result_action="return_value",
    exit_on_error=False,
    suppress_keyboard_interrupt=False,
    print_error=False,
)
experiment = _group("experiment", "Studies: the tables of a paper on any ensemble.")
# by their import paths, so that the modules of a command are loaded when it is called
for _group_of, _table in ((app, _COMMANDS), (experiment, _STUDIES)):
    for _name, (_, _help) in _table.items():
        _where = f"replay_kit.cli.commands.{_MODULES.get(_name, _name)}:{_name}"
        _group_of.command(_where, name=_name, help=_help)
app.command(experiment)
app.register_install_completion_command(
    help="Install the completion of commands and options in the shell."
)


def main() -> None:
    """Run the command line and exit with its code."""
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # nobody reads on; the interpreter's last flush must not complain about it again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except (CycloptsError, ReplayKitError, OSError, KeyboardInterrupt) as error:
        code = report(error)
    except MemoryError as error:
        code = report(
            ReplayKitError(
                f"there is not enough memory: {error}; choose less with --region, --levels or --modes"
            )
        )
    if "logging" in sys.modules:
        # readers of Zarr leave tasks behind, which complain at the interpreter's end of an error that is told already
        sys.modules["logging"].getLogger("asyncio").disabled = True
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Return the exit code of a command.

    Args:
        arguments: What follows the program's name.

    Raises:
        CycloptsError: The arguments cannot be parsed.
        ReplayKitError: The command ended with an error of its own.
    """
    console.begin(console.Reporting())
    refuse_command(arguments)
    arguments = repeat_ensembles(spread_vehicles(_command_first(arguments)))
    words = [word for word in arguments if word not in _HELP]
    chain, apps, unused = app.parse_commands(words)
    command = apps[-1].default_command
    if words == arguments and words not in ([], ["experiment"]):
        if command is not None and " ".join(chain) in _EVERY:
            refuse_unknown(command, unused, sorted(_ANYWHERE), chain)
        # a console is made by cyclopts only to print what is printed here
        return app(arguments, error_console=_NO_CONSOLE) or 0
    if command is None and unused:
        # a misspelt command
        return app(words, error_console=_NO_CONSOLE) or 0
    # the defaults of options are those of the program
    with app.app_stack(apps):
        sys.stdout.write(_help_text(chain, apps[-1], _EVERY_OPTION in arguments))
    # without a command the help is shown, but nothing was done
    return 0 if words != arguments else 2


def _command_first(arguments: list[str]) -> list[str]:
    """Return the arguments with options that every command has after the command.

    Raises:
        ConfigError: Another option stands before the command.
    """
    before: list[str] = []
    for k, word in enumerate(arguments):
        if word in _COMMANDS or word == "experiment":
            command = " ".join(arguments[k : k + 1 + (word == "experiment")])
            foreign = next(
                (
                    option
                    for option in before
                    if option.startswith("-") and option.partition("=")[0] not in _ANYWHERE
                ),
                None,
            )
            if foreign is not None:
                raise ConfigError(
                    f"{foreign}: stands before the command; write replay-kit {command} {foreign} ..."
                )
            return arguments[k:] + before
        if not (word.startswith("-") or (before and before[-1].startswith("-"))):
            break
        before.append(word)
    return arguments


def _help_text(chain: tuple[str, ...], command: App, every: bool) -> str:
    width = shutil.get_terminal_size((console.PIPE_WIDTH, 24)).columns
    usage, about = _EVERY.get(" ".join(chain), ("COMMAND", command.help))
    hidden = 0
    if command.default_command is None:
        known = {name: words for name, (_, words) in (_STUDIES if chain else _COMMANDS).items()}
        groups = [
            command_group(known if chain else {**known, "experiment": str(experiment.help)}),
            ("Options", _ROOT_OPTIONS),
        ]
    else:
        groups, hidden = option_groups(command.assemble_argument_collection(), every)
    form = " ".join(("Usage: replay-kit", *chain, usage, "[OPTIONS]"))
    more = (
        f"{hidden} more options, and what each accepts: replay-kit {' '.join(chain)} {_EVERY_OPTION}"
        if hidden
        else ""
    )
    return layout(form, about or "", groups, width, more)


def report(error: CycloptsError | ReplayKitError | OSError | KeyboardInterrupt) -> int:
    """Print an error that ends a command on standard error, and keep it in the file of ``--log``; return its exit code."""
    # the text of a usage error is made once: for an unknown option it compares all the names of a command
    if isinstance(error, CycloptsError):
        message, code = _explained(error), 2
    elif isinstance(error, KeyboardInterrupt):
        message, code = "interrupted", 130
    else:
        message, code = str(error), error.exit_code if isinstance(error, ReplayKitError) else 1
    message = printable(message)
    print(f"replay-kit: {message}", file=sys.stderr)
    console.keep(f"ERROR: {message}")
    return code


def _explained(error: CycloptsError) -> str:
    """Return the message of a usage error, and where the options are listed."""
    command = " ".join(("replay-kit", *(error.command_chain or ())))
    if isinstance(error, RepeatArgumentError):
        message = _repeated(error)
    elif isinstance(error, MissingArgumentError):
        message = _missing(error)
    else:
        message = str(error)
    return f"{message} See {command} --help."


def _missing(error: MissingArgumentError) -> str:
    """Return what is missing, an option, an argument or an option's value, and how the command is called."""
    assert error.argument is not None
    command = " ".join(error.command_chain or ())
    what = error.argument.name if error.keyword is None else f"{error.keyword}: its value"
    return f"{what} is missing; expected replay-kit {command} {_EVERY[command][0]}."


def _repeated(error: RepeatArgumentError) -> str:
    """Return the option that is given more than once, and its values."""
    given = error.token.keyword
    assert given is not None
    assert error.app is not None
    names = error.app.assemble_argument_collection()[given].names
    words = error.root_input_tokens or []
    split = [word.partition("=") for word in words]
    after = [*words[1:], ""]
    values = [
        value if equals else after[k]
        for k, (name, equals, value) in enumerate(split)
        if name in names
    ]
    return f"{names[0]}: expected one value, got {' and '.join(values)}; give the option once."
