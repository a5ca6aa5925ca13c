"""Command line: parsing, one call of a workflow or study, exit code.

Exit codes: 0 done; 1 internal failure; 2 bad option or configuration; 3 input unusable; 4 finished, but something was lost;
5 a result could not be reproduced; 130 interrupted.
"""

import gc
import os
import shutil
import sys
from collections.abc import Sequence
from typing import Any

from cyclopts import App, CycloptsError, Group, Parameter, Token
from cyclopts.exceptions import MissingArgumentError, UnknownOptionError, UnusedCliTokensError

from replay_kit.cli import console
from replay_kit.cli.options import CHOICES, before_conversion
from replay_kit.cli.words import command_first, repeat_ensembles, spread_vehicles
from replay_kit.core import __version__
from replay_kit.core.errors import ReplayKitError
from replay_kit.core.words.text import printable

# Loading modules makes many small objects that stay; looking for garbage among them takes a sixth of the help's time.
gc.set_threshold(50_000, 20, 20)
# Threads that BLAS starts when it is loaded wait busily, a tenth of a second a command; ``output.threads`` starts what it asks for.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Each command under its heading: the module in which it is, what it needs, and what it does.
_COMMANDS = {
    "Estimate and plan": {
        "replay": (
            "replay",
            "LOG... --ensemble FILE... -o OUT.mcap",
            "Estimate the ocean current from logs and a forecast, and plan on it; write one MCAP.",
        ),
        "plan": (
            "plan",
            "FLOW... [--start LON,LAT,DEPTH] [--goal LON,LAT,DEPTH]",
            "Plan a glider mission: headings, glide angles and surfacings to one or several goals, near a place, or along a line.",
        ),
        "smooth": (
            "logs",
            "LOG... --ensemble FILE... -o OUT.mcap",
            "Estimate the current at each time from measurements before and after it (smoothing), for a finished mission.",
        ),
        "fleet": (
            "fleet",
            "MISSIONS.toml|LOG... -o DIR",
            "Replay many missions in parallel: one result each, and a summary table and page.",
        ),
    },
    "Logs": {
        "info": ("logs", "LOG... | --ensemble FILE...", "List the contents of a log or forecast."),
        "qc": (
            "logs",
            "LOG...",
            "Report the quality tests of the ADCP bins, and the dives of the track.",
        ),
        "convert": (
            "logs",
            "LOG... -o OUT.mcap",
            "Convert logs to one MCAP log; several logs are merged by time.",
        ),
    },
    "Results": {
        "status": (
            "show",
            "RESULT.mcap",
            "One-screen status: position, steering, next surfacing, warnings.",
        ),
        "report": (
            "show",
            "RESULT.mcap",
            "Write a result as one HTML page: summary, map, section along the track, consistency, plan.",
        ),
        "plot": (
            "show",
            "RESULT.mcap map|section|series|dac|trust|plan -o F.png|svg|pdf",
            "Draw a figure of a result for a paper.",
        ),
        "export": (
            "show",
            "RESULT.mcap -o X.nc|csv|kml|geojson",
            "Export a result to other formats: time series at places, track, section, dives, innovations, surfacings, plans.",
        ),
        "layout": (
            "show",
            "RESULT.mcap -o LAYOUT.json",
            "Write a viewer layout (Foxglove, Lichtblick) for a result: map, 3D scene, plots, log and findings.",
        ),
        "verify": (
            "logs",
            "OUT.mcap",
            "Reproduce a result from its recorded inputs and report differences (exit code 5).",
        ),
        "compare": (
            "logs",
            "A.mcap B.mcap",
            "Compare two results: settings, estimate, innovations, plans, findings (exit code 5 where values differ).",
        ),
    },
    "Forecasts and settings": {
        "fetch": (
            "ensemble",
            "[LOG...] --ensemble ADDRESS...",
            "Fetch the part of a forecast on a server that a replay of the logs needs, for later replays without a link.",
        ),
        "config": (
            "ensemble",
            "[SECTION...]",
            "List every setting with its default and description, as TOML for --config.",
        ),
    },
    "Synthetic data": {
        "twin": (
            "ensemble",
            "--truth FILE[#member] -o X.mcap",
            "Simulate the log of a vehicle with an ADCP in a known current (twin experiment).",
        ),
        "synthesize": (
            "ensemble",
            "--ensemble E.nc --truth T.nc",
            "Generate a synthetic ensemble (incompressible, eddying, baroclinic) and a withheld truth.",
        ),
    },
    "Studies": {
        "experiment paper": (
            "experiment",
            "--ensemble FILE (--truth FILE | --leave-out K) -o DIR",
            "Compute the study of Kong et al. (IROS 2021) on an ensemble: its tables, and a report of where its method holds.",
        )
    },
}
#: What each command needs, by its words.
FORMS = {
    command: form for commands in _COMMANDS.values() for command, (_, form, _) in commands.items()
}
_HELP = ("--help", "-h", "--help-all")
_SHOWN = (*_HELP, "--version")
# stands for a console where cyclopts is not to make one, which would load rich
_NO_CONSOLE: Any = object()


