"""Simulated glider missions with faults, in a truth that may change: outliers, and biases of compass and scale.

Each member left out is the truth in turn; all runs of a mission share course and noise. No setting is chosen with the truth.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import chdtri

from replay_kit.config.run import EstimatorConfig, MeasurementConfig, RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Measurement, Observation
from replay_kit.core.progress import Progress, silent
from replay_kit.estimator import Estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.measurements.interpret import observations
from replay_kit.studies.bench.frame import Figure, Lost, of_case
from replay_kit.studies.jobs import Advance, check_names, check_positive, each_counted
from replay_kit.studies.reports.tables import NAN
from replay_kit.studies.twins.adcp import OUTLIER, SOUND, Faults
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.glider import STEP_S, SURFACE_STEPS, Schedule, dive_steps, mission
from replay_kit.studies.twins.messages import Flight, measured_on
from replay_kit.studies.twins.truths import leave_out, members_named
from replay_kit.studies.twins.vehicle import EPOCH_NS, NS_PER_S
from replay_kit.workflows.replay.inputs.estimator import build
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.scoring import rms_length, scored_points

FAULT_TASKS = ("outliers", "bias")
_SHARE, _GATES, _OVER_CLEAN = 0.1, ("reject", "soften", "off"), 1.05
_HEADING_DEG, _SCALE, _KNOWN_STD, _OVER_SOUND = 5.0, 0.03, 0.02, 1.1
_UNITS = {"heading": ("degrees", math.degrees(1.0)), "scale": ("%", 100.0)}
# a scale error of 3 % is 8 mm/s at a glider's speed: significant after a thousand pings, not after a few hundred
_DAYS, _EVERY_S = 10.0, 600.0
# standard deviations from zero at which a bias counts as found
_FOUND = 3.0
_DAY_S = 86_400.0
# a course begins at one of four corners, so that more attempts meet all of them
_ATTEMPTS, _NEXT_SEED = 10, 10_000


@dataclass(frozen=True, slots=True)
class FaultJob:
    """Which tasks, on which simulated missions.

    Attributes:
        leave_out: Positions of members from 0, with commas between them, or ``all``: each is the truth in turn.
        tasks: Of ``FAULT_TASKS``.
        pings: Of each mission; those of ``bias`` ping every ten minutes for ten days at most.
        days: Over which the pings are spread; a changing truth ends it sooner.
        noise: Standard deviation of each component of each bin [m/s].
        seeds: Seeds 0 to seeds - 1 are run for each truth.
        evaluations: How many times on the way the estimate is compared with the truth.
    """

    leave_out: str
    tasks: tuple[str, ...] = FAULT_TASKS
    pings: int = 160
    days: float = 20.0
    noise: float = 0.09
    seeds: int = 1
    evaluations: int = 20

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        check_names("--task", self.tasks, FAULT_TASKS)
        names = ("pings", "seeds", "evaluations", "days", "noise")
        check_positive(**{name: getattr(self, name) for name in names})


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A truth, the forecast that does not know it, and the options.

    Attributes:
        truths: Ensembles of one, one a time of the forecast.
        forecasts: Of the other members, one a time.
        config: Settings of the estimators.
        job: The options.
        seed: Of course and noise.
    """

    truths: tuple[Ensemble, ...]
    forecasts: tuple[Ensemble, ...]
    config: RunConfig
    job: FaultJob
    seed: int

    def own(self, config: RunConfig) -> Estimator[Any]:
        """Return the estimator of a replay: through time where the forecast goes through time or the settings ask for it.

        Raises:
            ConfigError: The settings choose a baseline, or the paper's preset.
        """
        name, preset, own = config.estimator.name, config.estimator.preset, EstimatorConfig()
        if (name, preset) != (own.name, own.preset):
            raise ConfigError(
                f"bench: expected the project's own estimator, got {name}, preset {preset}; leave them out of the configuration"
            )
        through_time = bool(config.time.oscillators or config.time.biases) or (
            len(self.truths) > 1 if config.time.scale == "auto" else config.time.scale != "static"
        )
        return build(Forecasts(self.forecasts, self.forecasts[0], through_time), config, None)

    def fly(self, sea: Field, pings: int, days: float) -> Flight:
        """Return the first of some missions that stays in the truth's water: a course and noise for each seed, tried in a fixed order.

        Raises:
            ForecastError: The current carried the glider out of the truth's water each time.
        """
        seeds = [self.seed + _NEXT_SEED * attempt for attempt in range(_ATTEMPTS)]
        for seed in seeds[:-1]:
            try:
                return fly_pings(sea, pings, days, self.job.noise, seed)
            except ForecastError:
                continue
        return fly_pings(sea, pings, days, self.job.noise, seeds[-1])

    def truth_at(self, time_ns: int) -> Array:
        """Return the truth at the grid's wet points, shape (P, 2) [m/s], linear between its times; the last holds after its own."""
        index = scored_points(self.forecasts[0].grid, self.truths[0]).index
        values = [truth.velocity[0][:, *index].T for truth in self.truths]
        times = np.array([truth.time_ns or 0 for truth in self.truths], dtype=np.int64)
        if len(values) == 1:
            return np.asarray(values[0])
        after = int(np.clip(np.searchsorted(times, time_ns), 1, len(values) - 1))
        share = float(np.clip((time_ns - times[after - 1]) / np.diff(times)[after - 1], 0.0, 1.0))
        return np.asarray((1.0 - share) * values[after - 1] + share * values[after])


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """An estimator's way through a mission.

    Attributes:
        error: Mean over the mission of the RMSE [m/s].
        innovations: Of each measurement that could be used.
        state: The last.
    """

    error: float
    innovations: tuple[Innovation, ...] = field(repr=False)
    state: Any = field(repr=False)

    def changed(self, wrong: frozenset[int]) -> tuple[int, int]:
        """Return how many measurements of some times [ns, UTC], and of others, were rejected or downweighted."""
        changed = [one.time_ns in wrong for one in self.innovations if one.decision != "accepted"]
        return sum(changed), len(changed) - sum(changed)

    def figures(self, method: str, clean: float = NAN, at_most: float = NAN) -> list[Figure]:
        """Return the error, its ratio to that of a clean run, and the consistency of all measurements, rejected ones too."""
        nis, dof = np.array([(one.nis, one.dof) for one in self.innovations]).T
        inside = (nis >= chdtri(dof, 0.975)) & (nis <= chdtri(dof, 0.025))
        ratio = [Figure(method, "RMSE over clean", self.error, clean, at_most=at_most)]
        return [
            Figure(method, "RMSE [m/s]", self.error),
            *(ratio if math.isfinite(clean) else []),
            Figure(method, "NIS per degree of freedom", float(nis.sum()), float(dof.sum())),
            Figure(method, "inside their 95 % band", float(inside.sum()), float(inside.size)),
        ]


