"""``fit``: the prior fitted to an ensemble."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from replay_kit.cli.commands.fetch import local_ensemble
from replay_kit.cli.console import console_beside, progress, write_json
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Ending,
    Processes,
    argument,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.paths import check_paths


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[
        Path,
        option("--out -o", "Fitted settings, for --config.", metavar="TOML"),
        Ending((".toml",)),
    ]


@takes_settings(*PART_OF_FORECAST, "estimator.modes", file=False)
def fit(
    *ensemble: Annotated[
        Path,
        argument("ENSEMBLE", "Ensemble forecast: NetCDF files, Zarr stores, folders or patterns."),
    ],
    outputs: Annotated[Outputs, TO_OUTPUTS],
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    left_out: Annotated[
        int, option("--left-out", "Number of members left out in turn (cross-validation).", least=1)
    ] = 12,
) -> int:
    """Return 0."""
    check_paths(ensemble, [outputs.out, outputs.json_file], outputs.overwrite)
    config = settings.load()

    from replay_kit.forecast import read_ensemble
    from replay_kit.workflows.fit import fit_json, fit_prior, print_fit, write_fit
    from replay_kit.workflows.fleet.workers import calls_made_by

    members = read_ensemble(local_ensemble(ensemble, (), config), config.forecast)
    with calls_made_by(processes.scheduler, processes.workers), progress(config.output.threads):
        fitted = fit_prior(members, config.estimator, left_out)
    write_fit(fitted, outputs.out)
    print_fit(fitted, console_beside(outputs.json_file))
    write_json(outputs.json_file, fit_json(fitted))
    return 0
