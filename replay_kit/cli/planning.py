"""The study of plans flown in truths that the estimates do not know."""

from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from replay_kit.cli.options import (
    ConfigOption,
    JsonOption,
    LeadOption,
    LevelsOption,
    LevelStepOption,
    ModesOption,
    NoiseOption,
    OverwriteOption,
    RegionOption,
    bar,
    console_beside,
    ends_in,
    forecast_part,
    write_json,
)
from replay_kit.config.run import load_config
from replay_kit.core.errors import EstimatorError
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.studies import bindings
from replay_kit.studies import planning as on_planning
from replay_kit.studies.paper import check_folder
from replay_kit.workflows.replay.job import check_paths, truth_path


def planning(
    ensemble: Annotated[Path, typer.Option("--ensemble", metavar="E.nc", help="Ensemble forecast.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", callback=ends_in(), help="Folder for report, tables and pictures; made if absent.")
    ],
    leave_out: Annotated[
        str | None, typer.Option("--leave-out", metavar="K,K,...|all", help="Members withheld as truths; 20 evenly spread by default.")
    ] = None,
    truth: Annotated[
        str | None, typer.Option("--truth", metavar="T.nc[#member]", help="A truth of its own; no member is left out.")
    ] = None,
    study: Annotated[str | None, typer.Option("--study", metavar="S1,S2,...", help=f"Of {', '.join(on_planning.STUDIES)}.")] = None,
    pairs: Annotated[int, typer.Option("--pairs", min=1, help="Starts and goals of glides and missions, over all truths.")] = 100,
    pings: Annotated[int, typer.Option("--pings", min=1, help="Given to each estimate.")] = 450,
    legs: Annotated[int, typer.Option("--legs", min=1, help="Dives of a mission.")] = 10,
    scenarios: Annotated[int, typer.Option("--scenarios", min=1, help="Missions planned for samples.")] = 10,
    fresh: Annotated[int, typer.Option("--fresh", min=1, help="Other samples that these are flown through.")] = 500,
    masks: Annotated[int, typer.Option("--masks", min=1, help="Random cases with islands and areas.")] = 200,
    replans: Annotated[int, typer.Option("--replans", min=1, help="Missions planned anew at each surfacing.")] = 40,
    noise: NoiseOption = 0.09,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of everything that is drawn.")] = 0,
    lead: LeadOption = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    level_step: LevelStepOption = None,
    modes: ModesOption = None,
    config: ConfigOption = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Plan on estimates, fly in the truth: glides, missions, scenarios, islands drawn at random, problems without a solution."""
    possible = [name for name in on_planning.STUDIES if truth is None or name != on_planning.WITHOUT_TRUTH]
    chosen = tuple(possible) if study is None else tuple(study.split(","))
    check_folder(out)
    check_paths([ensemble, truth_path(truth), config], [*on_planning.replaced_files(out, chosen), json_file], overwrite)
    settings = load_config(config, {"forecast": forecast_part(region, levels, level_step, lead), "estimator": {"modes": modes}})
    sizes = {"scenarios": scenarios, "fresh": fresh, "masks": masks, "replans": replans}
    job = on_planning.PlanningJob(chosen, leave_out, pairs, pings, noise, legs, **sizes, seed=seed)
    # before anything is read or made
    job.check(on_planning.STUDIES)
    members = read_ensemble(ensemble, settings.forecast)
    withheld = None if truth is None else read_truth(truth, settings.forecast)

    def keep(partial: on_planning.PlanningResult) -> None:
        # made before the first study, so that a folder that cannot be made is said at once
        out.mkdir(exist_ok=True)
        if partial.told:
            on_planning.write_planning(out, partial)

    with threadpool_limits(limits=settings.output.threads), bar() as advance:
        result = on_planning.run_planning(members, withheld, settings.estimator, job, bindings.PLANNING_CALLS, advance, keep)
    console = console_beside(json_file)
    on_planning.print_planning(result, console)
    console.print(f"{out}: report.md, planning.json, tables as CSV, pictures as PNG", soft_wrap=True)
    write_json(json_file, on_planning.to_json(result))
    if all(told.failed for told in result.told):
        raise EstimatorError(f"experiment planning: every study failed, the first with {result.told[0].failed}")
