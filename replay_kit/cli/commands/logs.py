"""``info``, ``qc``, ``convert``, ``smooth``, ``verify`` and ``compare``: commands on logs, and reproduction of results."""

from pathlib import Path
from typing import Annotated, Any

from replay_kit.cli.commands.ensemble import local_forecast, print_price
from replay_kit.cli.console import part_named, progress, write_text
from replay_kit.cli.options import (
    ENSEMBLE_HELP,
    INPUTS,
    MCAP,
    OUTPUTS,
    PART_OF_FORECAST,
    SOURCES,
    Answer,
    Ending,
    Ensemble,
    Log,
    LogIfAny,
    argument,
    flag,
    option,
    output,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import addresses_in

_Ensemble = Annotated[
    tuple[Path, ...],
    option(
        "FILE...",
        group=INPUTS,
        help=f"Ensemble forecast to describe, and to check a log's axes, signs, units and depths against: {ENSEMBLE_HELP}",
    ),
    SOURCES,
]


@takes_settings(
    *("logs.clock", "logs.system", "logs.remap", "logs.columns", "measurements"), *PART_OF_FORECAST
)
def info(
    *logs: LogIfAny,
    ensemble: _Ensemble = (),
    full: Annotated[bool, flag(group=INPUTS)] = False,
    suggest: Annotated[
        Path | None, option("FILE.toml", group=OUTPUTS), Ending((".toml",), stream=True)
    ] = None,
    outputs: Answer = Answer(),
    settings: Settings,
) -> int:
    """Return exit code 0, or 4 when bytes of a log were lost; raises the error that a replay would end with.

    Args:
        full: Read all of a large MCAP, not only its index and first messages: profiles, positions, damage.
        suggest: Write a draft mapping for topics of unknown type; - is standard output.
    """
    if str(suggest) == str(outputs.json_file) == "-":
        raise ConfigError(
            "--suggest and --json: only one can have standard output; give the other a file"
        )
    if not logs and not ensemble:
        raise ConfigError("info: expected a log, or a forecast with --ensemble")
    outputs.check([*logs, settings.file, *ensemble], suggest)
    config = settings.load()

    from replay_kit.logs.tables.mapped import suggestions
    from replay_kit.show.text import print_lines
    from replay_kit.workflows.info.inspect import inspect_logs
    from replay_kit.workflows.info.listing import (
        asks_for_replay,
        info_json,
        next_command,
        print_infos,
    )

    with progress() as advance:
        found = inspect_logs(logs, config, advance, full)
        forecast = check = near_ns = None
        # the libraries that read a forecast take longer to load than a log's index to read
        if ensemble:
            from replay_kit.forecast import describe_ensemble
            from replay_kit.workflows.info.listing import ensemble_json, print_ensemble

            advance(0, 1, "checking against the ensemble" if logs else "reading the forecast")
            if not logs and config.forecast.region is None and addresses_in(ensemble):
                return print_price(ensemble, logs, config, outputs)
            files = ensemble
            if addresses_in(ensemble):
                from replay_kit.workflows.replay.inputs.job import ReplayJob

                files = local_forecast(ReplayJob(logs, ensemble), config).forecasts
            if logs:
                from replay_kit.workflows.replay.inputs.checks import (
                    check_logs,
                    import_check_json,
                    print_import_check,
                )
                from replay_kit.workflows.replay.inputs.scan import Logs

                # as a replay of the logs would read it
                near_ns = Logs([logs], config).ahead()[1]
            forecast = describe_ensemble(files, config.forecast, near_ns)
            check = check_logs(logs, files, config) if logs else None
    console = outputs.console(suggest)
    answer = dict[str, Any](logs=[info_json(log) for log in found])
    refusal, following = None, list[str]()
    if forecast is not None:
        print_ensemble(forecast, console)
        answer["forecast"] = ensemble_json(forecast)
    print_infos(found, console, outputs.verbose)
    if check is not None:
        print_import_check(check, console)
        answer["import_check"] = import_check_json(check)
        refusal = check.refusal if asks_for_replay(found) else None
    if logs and refusal is None:
        following = next_command(found, logs, ensemble, settings.words())
        print_lines(console, following)
    if following:
        answer["next"] = "\n".join(following)
    unknown = {topic: sample for log in reversed(found) for topic, sample in log.unknown.items()}
    if suggest is not None:
        write_text(suggest, suggestions(unknown))
    outputs.write(answer)
    if refusal is not None:
        raise refusal
    return 4 if any(log.report.losses for log in found) else 0


@takes_settings("logs", "measurements")
def qc(*logs: Log, settings: Settings, answer: Answer = Answer()) -> int:
    """Return the exit code of the report."""
    answer.check([*logs, settings.file])
    config = settings.load()

    from replay_kit.workflows.info.qc import check_quality, print_quality

    with progress() as advance:
        report = check_quality(list(logs), config, advance)
    print_quality(report, answer.console())
    answer.write(report)
    return int(report["exit_code"])


@takes_settings("logs.remap", "logs.columns", file=False)
def convert(
    *logs: Log,
    out: Annotated[Path, output("OUT.mcap"), MCAP],
    answer: Answer = Answer(),
    settings: Settings,
) -> int:
    """Return exit code 0, or 4 when something was lost.

    Args:
        out: One log.
    """
    answer.check(logs, out)
    config = settings.load()

    from replay_kit.workflows.convert import convert as convert_logs
    from replay_kit.workflows.convert import convert_json, print_converted

    with progress() as advance:
        summary = convert_logs(list(logs), out, answer.overwrite, config.logs, advance)
    print_converted(summary, answer.console(), answer.verbose)
    answer.write(convert_json(summary))
    return 4 if summary.losses else 0


def verify(
    result: Annotated[Path, argument("RESULT")],
    /,
    *,
    inputs: Annotated[list[Path] | None, option("DIR", group=INPUTS)] = None,
    answer: Answer = Answer(),
) -> int:
    """Return exit code 0, 4 when part of the result was lost, or 5 when it could not be reproduced.

    Args:
        result: A result of replay or plan.
        inputs: Folder of the inputs; may be repeated. Default: the result's folder, then the current one.
    """
    answer.check([result, *(inputs or ())])

    from replay_kit.show.text import print_lines
    from replay_kit.workflows.planning.adapters import planner_of
    from replay_kit.workflows.planning.record import plan_again
    from replay_kit.workflows.sound import sound_result
    from replay_kit.workflows.verify import verify as verify_result

    with progress() as advance, sound_result(result) as sound:
        folders = [*(inputs or ()), result.parent]
        found = verify_result(sound.path, folders, planner_of, advance, plan_again)
    said = [f"{result}: {line}" for line in str(found).splitlines()]
    print_lines(answer.console(), [*said, *(f"note: {note}" for note in sound.lines)])
    answer.write({"result": str(result), **found.to_json(), "notes": list(sound.lines)})
    return sound.exit_code or (0 if found.same else 5)


def compare(
    first: Annotated[Path, argument("A")],
    second: Annotated[Path, argument("B")],
    /,
    *,
    answer: Answer = Answer(),
) -> int:
    """Return exit code 0 when the values are equal, 5 when they differ, 4 when part of a result was lost.

    Args:
        first: A result of replay or plan.
        second: Another result of the same region and period.
    """
    answer.check([first, second])

    from replay_kit.results import difference
    from replay_kit.show.text import print_lines
    from replay_kit.workflows.sound import sound_result

    with sound_result(first) as one, sound_result(second) as other:
        found = difference(one.path, other.path)
    print_lines(answer.console(), [*one.lines, *other.lines, *str(found).splitlines()])
    answer.write({"results": [str(first), str(second)], **found.to_json()})
    return max(one.exit_code, other.exit_code) or (0 if found.same else 5)


@takes_settings("logs", "measurements", "forecast", "estimator", "time")
def smooth(
    *logs: Log,
    ensemble: Ensemble,
    out: Annotated[Path, output("OUT.mcap"), MCAP],
    answer: Answer = Answer(),
    settings: Settings,
) -> int:
    """Return the exit code of the summary.

    Args:
        out: Result, for any MCAP viewer, plot, export and report.
    """
    answer.check((*logs, *ensemble, settings.file), out)
    config = settings.load()

    from replay_kit.workflows.replay.inputs.job import ReplayJob, check_outputs
    from replay_kit.workflows.smooth import smooth as smooth_logs

    job = local_forecast(ReplayJob(logs, ensemble, out, overwrite=answer.overwrite), config)
    check_outputs(job, also_read=[settings.file], also_written=[answer.json_file])
    with part_named(out), progress() as advance:
        outcome = smooth_logs(job, config, advance)
    return answer.tell(out, outcome)
