"""``experiment planning``: missions planned on estimates, flown in truths that the estimates do not know."""

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
    truths: Annotated[Truths, TO_INPUTS],
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
