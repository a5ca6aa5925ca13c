"""Options of the studies on missions, and what a study is given: truth, forecast without it, mission, and the estimator of a replay."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Measurement
from replay_kit.estimator import Estimator
from replay_kit.studies.jobs import check_names, check_positive
from replay_kit.studies.missions.follow import Followed, follow
from replay_kit.studies.twins.messages import Flight
from replay_kit.studies.twins.truths import leave_out, members_named
from replay_kit.workflows.replay.inputs.estimator import build
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.scoring import ScoredPoints, rms_length, scored_points

STUDIES = ("time", "relative", "dac", "outliers", "bias", "coverage")


@dataclass(frozen=True, slots=True)
class MissionJob:
    """Which studies, on which missions.

    Attributes:
        leave_out: Positions of members from 0, with commas between them, or ``all``: each is the truth in turn.
        studies: Of ``STUDIES``.
        pings: Of each mission.
        days: Over which the pings are spread; a changing truth ends it sooner.
        dives: Of the mission that has mean currents alone.
        noise: Standard deviation of each component of each bin [m/s].
        seeds: Seeds 0 to seeds - 1 are run for each truth.
        evaluations: How many times on the way the estimate is compared with the truth.
    """

    leave_out: str
    studies: tuple[str, ...] = STUDIES
    pings: int = 160
    days: float = 20.0
    dives: int = 30
    noise: float = 0.09
    seeds: int = 1
    evaluations: int = 20

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        check_names("--study", self.studies, STUDIES)
        check_positive(
            **{
                name: getattr(self, name)
                for name in ("pings", "dives", "seeds", "evaluations", "days", "noise")
            }
        )

    def members(self, n_members: int) -> tuple[int, ...]:
        """Return the positions of the members left out in turn.

        Raises:
            ConfigError: One is no position.
        """
        return members_named(self.leave_out, n_members)


_OWN = EstimatorConfig()


@dataclass(frozen=True, slots=True, eq=False)
class Withheld:
    """A member that is the truth, at each time of the forecast, and the other members.

    Attributes:
        member: Its position from 0.
        truths: Ensembles of one, one a time.
        forecasts: Of the other members, one a time.
        at: Where estimates are compared with the truth.
        truth: shape (T, P, 2) [m/s], the truth there.
        mean: shape (T, P, 2) [m/s], the mean of the other members there.
        times_ns: shape (T,) [ns, UTC]; of no effect when there is one.
    """

    member: int
    truths: tuple[Ensemble, ...]
    forecasts: tuple[Ensemble, ...]
    at: ScoredPoints
    truth: Array
    mean: Array
    times_ns: NDArray[np.int64]

    @property
    def changes(self) -> bool:
        """Whether the truth changes."""
        return len(self.truths) > 1

    def at_time(self, of_times: Array, time_ns: int) -> Array:
        """Return values given at each time, shape (T, P, 2), interpolated to a time; those of the last hold after it."""
        if len(of_times) == 1:
            return np.asarray(of_times[0])
        after = int(np.clip(np.searchsorted(self.times_ns, time_ns), 1, len(of_times) - 1))
        first, last = self.times_ns[after - 1], self.times_ns[after]
        share = float(np.clip((time_ns - first) / (last - first), 0.0, 1.0))
        return np.asarray((1.0 - share) * of_times[after - 1] + share * of_times[after])

    def rmse(self, velocity: Array, time_ns: int) -> float:
        """Return the root mean square length [m/s] of the error of a current at the compared places, shape (P, 2)."""
        return rms_length(velocity - self.at_time(self.truth, time_ns))

    def flow_rmse(self, flow: FlowEstimate, time_ns: int) -> float:
        """Return the root mean square length [m/s] of the error of an estimate."""
        return self.rmse(flow.velocity(*self.at.place), time_ns)

    def mean_rmse(self, times_ns: Sequence[int]) -> float:
        """Return the ensemble mean's error [m/s], the mean over times."""
        return float(
            np.mean([self.rmse(self.at_time(self.mean, time_ns), time_ns) for time_ns in times_ns])
        )


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One truth, one mission.

    Attributes:
        case: The truth, and the forecast that does not know it.
        flight: The mission of pings.
        own: The estimator that a replay takes for the forecast.
        config: Settings of the estimators.
        job: The options.
        report: Called with what is being run.
    """

    case: Withheld
    flight: Flight
    own: Estimator[Any]
    config: RunConfig
    job: MissionJob
    report: Callable[[str], None]

    def errors(
        self,
        what: str,
        estimator: Estimator[Any],
        given: Sequence[Measurement],
        evaluations: int | None = None,
        inflation: float = 1.0,
    ) -> Followed[float]:
        """Return an estimator's errors on the way through a mission, and its innovations; its covariance may grow by a factor a day."""
        self.report(what)
        return follow(
            estimator, given, evaluations or self.job.evaluations, self.case.flow_rmse, inflation
        )


def withhold(series: Sequence[Ensemble], member: int) -> Withheld:
    """Return the case in which a member is the truth.

    Args:
        series: The forecast at its times, in order; one alone may have no time.
        member: Position from 0.

    Raises:
        ConfigError: There is no such member, or too few would be left.
    """
    cases = [leave_out(forecast, member) for forecast in series]
    at = scored_points(series[0].grid, cases[0].truth)
    truth = np.stack([case.truth.velocity[0][:, *at.index].T for case in cases])
    mean = np.stack([case.ensemble.velocity.mean(axis=0)[:, *at.index].T for case in cases])
    times_ns = np.array([forecast.time_ns or 0 for forecast in series], dtype=np.int64)
    return Withheld(
        member,
        tuple(case.truth for case in cases),
        tuple(case.ensemble for case in cases),
        at,
        truth,
        mean,
        times_ns,
    )


def own_estimator(case: Withheld, config: RunConfig) -> Estimator[Any]:
    """Return the estimator that a replay takes: through time where the forecast goes through time or the settings ask for it.

    Raises:
        ConfigError: The settings choose a baseline, or the paper's preset.
    """
    name, preset = config.estimator.name, config.estimator.preset
    if (name, preset) != (_OWN.name, _OWN.preset):
        raise ConfigError(
            f"missions: expected the project's own estimator, got {name}, preset {preset}; leave them out of the configuration"
        )
    return build(
        Forecasts(case.forecasts, case.forecasts[0], goes_through_time(case, config)), config, None
    )


def goes_through_time(case: Withheld, config: RunConfig) -> bool:
    """Return whether a replay of a forecast goes through time."""
    scale = config.time.scale
    return bool(config.time.oscillators or config.time.biases) or (
        case.changes if scale == "auto" else scale != "static"
    )
