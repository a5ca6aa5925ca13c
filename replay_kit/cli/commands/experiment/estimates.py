"""``experiment accuracy`` and ``paper``: estimators compared on twin surveys."""

from dataclasses import dataclass
from typing import Annotated

from replay_kit.cli.commands.experiment.study import (
    ESTIMATOR,
    OneTruth,
    Outputs,
    Report,
    check_outputs,
    run_study,
)
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Noise,
    Processes,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.config.option import numbers
from replay_kit.core.errors import EstimatorError


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
    read = [*truths.files, settings.file]
    config = settings.load()

    from replay_kit.studies.accuracy import METHODS, AccuracyJob, page, run_accuracy

    check_outputs(read, outputs, page.FILES)
    counts = tuple(int(n) for n in numbers(survey.pings, "--pings"))
    methods = METHODS if survey.methods is None else tuple(survey.methods.split(","))
    job = AccuracyJob(truths.leave_out, counts, survey.noise, survey.seeds, methods)
    members, withheld = truths.read(config.forecast)
    result = run_study(
        page.report_of,
        lambda advance: run_accuracy(members, withheld, config.estimator, job, advance),
        outputs,
        config,
        processes,
    )
    if all(row.failed for row in result.rows):
        raise EstimatorError(
            f"experiment accuracy: every method failed, the first with {result.rows[0].failed}"
        )
    return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperSizes:
    """How much is computed."""

    modes: Annotated[
        str | None,
        option(
            "--modes",
            "Most modes per level anywhere. Default: tables to the full rank, plans on 300; all: plans on it too.",
            metavar="N|all",
        ),
    ] = None
    pairs: Annotated[
        int, option("--pairs", "Number of starts and targets of the glides.", least=1)
    ] = 100
    seed: Annotated[
        int, option("--seed", "Seed of places, noise, starts and targets.", least=0)
    ] = 0


@takes_settings(*PART_OF_FORECAST, file=False)
def paper(
    *,
    truths: Annotated[OneTruth, TO_INPUTS],
    outputs: Annotated[Report, TO_OUTPUTS],
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    sizes: Annotated[PaperSizes, TO_OPTIONS] = PaperSizes(),
) -> int:
    """Return 0."""
    truths.check("paper")
    config = settings.load(estimator={"modes": sizes.modes})

    from replay_kit.studies.paper import PaperJob, page, run_paper

    check_outputs(truths.files, outputs, page.FILES)
    most = None if sizes.modes is None else config.estimator.modes
    job = PaperJob(
        leave_out=truths.leave_out,
        most_modes=most,
        plan_modes=config.estimator.modes,
        pairs=sizes.pairs,
        seed=sizes.seed,
    )
    members, withheld = truths.read(config.forecast)
    # at once, so that a folder that cannot be made is reported before the work
    outputs.out.mkdir(exist_ok=True)
    run_study(
        page.report_of,
        lambda advance: run_paper(members, withheld, config.estimator, job, advance),
        outputs,
        config,
        processes,
    )
    return 0
