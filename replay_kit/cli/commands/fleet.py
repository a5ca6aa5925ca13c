"""``fleet``: many missions, each an ordinary replay, in processes of this machine or a cluster."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.commands.ensemble import local_forecast
from replay_kit.cli.console import keep_json, progress
from replay_kit.cli.options import (
    ENSEMBLE_HELP,
    INPUTS,
    SOURCES,
    TO_INPUTS,
    Answer,
    ConfigFile,
    Ending,
    Processes,
    Switch,
    argument,
    flag,
    option,
    output,
)
from replay_kit.config.run import laid_over
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import Address, check_folder, check_paths

if TYPE_CHECKING:
    from replay_kit.workflows.fleet.missions import FleetTable


@TO_INPUTS
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


def fleet(
    *missions: Annotated[Path, argument("MISSIONS")],
    inputs: Inputs = Inputs(),
    out: Annotated[Path, output("DIR"), Ending()],
    answer: Answer = Answer(),
    processes: Processes = Processes(),
    resume: Switch = False,
    dry_run: Switch = False,
) -> int:
    """Return the most severe exit code of the missions.

    Args:
        missions: A table (TOML), or patterns of logs, each of which is a mission of its own.
        out: Folder for a result of each mission, a table and a page; made if absent.
        resume: Keep existing results of the same inputs; replay the others.
        dry_run: Only check the inputs, and report the expected memory and time.
    """
    check_folder(out)
    answer.check([*missions, *inputs.ensemble, inputs.config])

    from replay_kit.core.files.atomic import claimed
    from replay_kit.workflows.fleet import page
    from replay_kit.workflows.fleet.cluster import open_workers
    from replay_kit.workflows.fleet.missions import check_missions, missions_of
    from replay_kit.workflows.fleet.run import expected_of, run_fleet

    table, folder = _table(missions, inputs)
    if inputs.place:
        settings = laid_over({"forecast": {"place": True}}, table.all.settings)
        common = table.all.model_copy(update={"settings": settings})
        table = table.model_copy(update={"all": common})
    each = missions_of(table, folder, inputs.config, out)
    console, made = answer.console(), not out.exists()
    # before the results are checked, and the workers asked whether they see it
    out.mkdir(exist_ok=True)
    try:
        each = tuple(replace(one, job=local_forecast(one.job, one.config)) for one in each)
        check_missions(each, answer.overwrite, resume)
        written = out / page.TABLE, out / page.PAGE
        check_paths(missions, written, answer.overwrite or resume)
        with progress() as advance:
            advance(0, 0, "waiting for the workers")
            files = sorted({path.absolute() for mission in each for path in mission.files})
            with open_workers(
                processes.scheduler, processes.workers, files, out.absolute()
            ) as workers:
                console.print(f"{workers.size} workers of {workers.name}")
                if dry_run:
                    asked = workers.starmap(expected_of, zip(each))
                    found = {one.name: told for one, told in zip(each, asked, strict=True)}
                    page.print_expected(found, workers.size, console)
                    expected = page.expected_json(found, workers.size)
                    answer.write(expected)
                    return int(expected["exit_code"])
                with claimed(out / ".lock", out):
                    # after each mission, so that an interrupt leaves them
                    for outcomes in run_fleet(each, workers, answer.overwrite, advance):
                        page.write_table(outcomes, written[0])
                        keep_json(answer.json_file, page.fleet_json(outcomes))
    finally:
        if made and not any(out.iterdir()):
            out.rmdir()
    page.write_page(outcomes, written[1])
    page.print_fleet(outcomes, console)
    console.print(f"{out}: {page.TABLE}, a result of each mission")
    console.print(f"Page: {written[1]}; open it in a browser.")
    answer.write(page.fleet_json(outcomes))
    return page.exit_code(outcomes)


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
    ensemble = tuple(one.url if isinstance(one, Address) else str(one) for one in inputs.ensemble)
    entry = MissionEntry(each=tuple(map(str, missions)), ensemble=ensemble)
    return FleetTable(mission=(entry,)), Path()