def follow(scene: Scene, estimator: Estimator[Any], given: Sequence[Measurement]) -> Followed:
    """Return an estimator's way through a mission, compared with the truth at times evenly spread, the last after all measurements."""
    state: Any = estimator.initial()
    at = scored_points(scene.forecasts[0].grid, scene.truths[0])
    errors, innovations = list[float](), list[Innovation]()
    number = scene.job.evaluations
    compared = {round(len(given) * (k + 1) / number) for k in range(number)}
    for count, measurement in enumerate(given, start=1):
        state, innovation = estimator.step(state, measurement)
        if innovation.decision != "unusable":
            innovations.append(innovation)
        if count in compared:
            # a measurement that was not used leaves the state at an earlier time
            flow = estimator.flow(state).at(measurement.time_ns)
            errors.append(
                rms_length(flow.velocity(*at.place) - scene.truth_at(measurement.time_ns))
            )
    return Followed(float(np.mean(errors)), tuple(innovations), state)


def outliers(scene: Scene, sea: Field) -> list[Figure]:
    """Return the figures of a mission in which a tenth of the pings is 1 m/s off in a random direction, with each gate."""
    flight = scene.fly(sea, scene.job.pings, scene.job.days)
    sound, spoilt = measurements(flight), measurements(flight, Faults(outliers=_SHARE))
    wrong = frozenset(
        one.time_ns
        for one, other in zip(sound, spoilt, strict=True)
        if isinstance(one, Observation)
        and isinstance(other, Observation)
        and (np.hypot(*(other.velocity - one.velocity).T) > 0.5 * OUTLIER).any()
    )
    clean = follow(scene, scene.own(scene.config), sound)
    figures = clean.figures("without outliers")
    for gate in _GATES:
        gating = scene.config.gating.model_copy(update={"gate": gate})
        estimator = scene.own(scene.config.model_copy(update={"gating": gating}))
        followed = follow(scene, estimator, spoilt)
        method, most = f"gate {gate}", _OVER_CLEAN if gate == scene.config.gating.gate else NAN
        caught, others = followed.changed(wrong)
        total = len(followed.innovations) - len(wrong)
        figures += [
            *followed.figures(method, clean.error, most),
            Figure(method, "outliers rejected or softened", caught, len(wrong)),
            Figure(method, "sound pings rejected or softened", others, total),
        ]
    return figures