def _shown(default: Any) -> str | None:
    """Return a default as stated in the help; None without a default."""
    return None if default in (None, (), False) else str(default)


def _group(name: str, about: str, **more: Any) -> App:
    """Return an app of commands."""
    return App(
        name=name,
        help=about,
        help_flags=_HELP,
        help_format="plaintext",
        version=f"replay-kit {__version__}",
        default_parameter=Parameter(negative="", show_env_var=False, show_default=_shown),
        group_parameters=CHOICES,
        group_commands=Group("Options", sort_key=99),
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
_studies = _group(
    "experiment",
    "Studies: the tables of a paper on any ensemble.",
    group=Group("Studies", sort_key=len(_COMMANDS)),
)
app.command(_studies)
for _number, (_heading, _commands) in enumerate(_COMMANDS.items()):
    _under = Group(_heading, sort_key=_number)
    for _order, (_command, (_module, _form, _about)) in enumerate(_commands.items()):
        _name = _command.rpartition(" ")[2]
        # by import path, so that its module loads on call
        (app if _name == _command else _studies).command(
            f"replay_kit.cli.commands.{_module}:{_name}",
            name=_name,
            group=_under,
            sort_key=_order,
            help=_about,
            usage=f"Usage: replay-kit {_command} {_form} [OPTIONS]",
        )
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
    except (CycloptsError, ReplayKitError, OSError, MemoryError, KeyboardInterrupt) as error:
        code = report(error)
    if "logging" in sys.modules:
        # readers of Zarr leave tasks behind, which complain at the interpreter's end of an error that is told already
        sys.modules["logging"].getLogger("asyncio").disabled = True
    sys.exit(code)


def run(arguments: Sequence[str]) -> int:
    """Return the exit code of a command.

    Args:
        arguments: Words after the program's name.

    Raises:
        CycloptsError: The arguments cannot be parsed.
        ReplayKitError: The command failed.
    """
    console.begin(console.Reporting())
    words = command_first(arguments, {*FORMS, "experiment"})
    words = repeat_ensembles(spread_vehicles(words))
    # without a command the help is shown, but nothing was done
    nothing = words in ([], ["experiment"])
    printer = _NO_CONSOLE
    if nothing or set(_SHOWN) & set(words):
        from rich.console import Console

        width = shutil.get_terminal_size((console.PIPE_WIDTH, 24)).columns
        printer = Console(width=width, highlight=False, markup=False)
    code = app(words, console=printer, error_console=_NO_CONSOLE) or 0
    return 2 if nothing else code


def report(error: BaseException) -> int:
    """Print a command's error on standard error and in the file of ``--log``; return its exit code."""
    message, code = str(error), error.exit_code if isinstance(error, ReplayKitError) else 1
    if isinstance(error, CycloptsError):
        message, code = _explained(error), 2
    elif isinstance(error, KeyboardInterrupt):
        message, code = "interrupted", 130
    elif isinstance(error, MemoryError):
        message = (
            f"there is not enough memory: {error}; choose less with --region, --levels or --modes"
        )
    message = printable(message)
    print(f"replay-kit: {message}", file=sys.stderr)
    console.keep(f"ERROR: {message}")
    return code


def _explained(error: CycloptsError) -> str:
    """Return the message of a usage error, with the command that lists the options."""
    command = " ".join(error.command_chain or ())
    if isinstance(error, MissingArgumentError):
        # what is missing may be what was misspelt
        error = _misspelt(error) or error
    message, form = str(error), f"expected replay-kit {command} {FORMS.get(command, '')}."
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        what = error.argument.name if error.keyword is None else f"{error.keyword}: its value"
        message = f"{what} is missing; {form}"
    elif isinstance(error, UnusedCliTokensError) and error.unused_tokens:
        message = f"'{error.unused_tokens[0]}' is one too many; {form}"
    elif isinstance(error, UnknownOptionError):
        from replay_kit.cli.settings import settings_named

        name = (error.token.keyword or error.token.value).partition("=")[0].lstrip("-")
        for section, key in settings_named(name):
            message += f" In a file of --config: [{section}] {key}."
    return f"{message} See {' '.join(('replay-kit', *command.split()))} --help."


def _misspelt(error: MissingArgumentError) -> UnknownOptionError | None:
    """Return the error of the first unknown option of a command line; None if all are known."""
    assert error.app is not None
    arguments = error.app.assemble_argument_collection()
    known = {name for argument in arguments for name in argument.names}
    given = [word.partition("=")[0] for word in error.unused_tokens or () if word.startswith("-")]
    unknown = next((name for name in given if name.replace("_", "-") not in known), None)
    if unknown is None:
        return None
    return UnknownOptionError(
        token=Token(keyword=unknown, source="cli"), argument_collection=arguments, verbose=False
    )
