"""The command line's studies: how well the estimator does, and against what."""

from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from replay_kit.cli.dives import dives
from replay_kit.cli.options import (
    ConfigOption,
    JsonOption,
    LeadOption,
    LevelsOption,
    LevelStepOption,
    ModesOption,
    NoiseOption,
    OnceCommand,
    OverwriteOption,
    RegionOption,
    bar,
    console_beside,
    ends_in,
    forecast_part,
    keep_json,
    numbers,
    write_json,
)
from replay_kit.cli.planning import planning
from replay_kit.config.run import ForecastConfig, load_config
from replay_kit.core.errors import ConfigError, EstimatorError
from replay_kit.core.grid import Ensemble
from replay_kit.forecast import read_ensemble, read_series, read_truth
from replay_kit.studies import bindings
from replay_kit.studies import missions as on_missions
from replay_kit.studies.accuracy import METHODS, AccuracyJob, run_accuracy
from replay_kit.studies.accuracy_text import print_accuracy, to_json
from replay_kit.studies.paper import FILES, PaperJob, check_folder, print_paper, run_paper, write_paper
from replay_kit.studies.paper import to_json as paper_json
from replay_kit.workflows.replay.job import check_paths, truth_path

experiment = typer.Typer(
    help="Studies: how well the estimator does, and against what.", no_args_is_help=True, rich_markup_mode=None, add_completion=False
)
experiment.command(cls=OnceCommand)(dives)
experiment.command(cls=OnceCommand)(planning)


