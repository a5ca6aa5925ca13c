"""The study of a glider's own logs: each dive predicted from the dives before it."""

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
    OverwriteOption,
    RegionOption,
    bar,
    console_beside,
    forecast_part,
    write_json,
)
from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.errors import ConfigError
from replay_kit.estimator.evolving import build_evolving
from replay_kit.studies.dives import print_dives, read_dives, run_dives, to_json
from replay_kit.workflows.paths import check_paths
from replay_kit.workflows.replay.build import read_forecasts
from replay_kit.workflows.replay.inputs import look_ahead


def dives(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs of one mission, merged by time.")],
    ensemble: Annotated[Path, typer.Option("--ensemble", metavar="E.nc", help="Ensemble forecast.")],
    place_ensemble: Annotated[bool, typer.Option("--place-ensemble", help="Move the ensemble's centre to the mean fix.")] = False,
    fit: Annotated[bool, typer.Option("--fit", help="Fit errors and oscillations to the dives before; nothing is gated.")] = False,
    time_scale: Annotated[str | None, typer.Option("--time-scale", metavar="S|auto|static", help="As time.scale.")] = None,
    oscillators: Annotated[str | None, typer.Option("--oscillators", metavar="O1,O2,...", help="As time.oscillators.")] = None,
    config: ConfigOption = None,
    lead: LeadOption = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    level_step: LevelStepOption = None,
    modes: ModesOption = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Predict each dive of a log from the dives before it: profiles, depth-averaged current, place of surfacing."""
    check_paths([*logs, ensemble, config], [json_file], overwrite)
    settings = load_config(
        config,
        {
            "forecast": {**forecast_part(region, levels, level_step, lead), "place": place_ensemble or None},
            "estimator": {"modes": modes},
            "time": {"scale": _scale(time_scale), "oscillators": oscillators.split(",") if oscillators else None},
        },
    )
    _require_own(settings)
    place_at, first_ns = look_ahead(logs, settings)
    found = read_dives(logs, settings)
    forecasts = read_forecasts(ensemble, settings, first_ns, place_at)
    with threadpool_limits(limits=settings.output.threads), bar() as advance:
        estimator = build_evolving(forecasts.series, settings.estimator, settings.time, settings.gating)
        result = run_dives(estimator, found, settings, fit, str(ensemble), advance)
    console = console_beside(json_file)
    for note in forecasts.notes:
        console.print(f"Note: {note}", soft_wrap=True)
    print_dives(result, console)
    write_json(json_file, to_json(result))


def _scale(text: str | None) -> str | float | None:
    """Return a time scale [s], one of its words, or what was given for the configuration to refuse."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def _require_own(config: RunConfig) -> None:
    if config.estimator.name != "reduced_basis" or config.estimator.preset != "default":
        raise ConfigError("experiment dives predicts with the project's own estimator and its default preset; leave name and preset out")
