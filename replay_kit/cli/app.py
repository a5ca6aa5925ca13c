"""The command line: parse, one call of a workflow or study, exit code.

Exit codes: 0 done; 1 the run failed inside; 2 bad option or configuration; 3 input unusable; 4 finished, but something was lost;
5 a result could not be made again; 130 interrupted.
"""

import gc
import logging
import os
import sys
from typing import Any

from cyclopts import App, CycloptsError, Parameter
from cyclopts.exceptions import MissingArgumentError, RepeatArgumentError, UnknownOptionError
from cyclopts.token import Token

from replay_kit import __version__
from replay_kit.cli.console import wide_console
from replay_kit.cli.ensembles import repeat_ensembles
from replay_kit.cli.options import CHOICES, check_endings
from replay_kit.core.errors import ReplayKitError

# Loading modules and laying out help make many small objects that stay; looking for garbage among them takes a sixth of the help's time.
gc.set_threshold(50_000, 20, 20)

# What each command needs, and what it does.
_COMMANDS = {
    "replay": (
        "LOG... --ensemble FILE... -o OUT.mcap",
        "Replay logs through the current estimator: estimate, uncertainty and plan in one MCAP.",
    ),
    "info": ("LOG... | --ensemble FILE...", "Report what is in a log or a forecast and what it can be used for."),
    "qc": ("LOG...", "Show the outcome of each quality test of the ADCP's bins, and the dives of the track."),
    "convert": (
        "LOG... -o OUT.mcap|OUT.tlog",
        "Convert logs to one MCAP or telemetry log without loss of what that format can hold; several logs are merged by time.",
    ),
    "plan": (
        "FLOW... --start LON,LAT,DEPTH --goal LON,LAT,DEPTH",
        "Plan a mission of dives: headings, glide angles and surfacings to one goal or several, near a place, or along a line.",
    ),
    "twin": ("--truth FILE[#member] -o X.mcap|X.tlog", "Make a log by moving a vehicle with a simulated ADCP through a known current."),
    "synthesize": (
        "--ensemble E.nc --truth T.nc",
        "Make a synthetic ensemble (incompressible, eddying, baroclinic) and a truth withheld from it.",
    ),
    "fit": ("ENSEMBLE -o TOML", "Fit the prior to an ensemble by leaving members out, and report what was chosen."),
    "verify": (
        "OUT.mcap",
        "Make a result again from its inputs and the configuration in it, and name the first difference, with exit code 5.",
    ),
}
_STUDIES = {
    "accuracy": (
        "--ensemble FILE (--truth FILE | --leave-out K)",
        "Compare estimators on twin surveys: error and calibration against the number of pings.",
    ),
    "dives": (
        "LOG... --ensemble FILE",
        "Predict each dive of a log from the dives before it: profiles, depth-averaged current, place of surfacing.",
    ),
    "missions": (
        "--ensemble FILE --leave-out K,K,...",
        "Fly gliders through members left out: changes in time, relative profiles, mean currents, outliers, biases, intervals.",
    ),
    "paper": (
        "--ensemble FILE (--truth FILE | --leave-out K) -o DIR",
        "Compute the study of Kong et al. (IROS 2021) on an ensemble: its tables, figures, and a report of where its method holds.",
    ),
    "planning": (
        "--ensemble FILE -o DIR",
        "Plan on estimates, fly in the truth: glides, missions, scenarios, random islands, problems without a solution.",
    ),
}


def _group(name: str, help: str, **more: Any) -> App:
    # plain text, or units in brackets such as [m/s] would be taken for styles and vanish from the help
    defaults = Parameter(negative="", show_env_var=False)
    version = f"replay-kit {__version__}"
    return App(name=name, help=help, help_format="plaintext", version=version, default_parameter=defaults, group_parameters=CHOICES, **more)


def _usage_of(command: str, required: str) -> str:
    return f"Usage: replay-kit {command} {required} [OPTIONS]"


app = _group(
    "replay-kit",
    "Estimate the ocean current from a vehicle's logs and an ensemble forecast, and plan a glide over it.",
    config=check_endings,
    result_action="return_value",
    exit_on_error=False,
    suppress_keyboard_interrupt=False,
    print_error=False,
)
experiment = _group("experiment", "Studies: the accuracy of the estimator and of the plans made on it.")
# by their import paths, so that the modules of a command are loaded when it is called
for _name, (_usage, _help) in _COMMANDS.items():
    app.command(f"replay_kit.cli.commands.{_name}:{_name}", name=_name, help=_help, usage=_usage_of(_name, _usage))
for _name, (_usage, _help) in _STUDIES.items():
    _path = f"replay_kit.cli.commands.experiment.{_name}:{_name}"
    experiment.command(_path, name=_name, help=_help, usage=_usage_of(f"experiment {_name}", _usage))
app.command(experiment)
app.register_install_completion_command(help="Install the completion of commands and options in the shell.")


def main() -> None:
    """Run the command line and exit with its code."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # nobody reads on; the interpreter's last flush must not complain about it again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except (CycloptsError, ReplayKitError, OSError, KeyboardInterrupt) as error:
        code = report(error)
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Return the exit code of a command.

    Args:
        arguments: What follows the program's name.

    Raises:
        CycloptsError: The arguments cannot be parsed.
        ReplayKitError: The command ended with an error of its own.
    """
    code = app(repeat_ensembles(arguments), console=wide_console())
    # without a command the help is shown, but nothing was done
    return 2 if arguments in ([], ["experiment"]) else code or 0


def report(error: CycloptsError | ReplayKitError | OSError | KeyboardInterrupt) -> int:
    """Print an error that ends a command on standard error; return its exit code."""
    message, code = str(error), 1
    if isinstance(error, CycloptsError):
        message, code = _explained(error), 2
    elif isinstance(error, ReplayKitError):
        code = error.exit_code
    elif isinstance(error, KeyboardInterrupt):
        message, code = "interrupted", 130
    print(f"replay-kit: {message}", file=sys.stderr)
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
    """Return what is wrong when an option is missing: an unknown one, where there is one, for it may be the missing one misspelt."""
    unknown = next((token for token in error.unused_tokens or () if token.startswith("--")), None)
    if unknown is None or error.app is None:
        return str(error)
    token = Token(keyword=unknown.partition("=")[0], value=unknown, source="cli")
    return str(UnknownOptionError(token=token, argument_collection=error.app.assemble_argument_collection(), verbose=False))


def _repeated(error: RepeatArgumentError) -> str:
    """Return the option that is given more than once, and its values."""
    given = error.token.keyword
    assert given is not None
    assert error.app is not None
    names = error.app.assemble_argument_collection()[given].names
    words = error.root_input_tokens or []
    split = [word.partition("=") for word in words]
    after = [*words[1:], ""]
    values = [value if equals else after[k] for k, (name, equals, value) in enumerate(split) if name in names]
    return f"{names[0]}: expected one value, got {' and '.join(values)}; give the option once."
