"""``experiment planning``: plans made on estimates, flown in truths that the estimates do not know."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.commands.experiment.truths import (
    ESTIMATOR,
    FOLDER,
    OneTruth,
    folder,
    name_page,
    parts,
)
from replay_kit.cli.console import console_beside, progress, write_json
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Noise,
    Processes,
    flag,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError, EstimatorError
from replay_kit.core.paths import check_folder, check_paths

if TYPE_CHECKING:
    from replay_kit.studies.planning import PlanningJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Truths(OneTruth):
    """The ensemble and its truths."""

    leave_out: Annotated[
        str | None,
        option(
            "--leave-out",
            "Members that are withheld as truths. Default: 20 evenly spread.",
            metavar="K,K,...|all",
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """What is planned, and how many of each."""

    study: Annotated[
        str | None,
        parts(
            "glides, missions, scenarios, masked, odds, infeasible, replanning; if named, learn, and changing for a forecast through time"
        ),
    ] = None
    pairs: Annotated[
        int,
        option(
            "--pairs",
            "Number of starts and goals of glides, missions and odds, over all truths.",
            least=1,
        ),
    ] = 100
    pings: Annotated[int, option("--pings", "Number of pings of each estimate.", least=1)] = 450
    legs: Annotated[int, option("--legs", "Number of dives of a mission.", least=1)] = 10
    scenarios: Annotated[
        int, option("--scenarios", "Number of missions planned for samples.", least=1)
    ] = 10
    fresh: Annotated[
        int,
        option(
            "--fresh", "Number of further samples that these and odds are flown through.", least=1
        ),
    ] = 500
    masks: Annotated[
        int, option("--masks", "Number of random cases with islands and areas.", least=1)
    ] = 200
    replans: Annotated[
        int, option("--replans", "Number of missions planned anew at each surfacing.", least=1)
    ] = 40
    crossings: Annotated[
        int, option("--crossings", "Number of missions of days in a sea that changes.", least=1)
    ] = 40
    learn: Annotated[
        bool, flag("--learn", "Plans that learn alone: the same as --study learn.")
    ] = False
    surveys: Annotated[
        int,
        option(
            "--surveys", "Number of surveys before a stretch without fixes, with --learn.", least=1
        ),
    ] = 60
    maps: Annotated[int, option("--maps", "Number of maps, with --learn.", least=1)] = 24
    detours: Annotated[
        int,
        option("--detours", "Number of missions that may go by a detour, with --learn.", least=1),
    ] = 36
    noise: Noise = 0.09
    seed: Annotated[int, option("--seed", "Seed of everything that is drawn.", least=0)] = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[Path, folder("a page, report, tables and pictures"), FOLDER]


@takes_settings(*PART_OF_FORECAST, "estimator", without=ESTIMATOR)
def planning(
    *,
    truths: Annotated[Truths, TO_INPUTS],
    outputs: Annotated[Outputs, TO_OUTPUTS],
    sizes: Annotated[Sizes, TO_OPTIONS] = Sizes(),
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
) -> int:
    """Return 0.

    Raises:
        EstimatorError: Every part of the study failed.
    """
    read, out = [*truths.files, settings.file], outputs.out
    check_folder(out)
    check_paths(read, [outputs.json_file], outputs.overwrite)
    config = settings.load()

    from replay_kit.forecast import read_series
    from replay_kit.studies import planning as study
    from replay_kit.workflows.fleet.workers import calls_made_by

    chosen = _chosen(sizes, truths.truth is not None)
    check_paths(read, [*study.replaced_files(out, chosen), outputs.json_file], outputs.overwrite)
    job = _job(chosen, truths, sizes)
    # before anything is read or made
    job.check(study.STUDIES)
    members, withheld = truths.read(config.forecast)
    series = (
        read_series(truths.ensemble, config.forecast)
        if {study.THROUGH_TIME, study.LEARNING} & set(chosen)
        else ()
    )

    with (
        calls_made_by(processes.scheduler, processes.workers),
        progress(config.output.threads) as advance,
    ):
        for result in study.run_planning(members, withheld, config.estimator, job, advance, series):
            # made before the first study, so that a folder that cannot be made is reported at once
            out.mkdir(exist_ok=True)
            if result.reports:
                study.write_planning(out, result)
    console = console_beside(outputs.json_file)
    study.print_planning(result, console)
    console.print(
        f"{out}: report.md, planning.json, tables as CSV, pictures as PNG", soft_wrap=True
    )
    name_page(console, out)
    write_json(outputs.json_file, study.to_json(result))
    if all(report.failed for report in result.reports):
        raise EstimatorError(
            f"experiment planning: every study failed, the first with {result.reports[0].failed}"
        )
    return 0


def _chosen(sizes: Sizes, own_truth: bool) -> tuple[str, ...]:
    """Return the names of the studies asked for; without any, those that need not be named.

    Raises:
        ConfigError: ``--learn`` is given beside another study.
    """
    from replay_kit.studies import planning as study

    if sizes.learn and sizes.study not in (None, study.LEARNING):
        raise ConfigError(
            f"--learn and --study: expected one of them, or --study learn, got --study {sizes.study}"
        )
    named = study.LEARNING if sizes.learn else sizes.study
    if named is not None:
        return tuple(named.split(","))
    left = (study.THROUGH_TIME, study.LEARNING, *((study.WITHOUT_TRUTH,) if own_truth else ()))
    return tuple(name for name in study.STUDIES if name not in left)


def _job(chosen: tuple[str, ...], truths: Truths, sizes: Sizes) -> "PlanningJob":
    """Return the job of some studies."""
    from replay_kit.studies import planning as study

    return study.PlanningJob(
        chosen,
        truths.leave_out,
        sizes.pairs,
        sizes.pings,
        sizes.noise,
        sizes.legs,
        scenarios=sizes.scenarios,
        fresh=sizes.fresh,
        masks=sizes.masks,
        replans=sizes.replans,
        crossings=sizes.crossings,
        seed=sizes.seed,
        surveys=sizes.surveys,
        maps=sizes.maps,
        detours=sizes.detours,
    )
