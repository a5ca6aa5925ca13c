"""``experiment paper`` and ``planning``: the paper's study on any ensemble, and odds of plans."""

from dataclasses import dataclass
from typing import Annotated

from replay_kit.cli.commands.experiment.study import (
    ESTIMATOR,
    OneTruth,
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
    truths.check("experiment paper")
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecasts(OneTruth):
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
    """How much is planned."""

    pairs: Annotated[
        int,
        option(
            "--pairs",
            "Number of missions, over all truths.",
            least=1,
        ),
    ] = 100
    pings: Annotated[int, option("--pings", "Number of pings of each estimate.", least=1)] = 450
    legs: Annotated[
        int, option("--legs", "Number of dives of the missions that goals are drawn with.", least=1)
    ] = 10
    fresh: Annotated[
        int, option("--fresh", "Number of fresh samples that odds are compared with.", least=1)
    ] = 500
    noise: Noise = 0.09
    seed: Annotated[int, option("--seed", "Seed of everything that is drawn.", least=0)] = 0


@takes_settings(*PART_OF_FORECAST, "estimator", without=ESTIMATOR)
def planning(
    *,
    truths: Annotated[Forecasts, TO_INPUTS],
    outputs: Annotated[Report, TO_OUTPUTS],
    sizes: Annotated[Sizes, TO_OPTIONS] = Sizes(),
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
) -> int:
    """Return 0."""
    read = [*truths.files, settings.file]
    config = settings.load()

    from replay_kit.studies.planning import PlanningJob, page, run_planning

    job = PlanningJob(
        truths.leave_out,
        sizes.pairs,
        sizes.pings,
        sizes.noise,
        sizes.legs,
        fresh=sizes.fresh,
        seed=sizes.seed,
    )
    check_outputs(read, outputs, page.FILES)
    # before anything is read or made
    job.check()
    members, withheld = truths.read(config.forecast)
    run_study(
        page.report_of,
        lambda advance: run_planning(members, withheld, config.estimator, job, advance),
        outputs,
        config,
        processes,
    )
    return 0
