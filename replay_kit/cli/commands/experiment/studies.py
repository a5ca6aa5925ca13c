"""``experiment paper``: the paper's study on any ensemble."""

from dataclasses import dataclass
from typing import Annotated

from replay_kit.cli.commands.experiment.study import (
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
