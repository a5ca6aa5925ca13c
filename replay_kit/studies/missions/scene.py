"""What a study is given: a truth, a mission in it, and the estimator that a replay would take."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Measurement
from replay_kit.estimator import ReducedBasisEstimator
from replay_kit.estimator.evolving import EvolvingEstimator
from replay_kit.studies.missions.flights import Flight
from replay_kit.studies.missions.follow import Followed, Own, follow
from replay_kit.studies.missions.job import MissionJob
from replay_kit.studies.missions.sea import Withheld
from replay_kit.workflows.replay.build import Forecasts, build

_OWN = EstimatorConfig()


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One truth, one mission.

    Attributes:
        case: The truth, and the forecast that does not know it.
        flight: The mission of pings.
        own: The estimator that a replay takes for the forecast.
        config: Settings of the estimators.
        job: What is asked for.
        say: Told what is being run.
    """

    case: Withheld
    flight: Flight
    own: Own
    config: RunConfig
    job: MissionJob
    say: Callable[[str], None]

    def errors(
        self, what: str, estimator: Own, given: Sequence[Measurement], looks: int | None = None, grown_a_day: float = 1.0
    ) -> Followed[float]:
        """Return an estimator's errors on the way through a mission, and what it said."""
        self.say(what)

        def error(flow: FlowEstimate, time_ns: int) -> float:
            return self.case.rmse(flow.velocity(*self.case.at.place), time_ns)

        return follow(estimator, given, looks or self.job.looks, error, grown_a_day)


def own_estimator(case: Withheld, config: RunConfig) -> Own:
    """Return the estimator that a replay takes: through time where the forecast goes through time or it is asked for.

    Raises:
        ConfigError: The settings choose a baseline, or the paper's preset.
    """
    name, preset = config.estimator.name, config.estimator.preset
    if (name, preset) != (_OWN.name, _OWN.preset):
        raise ConfigError(
            f"missions: expected the project's own estimator, got {name}, preset {preset}; leave them out of the configuration"
        )
    scale, time = config.time.scale, config.time
    asked = scale not in ("auto", "static") or bool(time.oscillators or time.biases)
    built = build(Forecasts(case.forecasts, case.forecasts[0], asked or (case.changes and scale == "auto")), config, None)
    assert isinstance(built, EvolvingEstimator | ReducedBasisEstimator)
    return built
