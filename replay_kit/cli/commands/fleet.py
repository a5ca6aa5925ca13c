"""``fleet``: many missions, each an ordinary replay, in processes of this machine or a cluster."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.commands.ensemble import local_forecast
from replay_kit.cli.console import console_beside, keep_json, progress, write_json
from replay_kit.cli.options import (
    ENSEMBLE_HELP,
    FLAG,
    INPUTS,
    SOURCES,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    ConfigFile,
    Ending,
    Processes,
    argument,
    flag,
    option,
)
from replay_kit.config.run import laid_over
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import Address, check_folder, check_paths

if TYPE_CHECKING:
    from rich.console import Console

    from replay_kit.workflows.fleet.cluster import Workers
    from replay_kit.workflows.fleet.missions import FleetTable, Mission
    from replay_kit.workflows.fleet.run import Outcome


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """Options common to all missions.

    Attributes:
        place: Move each mission's ensemble to its log, as in replay.
    """

    ensemble: Annotated[
        tuple[Path, ...],
        option(
            "FILE...",
            group=INPUTS,
            help=f"Ensemble forecast of logs without a table: {ENSEMBLE_HELP}",
        ),
        SOURCES,
    ] = ()
    config: ConfigFile = None
    place: Annotated[bool, flag(name="--place-ensemble")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """Outputs of ``fleet``.

    Attributes:
        out: Folder for a result of each mission, a table and a page; made if absent.
    """

    out: Annotated[Path, option("DIR", alias="-o"), Ending()]


def fleet(
    *missions: Annotated[Path, argument("MISSIONS")],
    inputs: Annotated[Inputs, TO_INPUTS] = Inputs(),
    outputs: Annotated[Outputs, TO_OUTPUTS],
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    resume: Annotated[bool, FLAG] = False,
    dry_run: Annotated[bool, FLAG] = False,
) -> int:
    """Return the most severe exit code of the missions.

    Args:
        missions: A table (TOML), or patterns of logs, each of which is a mission of its own.
        resume: Keep existing results of the same inputs; replay the others.
        dry_run: Only check the inputs, and report the expected memory and time.
    """
    out = outputs.out
    check_folder(out)
    check_paths(
        [*missions, *inputs.ensemble, inputs.config], [outputs.json_file], outputs.overwrite
    )

    from replay_kit.workflows.fleet.cluster import open_workers
    from replay_kit.workflows.fleet.missions import (
        check_missions,
        missions_of,
    )
    from replay_kit.workflows.fleet.page import PAGE, TABLE

    table, folder = _table(missions, inputs)
    if inputs.place:
        settings = laid_over({"forecast": {"place": True}}, table.all.settings)
        common = table.all.model_copy(update={"settings": settings})
        table = table.model_copy(update={"all": common})
    each = missions_of(table, folder, inputs.config, out)
    console = console_beside(outputs.json_file)
    made = not out.exists()
    # before the results are checked, and the workers asked whether they see it
    out.mkdir(exist_ok=True)
    try:
        each = tuple(replace(one, job=local_forecast(one.job, one.config)) for one in each)
        check_missions(each, outputs.overwrite, resume)
        check_paths(missions, (out / TABLE, out / PAGE), outputs.overwrite or resume)
        with progress() as advance:
            advance(0, 0, "waiting for the workers")
            files = sorted({path.absolute() for mission in each for path in mission.files})
            with open_workers(
                processes.scheduler, processes.workers, files, out.absolute()
            ) as workers:
                console.print(f"{workers.size} workers of {workers.name}")
                if dry_run:
                    return _dry_run(each, workers, outputs, console)
                outcomes = _run(each, workers, outputs)
    finally:
        if made and not any(out.iterdir()):
            out.rmdir()
    return _answer(outcomes, outputs, console)


def _table(missions: tuple[Path, ...], inputs: Inputs) -> "tuple[FleetTable, Path]":
    """Return the table and the folder to which its paths are relative."""
    from replay_kit.workflows.fleet.missions import FleetTable, MissionEntry, load_fleet

    if [path.suffix.lower() for path in missions] == [".toml"]:
        if inputs.ensemble:
            raise ConfigError(
                f"--ensemble: {missions[0]} names the ensembles of missions; name it there, for all in [all]"
            )
        return load_fleet(missions[0]), missions[0].parent
    if not inputs.ensemble:
        raise ConfigError("fleet: expected a table (TOML), or logs with --ensemble FILE")
    entry = MissionEntry(each=tuple(map(str, missions)), ensemble=_texts(inputs.ensemble))
    return FleetTable(mission=(entry,)), Path()


def _texts(paths: tuple[Path, ...]) -> tuple[str, ...]:
    """Return paths as texts of a table."""
    return tuple(path.url if isinstance(path, Address) else str(path) for path in paths)


def _dry_run(
    each: "tuple[Mission, ...]", workers: "Workers", outputs: Outputs, console: "Console"
) -> int:
    """Print the expected memory and time of the missions; return the exit code of the first that cannot be replayed."""
    from replay_kit.workflows.fleet.page import expected_json, print_expected
    from replay_kit.workflows.fleet.run import expected_of

    made = workers.starmap(expected_of, zip(each))
    found = {mission.name: one for mission, one in zip(each, made, strict=True)}
    print_expected(found, workers.size, console)
    answer = expected_json(found, workers.size)
    write_json(outputs.json_file, answer)
    return int(answer["exit_code"])


def _run(
    each: "tuple[Mission, ...]", workers: "Workers", outputs: Outputs
) -> "tuple[Outcome, ...]":
    """Return the outcomes; the table is rewritten after each mission, so that an interrupt leaves it."""
    from replay_kit.core.files.atomic import claimed
    from replay_kit.core.words.progress import announce
    from replay_kit.workflows.fleet.page import TABLE, fleet_json, write_table
    from replay_kit.workflows.fleet.run import run_fleet

    outcomes: tuple[Outcome, ...] = ()
    with claimed(outputs.out / ".lock", outputs.out):
        for outcomes in run_fleet(
            each, workers, outputs.overwrite, lambda done, total, what: announce(what, done, total)
        ):
            write_table(outcomes, outputs.out / TABLE)
            keep_json(outputs.json_file, fleet_json(outcomes))
    return outcomes


def _answer(outcomes: "tuple[Outcome, ...]", outputs: Outputs, console: "Console") -> int:
    """Print the table, write the page and the JSON, and return the exit code."""
    from replay_kit.workflows.fleet.page import (
        PAGE,
        TABLE,
        exit_code,
        fleet_json,
        print_fleet,
        write_page,
    )

    write_page(outcomes, outputs.out / PAGE)
    print_fleet(outcomes, console)
    console.print(f"{outputs.out}: {TABLE}, a result of each mission")
    console.print(f"Page: {outputs.out / PAGE}; open it in a browser.")
    write_json(outputs.json_file, fleet_json(outcomes))
    return exit_code(outcomes)
