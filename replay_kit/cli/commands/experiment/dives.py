"""``experiment dives``: each dive of a log predicted from the dives before it."""

from collections.abc import Iterator
from typing import Annotated

from replay_kit.cli.commands.experiment.study import (
    ESTIMATOR,
    Outputs,
    check_outputs,
    run_study,
)
from replay_kit.cli.commands.fetch import local_ensemble
from replay_kit.cli.options import TO_OPTIONS, TO_OUTPUTS, Ensemble, Log, Processes, flag
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.progress import Progress


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
    read = [*logs, *ensemble, settings.file]
    config = settings.load()

    from replay_kit.estimator.evolving import build_evolving
    from replay_kit.studies.dives import DivesResult, page, read_dives, run_dives
    from replay_kit.workflows.replay.inputs.forecast import read_forecasts
    from replay_kit.workflows.replay.inputs.region import find_region
    from replay_kit.workflows.replay.inputs.scan import look_ahead

    check_outputs(read, outputs, page.FILES)
    if config.estimator.name != "reduced_basis" or config.estimator.preset != "default":
        raise ConfigError(
            "experiment dives predicts with the project's own estimator and its default preset; leave name and preset out"
        )
    place_at, first_ns = look_ahead(logs, config)
    found = read_dives(list(logs), config)
    ensemble = local_ensemble(ensemble, logs, config)
    region = find_region(logs, ensemble, config, first_ns, None, may_follow=False)
    forecasts = read_forecasts(ensemble, config, first_ns, place_at, region)

    def results(advance: Progress) -> Iterator[DivesResult]:
        estimator = build_evolving(forecasts.series, config.estimator, config.time, config.gating)
        source = " ".join(map(str, ensemble))
        yield from run_dives(estimator, found, config, fit, source, advance)

    run_study(page, results, outputs, config, processes, forecasts.notes)
    return 0
