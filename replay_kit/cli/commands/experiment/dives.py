"""``experiment dives``: each dive of a log predicted from the dives before it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from replay_kit.cli.commands.experiment.truths import ESTIMATOR, FOLDER, existing, folder, name_page
from replay_kit.cli.console import console_beside, keep_json, progress, write_json
from replay_kit.cli.options import TO_OPTIONS, TO_OUTPUTS, Answer, Ensemble, Log, Processes, flag
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import check_folder, check_paths


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[Path | None, folder("a page, CSV and JSON"), FOLDER] = None


@takes_settings(
    "logs", "measurements", "forecast", "estimator", "time", "gating", without=ESTIMATOR
)
def dives(
    *logs: Log,
    ensemble: Ensemble,
    fit: Annotated[
        bool,
        flag(
            "--fit", "Fit errors and oscillations to the dives before; observations are not gated."
        ),
    ] = False,
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    outputs: Annotated[Outputs, TO_OUTPUTS] = Outputs(),
) -> int:
    """Return 0."""
    read, out = [*logs, *ensemble, settings.file], outputs.out
    if out is not None:
        check_folder(out)
    check_paths(read, [outputs.json_file], outputs.overwrite)
    config = settings.load()

    from replay_kit.estimator.evolving import build_evolving
    from replay_kit.studies.dives import (
        FILES,
        print_dives,
        read_dives,
        run_dives,
        to_json,
        write_dives,
    )
    from replay_kit.workflows.fleet.workers import calls_made_by
    from replay_kit.workflows.replay.inputs.forecast import read_forecasts
    from replay_kit.workflows.replay.inputs.region import find_region
    from replay_kit.workflows.replay.inputs.scan import look_ahead

    check_paths(read, [*existing(out, FILES), outputs.json_file], outputs.overwrite)
    if config.estimator.name != "reduced_basis" or config.estimator.preset != "default":
        raise ConfigError(
            "experiment dives predicts with the project's own estimator and its default preset; leave name and preset out"
        )
    place_at, first_ns = look_ahead(logs, config)
    found = read_dives(list(logs), config)
    region = find_region(logs, ensemble, config, first_ns, None, may_follow=False)
    forecasts = read_forecasts(ensemble, config, first_ns, place_at, region)
    with (
        calls_made_by(processes.scheduler, processes.workers),
        progress(config.output.threads) as advance,
    ):
        estimator = build_evolving(forecasts.series, config.estimator, config.time, config.gating)
        for result in run_dives(
            estimator, found, config, fit, " ".join(map(str, ensemble)), advance
        ):
            if out is not None:
                out.mkdir(exist_ok=True)
                write_dives(out, result)
            keep_json(outputs.json_file, to_json(result))
    console = console_beside(outputs.json_file)
    for note in forecasts.notes:
        console.print(f"Note: {note}", soft_wrap=True)
    print_dives(result, console)
    name_page(console, out)
    write_json(outputs.json_file, to_json(result))
    return 0
