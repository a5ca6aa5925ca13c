"""What a study on missions is given: options, truth, forecast without it, the glider's mission, and the estimator of a replay."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import EstimatorConfig, MeasurementConfig, RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Measurement
from replay_kit.estimator import Estimator
from replay_kit.measurements import observations
from replay_kit.studies.jobs import check_names, check_positive
from replay_kit.studies.missions.follow import Followed, follow
from replay_kit.studies.twins.adcp import SOUND, Faults
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.glider import (
    STEP_S,
    SURFACE_STEPS,
    Schedule,
    dive_steps,
    mission,
)
from replay_kit.studies.twins.messages import Flight, measured_on
from replay_kit.studies.twins.truths import leave_out, members_named
from replay_kit.studies.twins.vehicle import EPOCH_NS, NS_PER_S
from replay_kit.workflows.replay.inputs.estimator import build
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.scoring import ScoredPoints, rms_length, scored_points

STUDIES = ("outliers", "bias")


@dataclass(frozen=True, slots=True)
class MissionJob:
    """Which studies, on which missions.

    Attributes:
        leave_out: Positions of members from 0, with commas between them, or ``all``: each is the truth in turn.
        studies: Of ``STUDIES``.
        pings: Of each mission.
        days: Over which the pings are spread; a changing truth ends it sooner.
        noise: Standard deviation of each component of each bin [m/s].
        seeds: Seeds 0 to seeds - 1 are run for each truth.
        evaluations: How many times on the way the estimate is compared with the truth.
    """

    leave_out: str
    studies: tuple[str, ...] = STUDIES
    pings: int = 160
    days: float = 20.0
    noise: float = 0.09
    seeds: int = 1
    evaluations: int = 20

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        check_names("--study", self.studies, STUDIES)
        check_positive(
            **{
                name: getattr(self, name)
                for name in ("pings", "seeds", "evaluations", "days", "noise")
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
        times_ns: shape (T,) [ns, UTC]; of no effect when there is one.
    """

    member: int
    truths: tuple[Ensemble, ...]
    forecasts: tuple[Ensemble, ...]
    at: ScoredPoints
    truth: Array
    times_ns: NDArray[np.int64]

    def truth_at(self, time_ns: int) -> Array:
        """Return the truth at the compared places, shape (P, 2) [m/s], interpolated to a time; the last holds after its own."""
        if len(self.truth) == 1:
            return np.asarray(self.truth[0])
        after = int(np.clip(np.searchsorted(self.times_ns, time_ns), 1, len(self.truth) - 1))
        first, last = self.times_ns[after - 1], self.times_ns[after]
        share = float(np.clip((time_ns - first) / (last - first), 0.0, 1.0))
        return np.asarray((1.0 - share) * self.truth[after - 1] + share * self.truth[after])

    def error(self, flow: FlowEstimate, time_ns: int) -> float:
        """Return the root mean square length [m/s] of the error of an estimate."""
        return rms_length(flow.velocity(*self.at.place) - self.truth_at(time_ns))


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
        self, what: str, estimator: Estimator[Any], given: Sequence[Measurement]
    ) -> Followed:
        """Return an estimator's errors on the way through a mission, and its innovations."""
        self.report(what)
        return follow(estimator, given, self.job.evaluations, self.case.error)


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
    times_ns = np.array([forecast.time_ns or 0 for forecast in series], dtype=np.int64)
    return Withheld(
        member,
        tuple(case.truth for case in cases),
        tuple(case.ensemble for case in cases),
        at,
        truth,
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
    through_time = bool(config.time.oscillators or config.time.biases) or (
        len(case.truths) > 1 if config.time.scale == "auto" else config.time.scale != "static"
    )
    return build(Forecasts(case.forecasts, case.forecasts[0], through_time), config, None)


_DAY_S = 86_400.0
# a course begins at one of four corners, so that more attempts meet all of them
_ATTEMPTS = 10
_NEXT_SEED = 10_000


def staying(fly: Callable[[int], Flight], seed: int) -> Flight:
    """Return the first of some missions that stays in the truth's water: a course and noise for each seed, tried in a fixed order.

    Args:
        fly: Flies the mission of a seed.
        seed: The first seed.

    Raises:
        ForecastError: The current carried the glider out of the truth's water each time.
    """
    for attempt in range(_ATTEMPTS - 1):
        try:
            return fly(seed + _NEXT_SEED * attempt)
        except ForecastError:
            continue
    return fly(seed + _NEXT_SEED * (_ATTEMPTS - 1))


def fly_pings(field: Field, pings: int, days: float, noise: float, seed: int) -> Flight:
    """Return a mission with its pings spread evenly over some days, from the truth's first time on.

    Args:
        field: The truth; one that changes ends the mission before its last time.
        pings: Number of pings.
        days: Over which they are spread.
        noise: [m/s].
        seed: Of the course and the noise.

    Raises:
        ConfigError: The pings do not fit into the time.
    """
    steps = int(pinging_seconds(field, days) / pings / STEP_S)
    if steps < 1:
        raise ConfigError(
            f"--pings: {pings} pings, {STEP_S} s apart at least, take longer than {days:g} days or the truth's time"
        )
    # course and measurements are drawn from one stream
    rng, start_ns = np.random.default_rng(seed), int(field.time_ns[0]) or EPOCH_NS
    flown = mission(field, pings, start_ns, rng, schedule=Schedule(steps, to_the_end=True))
    return measured_on(flown, field, noise, rng, seed)


def pinging_seconds(field: Field, days: float) -> float:
    """Return for how long a mission of some days can ping [s]: in a truth that changes its last dive ends before the truth does."""
    if field.time_ns.size < 2:
        return days * _DAY_S
    end_s = float(field.time_ns[-1] - field.time_ns[0]) / NS_PER_S
    last_dive_s = float(STEP_S * (dive_steps(field) + 3 * SURFACE_STEPS))
    return min(days * _DAY_S, end_s - last_dive_s)


def measurements(flight: Flight, faults: Faults = SOUND) -> tuple[Measurement, ...]:
    """Return what an estimator is given of a mission's pings, through the log's messages, as a replay has them.

    Args:
        flight: The mission.
        faults: What the instrument gets wrong, or does not know.
    """
    without = MeasurementConfig(without=("dac",))
    return tuple(observations(flight.messages(faults), without))
