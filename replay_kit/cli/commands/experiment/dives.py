"""``experiment dives``: each dive of a log predicted from the dives before it."""

from typing import Annotated

from replay_kit.cli.commands.experiment.truths import ESTIMATOR
from replay_kit.cli.console import console_beside, keep_json, progress, write_json
from replay_kit.cli.options import TO_OUTPUTS, Answer, Ensemble, Log, flag
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import check_paths


@takes_settings("logs", "measurements", "forecast", "estimator", "time", "gating", without=ESTIMATOR)
def dives(
    *logs: Log,
    ensemble: Ensemble,
    fit: Annotated[bool, flag("--fit", "Fit errors and oscillations to the dives before; observations are not gated.")] = False,
    settings: Settings,
    answer: Annotated[Answer, TO_OUTPUTS] = Answer(),
) -> int:
    """Return 0."""
    check_paths([*logs, *ensemble, settings.file], [answer.json_file], answer.overwrite)
    config = settings.load()

    from replay_kit.estimator.evolving import build_evolving
    from replay_kit.studies.dives import print_dives, read_dives, run_dives, to_json
    from replay_kit.workflows.replay.build import read_forecasts
    from replay_kit.workflows.replay.inputs import look_ahead

    if config.estimator.name != "reduced_basis" or config.estimator.preset != "default":
        raise ConfigError("experiment dives predicts with the project's own estimator and its default preset; leave name and preset out")
    place_at, first_ns = look_ahead(logs, config)
    found = read_dives(list(logs), config)
    forecasts = read_forecasts(ensemble, config, first_ns, place_at)
    with progress(config.output.threads) as advance:
        estimator = build_evolving(forecasts.series, config.estimator, config.time, config.gating)
        for result in run_dives(estimator, found, config, fit, " ".join(map(str, ensemble)), advance):
            keep_json(answer.json_file, to_json(result))
    console = console_beside(answer.json_file)
    for note in forecasts.notes:
        console.print(f"Note: {note}", soft_wrap=True)
    print_dives(result, console)
    write_json(answer.json_file, to_json(result))
    return 0