def biases(scene: Scene, sea: Field) -> list[Figure]:
    """Return the figures of a mission whose compass reads 5 degrees too much, with a scale error of 3 %, with and without bias states."""
    days = min(scene.job.days, _DAYS)
    flight = scene.fly(sea, max(1, int(pinging_seconds(sea, days) / _EVERY_S)), days)
    sound = measurements(flight, Faults("platform", _KNOWN_STD))
    biased = measurements(flight, Faults("platform", _KNOWN_STD, _HEADING_DEG, _SCALE))
    time = scene.config.time.model_copy(update={"biases": tuple(_UNITS)})
    own = scene.own(scene.config)
    estimating = build_evolving(scene.forecasts, scene.config.estimator, time, scene.config.gating)
    clean = follow(scene, own, sound)
    figures = [*clean.figures("sound"), *_named("sound", clean, False)]
    followed = follow(scene, own, biased)
    figures += [*followed.figures("biased", clean.error), *_named("biased", followed, True)]
    for method, given, planted in (("biased", biased, True), ("sound", sound, False)):
        method = f"{method}, bias states"
        followed = follow(scene, estimating, given)
        figures += followed.figures(method, clean.error, _OVER_SOUND)
        for name, (mean, std) in estimating.biases(followed.state).items():
            unit, factor = _UNITS[name]
            limits = (_FOUND, NAN) if planted else (-_FOUND, _FOUND)
            figures += [
                Figure(method, f"{name} [{unit}]", factor * mean),
                Figure(method, f"{name} over its standard deviation", mean / std, 1.0, *limits),
            ]
    return figures


def _named(method: str, followed: Followed, planted: bool) -> list[Figure]:
    """Return which biases a run that estimates none of them names as significant."""
    significant = followed.state.bias_score.significant()
    limits = dict.fromkeys(_UNITS, (1.0, NAN) if planted else (NAN, 0.0))
    return [
        Figure(method, f"{name} is named", float(name in significant), 1.0, *both)
        for name, both in {**limits, "shear": (NAN, 0.0)}.items()
    ]


_TASKS: dict[str, Callable[[Scene, Field], list[Figure]]] = {"outliers": outliers, "bias": biases}


def fly_pings(sea: Field, pings: int, days: float, noise: float, seed: int) -> Flight:
    """Return a mission with its pings spread evenly over some days, from the truth's first time on.

    Args:
        sea: The truth; one that changes ends the mission before its last time.
        pings: Number of pings.
        days: Over which they are spread.
        noise: [m/s].
        seed: Of the course and the noise.

    Raises:
        ConfigError: The pings do not fit into the time.
    """
    steps = int(pinging_seconds(sea, days) / pings / STEP_S)
    if steps < 1:
        raise ConfigError(
            f"--pings: {pings} pings, {STEP_S} s apart at least, take longer than {days:g} days or the truth's time"
        )
    # course and measurements are drawn from one stream
    rng, start_ns = np.random.default_rng(seed), int(sea.time_ns[0]) or EPOCH_NS
    flown = mission(sea, pings, start_ns, rng, schedule=Schedule(steps, to_the_end=True))
    return measured_on(flown, sea, noise, rng, seed)


def pinging_seconds(sea: Field, days: float) -> float:
    """Return for how long a mission of some days can ping [s]: in a truth that changes its last dive ends before the truth does."""
    if sea.time_ns.size < 2:
        return days * _DAY_S
    end_s = float(sea.time_ns[-1] - sea.time_ns[0]) / NS_PER_S
    return min(days * _DAY_S, end_s - float(STEP_S * (dive_steps(sea) + 3 * SURFACE_STEPS)))


def measurements(flight: Flight, faults: Faults = SOUND) -> tuple[Measurement, ...]:
    """Return what an estimator is given of a mission's pings, through the log's messages, as a replay has them."""
    return tuple(observations(flight.messages(faults), MeasurementConfig(without=("dac",))))


def run_faults(
    series: Sequence[Ensemble], config: RunConfig, job: FaultJob, progress: Progress = silent
) -> Iterator[list[Figure | Lost]]:
    """Yield the figures of each mission; its cases are the missions.

    Args:
        series: The forecast at its times, in order; one alone may have no time, and the truth then stays as it is.
        config: Settings of the estimators.
        job: Which tasks, on which missions.
        progress: Called with tasks done, tasks in all, and what is being run.

    Raises:
        ConfigError: An option is wrong.
    """
    job.check()
    members = members_named(job.leave_out, series[0].n_members)
    advance = Advance(len(members) * job.seeds * len(job.tasks), progress)
    calls = (
        (task, series, member, seed, (config, job), advance)
        for member in members
        for seed in range(job.seeds)
        for task in job.tasks
    )
    for _, found in each_counted(_run_task, calls, advance, lambda *_: 1):
        yield found


def _run_task(
    task: str,
    series: Sequence[Ensemble],
    member: int,
    seed: int,
    options: tuple[RunConfig, FaultJob],
    advance: Advance,
) -> list[Figure | Lost]:
    cases = [leave_out(forecast, member) for forecast in series]
    truths = tuple(case.truth for case in cases)
    scene = Scene(truths, tuple(case.ensemble for case in cases), *options, 100 * member + seed)
    case = f"member {member}, seed {seed}"
    try:
        return [*of_case(_TASKS[task](scene, build_field(*truths)), task, case)]
    except ForecastError as error:
        # one mission less is no reason to lose the others
        return [Lost(task, case, str(error))]
    finally:
        advance(f"{case}, {task}")