@experiment.command(cls=OnceCommand)
def accuracy(
    ensemble: Annotated[Path, typer.Option("--ensemble", metavar="E.nc", help="Ensemble forecast.")],
    truth: Annotated[str | None, typer.Option("--truth", metavar="T.nc[#member]", help="The truth to tell.")] = None,
    leave_out: Annotated[str | None, typer.Option("--leave-out", metavar="K|all|most-distant", help="Members withheld as truths.")] = None,
    lead: LeadOption = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    level_step: LevelStepOption = None,
    modes: ModesOption = None,
    pings: Annotated[str, typer.Option("--pings", metavar="N1,N2,...", help="Numbers of pings scored.")] = "5,10,25,50,150,450",
    noise: NoiseOption = 0.09,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Seeds 0 to N-1.")] = 5,
    methods: Annotated[str, typer.Option("--methods", metavar="M1,M2,...", help="Estimators compared.")] = ",".join(METHODS),
    config: ConfigOption = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Compare estimators on twin surveys: error, calibration, against the number of pings."""
    check_paths([ensemble, truth_path(truth), config], [json_file], overwrite)
    settings = load_config(config, {"forecast": forecast_part(region, levels, level_step, lead), "estimator": {"modes": modes}})
    _require_one_truth("accuracy", truth, leave_out)
    counts = tuple(int(n) for n in numbers(pings, "--pings") or ())
    job = AccuracyJob(leave_out, counts, noise, seeds, tuple(methods.split(",")))
    members, withheld = _read(ensemble, truth, settings.forecast)
    with threadpool_limits(limits=settings.output.threads), bar() as advance:
        result = run_accuracy(members, withheld, settings.estimator, job, advance, lambda partial: keep_json(json_file, to_json(partial)))
    print_accuracy(result, console_beside(json_file))
    write_json(json_file, to_json(result))
    if all(row.failed for row in result.rows):
        raise EstimatorError(f"experiment accuracy: every method failed, the first with {result.rows[0].failed}")


@experiment.command(cls=OnceCommand)
def paper(
    ensemble: Annotated[Path, typer.Option("--ensemble", metavar="E.nc", help="Ensemble forecast.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", callback=ends_in(), help="Folder for tables, figures and report; made if absent.")
    ],
    truth: Annotated[str | None, typer.Option("--truth", metavar="T.nc[#member]", help="The truth to tell.")] = None,
    leave_out: Annotated[str | None, typer.Option("--leave-out", metavar="K|all|most-distant", help="Members withheld as truths.")] = None,
    lead: LeadOption = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    level_step: LevelStepOption = None,
    modes: Annotated[
        str | None,
        typer.Option("--modes", metavar="N|all", help="Most basis flows a level anywhere; all: plan on the full rank, not on 300."),
    ] = None,
    pairs: Annotated[int, typer.Option("--pairs", min=1, help="Starts and targets of the glides.")] = 100,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of places, noise, starts and targets.")] = 0,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Compute the study of Kong et al. (IROS 2021) on an ensemble: its tables, figures, and a report of where its method stands."""
    _require_one_truth("paper", truth, leave_out)
    inputs = [ensemble, truth_path(truth)]
    check_folder(out)
    check_paths(inputs, [*(out / name for name in FILES if out.exists()), json_file], overwrite)
    settings = load_config(None, {"forecast": forecast_part(region, levels, level_step, lead), "estimator": {"modes": modes}})
    most = None if modes is None else settings.estimator.modes
    job = PaperJob(leave_out=leave_out, most_modes=most, plan_modes=settings.estimator.modes, pairs=pairs, seed=seed)
    members, withheld = _read(ensemble, truth, settings.forecast)
    # made before the work, so that a folder that cannot be made is said at once
    out.mkdir(exist_ok=True)
    with threadpool_limits(limits=settings.output.threads), bar() as advance:
        tables, shown = run_paper(members, withheld, settings.estimator, job, bindings.glide_calls(), advance)
        write_paper(out, tables, shown)
    console = console_beside(json_file)
    print_paper(tables, console)
    console.print(f"{out}: report.md, paper.json, tables as CSV, figures as PNG and SVG", soft_wrap=True)
    write_json(json_file, paper_json(tables))


@experiment.command(cls=OnceCommand)
def missions(
    ensemble: Annotated[Path, typer.Option("--ensemble", metavar="E.nc", help="Ensemble forecast.")],
    leave_out: Annotated[str, typer.Option("--leave-out", metavar="K,K,...|all", help="Members withheld as truths, in turn.")],
    lead: LeadOption = None,
    reference_time: Annotated[
        str | None, typer.Option("--reference-time", help="Start of the forecast, for a file of leads without one.")
    ] = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    level_step: LevelStepOption = None,
    modes: ModesOption = None,
    study: Annotated[str | None, typer.Option("--study", metavar="S1,S2,...", help=f"Of {', '.join(on_missions.STUDIES)}.")] = None,
    pings: Annotated[int, typer.Option("--pings", min=1, help="Pings of a mission.")] = 160,
    days: Annotated[float, typer.Option("--days", help="Over which they are spread; a truth that changes ends them sooner.")] = 20.0,
    dives: Annotated[int, typer.Option("--dives", min=1, help="Dives of the missions that have mean currents alone.")] = 30,
    noise: NoiseOption = 0.09,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Missions for each truth.")] = 1,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", callback=ends_in(), help="Folder for CSV and JSON; made if absent.")
    ] = None,
    config: ConfigOption = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Fly gliders through members left out: through time, relative profiles, mean currents, outliers, biases, intervals."""
    if out is not None:
        check_folder(out)
    written = [out / name for name in on_missions.FILES if (out / name).exists()] if out is not None else []
    check_paths([ensemble, config], [*written, json_file], overwrite)
    part = {**forecast_part(region, levels, level_step, lead), "reference_time": reference_time}
    settings = load_config(config, {"forecast": part, "estimator": {"modes": modes}})
    series = read_series(ensemble, settings.forecast)
    # of a truth that stays as it is nothing can be said through time
    usual = tuple(name for name in on_missions.STUDIES if name != "time" or len(series) > 1)
    job = on_missions.MissionJob(leave_out, usual if study is None else tuple(study.split(",")), pings, days, dives, noise, seeds)
    with threadpool_limits(limits=settings.output.threads), bar() as advance:
        result = on_missions.run_missions(series, settings, job, advance)
    if out is not None:
        out.mkdir(exist_ok=True)
        on_missions.write_missions(out, result)
    on_missions.print_missions(result, console_beside(json_file))
    write_json(json_file, on_missions.to_json(result))


def _require_one_truth(command: str, truth: str | None, leave_out: str | None) -> None:
    if (truth is None) == (leave_out is None):
        raise ConfigError(f"experiment {command}: expected one of --truth and --leave-out")


def _read(ensemble: Path, truth: str | None, config: ForecastConfig) -> tuple[Ensemble, Ensemble | None]:
    return read_ensemble(ensemble, config), None if truth is None else read_truth(truth, config)
