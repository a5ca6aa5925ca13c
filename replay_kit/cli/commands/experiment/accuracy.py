"""``experiment accuracy``: estimators compared on twin surveys."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from replay_kit.cli.commands.experiment.truths import (
    ESTIMATOR,
    FOLDER,
    OneTruth,
    existing,
    folder,
    name_page,
)
from replay_kit.cli.console import console_beside, keep_json, progress, write_json
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Noise,
    Processes,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.config.section import numbers
from replay_kit.core.errors import EstimatorError
from replay_kit.core.paths import check_folder, check_paths


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """What is compared, on what."""

    pings: Annotated[
        str,
        option("--pings", "Numbers of pings at which estimates are scored.", metavar="N1,N2,..."),
    ] = "5,10,25,50,150,450"
    noise: Noise = 0.09
    seeds: Annotated[
        int, option("--seeds", "Number of surveys of each truth, with seeds 0 to N-1.", least=1)
    ] = 5
    methods: Annotated[
        str | None,
        option(
            "--methods",
            "Estimators compared. Default: default,paper,paper_cells,naive3d,nearest,ensemble_mean,etkf,letkf,gp.",
            metavar="M1,M2,...",
        ),
    ] = None
    every: Annotated[
        int, option("--every", "Give estimators every N-th member only, from the first.", least=1)
    ] = 1
    mean_factors: Annotated[
        str,
        option(
            "--mean-factors",
            "What the ensemble mean is multiplied by in the members, and in the truth: 4,2 makes the mean current twice as strong in the "
            "forecast as it is.",
            metavar="MEMBERS,TRUTH",
        ),
    ] = "1,1"
    archive: Annotated[
        Path | None,
        option(
            "--archive",
            "Fields of a long run, as members. Lagged forecasts made of the ensemble's leads (--lead), and an archive window made of these "
            "fields, are compared with the ensemble.",
            metavar="FILE",
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[Path | None, folder("a page, CSV and JSON"), FOLDER] = None


@takes_settings(*PART_OF_FORECAST, "estimator", without=ESTIMATOR)
def accuracy(
    *,
    truths: Annotated[OneTruth, TO_INPUTS],
    survey: Annotated[Survey, TO_OPTIONS] = Survey(),
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    outputs: Annotated[Outputs, TO_OUTPUTS] = Outputs(),
) -> int:
    """Return 0.

    Raises:
        EstimatorError: Every method failed.
    """
    truths.check("accuracy")
    read, out = [*truths.files, survey.archive, settings.file], outputs.out
    if out is not None:
        check_folder(out)
    check_paths(read, [outputs.json_file], outputs.overwrite)
    config = settings.load()

    from replay_kit.studies.accuracy import (
        FILES,
        METHODS,
        AccuracyJob,
        Alteration,
        print_accuracy,
        read_sources,
        run_accuracy,
        to_json,
        write_accuracy,
    )
    from replay_kit.workflows.fleet.workers import calls_made_by

    check_paths(read, [*existing(out, FILES), outputs.json_file], outputs.overwrite)
    counts = tuple(int(n) for n in numbers(survey.pings, "--pings"))
    methods = METHODS if survey.methods is None else tuple(survey.methods.split(","))
    of_members, of_truth = numbers(survey.mean_factors, "--mean-factors", "MEMBERS,TRUTH")
    alteration = Alteration(survey.every, (of_members, of_truth))
    job = AccuracyJob(truths.leave_out, counts, survey.noise, survey.seeds, methods, alteration)
    members, withheld = truths.read(config.forecast)
    sources = (
        None
        if survey.archive is None
        else read_sources(truths.ensemble, survey.archive, config.forecast)
    )
    with (
        calls_made_by(processes.scheduler, processes.workers),
        progress(config.output.threads) as advance,
    ):
        for result in run_accuracy(members, withheld, config.estimator, job, advance, sources):
            if out is not None:
                out.mkdir(exist_ok=True)
                write_accuracy(out, result)
            keep_json(outputs.json_file, to_json(result))
    console = console_beside(outputs.json_file)
    print_accuracy(result, console)
    name_page(console, out)
    write_json(outputs.json_file, to_json(result))
    if all(row.failed for row in result.rows):
        raise EstimatorError(
            f"experiment accuracy: every method failed, the first with {result.rows[0].failed}"
        )
    return 0
