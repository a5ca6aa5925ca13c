"""The studies on missions, of outliers and of biases of compass and scale, on all missions, as one value."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Measurement, Observation
from replay_kit.core.progress import Progress, silent
from replay_kit.estimator.evolving import EvolvingEstimator, build_evolving
from replay_kit.studies.jobs import Advance, each_counted
from replay_kit.studies.missions.follow import (
    RMSE,
    Figure,
    Followed,
    MissionRow,
    error_figures,
    over_missions,
)
from replay_kit.studies.missions.scene import (
    MissionJob,
    Scene,
    fly_pings,
    measurements,
    own_estimator,
    pinging_seconds,
    staying,
    withhold,
)
from replay_kit.studies.twins.adcp import OUTLIER, Faults
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.messages import Flight

KNOWN_STD = 0.02  # m/s
SHARE = 0.1
_OVER_CLEAN = 1.05
_GATES = ("reject", "soften", "off")


def outliers(scene: Scene) -> list[Figure]:
    """Return the figures of one mission: the run without outliers has the gate of the settings."""
    sound, spoilt = measurements(scene.flight), measurements(scene.flight, Faults(outliers=SHARE))
    wrong = _moved(sound, spoilt)
    clean = scene.errors("without outliers", scene.own, sound)
    figures = [
        Figure("without outliers", RMSE, clean.mean()),
        Figure(
            "without outliers",
            "pings rejected or softened",
            clean.not_accepted(),
            len(clean.innovations),
        ),
    ]
    for gate in _GATES:
        method = f"with outliers, gate {gate}"
        gating = scene.config.gating.model_copy(update={"gate": gate})
        followed = scene.errors(
            method,
            own_estimator(scene.case, scene.config.model_copy(update={"gating": gating})),
            spoilt,
        )
        most = _OVER_CLEAN if gate == scene.config.gating.gate else np.nan
        figures += error_figures(
            method, followed.mean(), "that without outliers", clean.mean(), most
        )
        if gate == "reject":
            caught = followed.not_accepted() - followed.not_accepted(wrong)
            figures += [
                Figure(method, "outliers rejected or softened", caught, len(wrong)),
                Figure(
                    method,
                    "sound pings rejected or softened",
                    followed.not_accepted(wrong),
                    len(followed.innovations) - len(wrong),
                ),
            ]
    return figures


def _moved(sound: Sequence[Measurement], spoilt: Sequence[Measurement]) -> frozenset[int]:
    """Return the times [ns, UTC] of the pings that are outliers."""
    velocity = {of.time_ns: of.velocity for of in sound if isinstance(of, Observation)}
    pairs = [
        (of.time_ns, of.velocity - velocity[of.time_ns])
        for of in spoilt
        if isinstance(of, Observation)
    ]
    return frozenset(
        time_ns for time_ns, off in pairs if (np.hypot(off[:, 0], off[:, 1]) > 0.5 * OUTLIER).any()
    )


HEADING_DEG, SCALE = 5.0, 0.03
PLANTED = {"heading": math.radians(HEADING_DEG), "scale": SCALE}
_OVER_SOUND = 1.1
# a scale error of 3 % is 8 mm/s at a glider's speed: significant after a thousand pings, not after a few hundred
_DAYS, _EVERY_S = 10.0, 600.0
# standard deviations from zero at which a bias counts as found
_FOUND = 3.0
_UNIT = {"heading": ("degrees", math.degrees(1.0)), "scale": ("%", 100.0), "shear": ("1/s", 1.0)}


def biases(scene: Scene) -> list[Figure]:
    """Return the figures of one mission."""
    flight = _dense(scene)
    sound = measurements(flight, Faults("platform", KNOWN_STD))
    biased = measurements(flight, Faults("platform", KNOWN_STD, HEADING_DEG, SCALE))
    time = scene.config.time.model_copy(update={"biases": ("heading", "scale")})
    estimating = build_evolving(
        scene.case.forecasts, scene.config.estimator, time, scene.config.gating
    )
    clean = scene.errors("sound", scene.own, sound)
    figures = [
        Figure("sound, without bias states", RMSE, clean.mean()),
        *clean.nis("sound, without bias states"),
        *_named("sound, without bias states", clean, planted=False),
    ]
    for method, estimator, given, most in (
        ("biased, without bias states", scene.own, biased, np.nan),
        ("biased, with bias states", estimating, biased, _OVER_SOUND),
        ("sound, with bias states", estimating, sound, _OVER_SOUND),
    ):
        followed = scene.errors(method, estimator, given)
        figures += [
            *error_figures(method, followed.mean(), "the sound one's", clean.mean(), most),
            *followed.nis(method),
            *(
                _named(method, followed, planted=True)
                if estimator is scene.own
                else _found(method, estimating, followed, given is biased)
            ),
        ]
    return figures


def _dense(scene: Scene) -> Flight:
    """Return a mission that pings every ten minutes, as an instrument does."""
    field, days = scene.flight.field, min(scene.job.days, _DAYS)
    pings = max(1, int(pinging_seconds(field, days) / _EVERY_S))
    return staying(partial(fly_pings, field, pings, days, scene.job.noise), scene.flight.seed)


def _named(method: str, followed: Followed, planted: bool) -> list[Figure]:
    """Return which errors a run that estimates none of them names as significant."""
    significant = followed.state.bias_score.significant()
    figures = []
    for name in PLANTED:
        unit, factor = _UNIT[name]
        least, most = (1.0, np.nan) if planted else (np.nan, 0.0)
        figures.append(
            Figure(
                method, f"{name} is named", float(name in significant), at_least=least, at_most=most
            )
        )
        if name in significant:
            figures.append(
                Figure(method, f"{name} as named [{unit}]", factor * significant[name][0])
            )
    figures.append(
        Figure(method, "shear is named, wrongly", float("shear" in significant), at_most=0.0)
    )
    return figures


def _found(
    method: str, estimator: EvolvingEstimator, followed: Followed, planted: bool
) -> list[Figure]:
    """Return each estimated bias, in standard deviations from zero, and its error."""
    figures = []
    for name, (mean, std) in estimator.biases(followed.state).items():
        unit, factor = _UNIT[name]
        true = PLANTED[name] if planted else 0.0
        least, most = (_FOUND, np.nan) if planted else (-_FOUND, _FOUND)
        figures += [
            Figure(method, f"{name} [{unit}]", factor * mean),
            Figure(method, f"{name}, standard deviation [{unit}]", factor * std),
            Figure(
                method,
                f"{name} over its standard deviation",
                mean / std,
                at_least=least,
                at_most=most,
            ),
            Figure(method, f"{name}, error over its standard deviation", (mean - true) / std),
        ]
    return figures


_STUDIES: dict[str, Callable[[Scene], list[Figure]]] = {"outliers": outliers, "bias": biases}


@dataclass(frozen=True, slots=True)
class MissionResult:
    """All rows, and what they were computed on.

    Attributes:
        rows: Study after study.
        ensemble: Its file.
        members: Positions of the members that were the truth in turn.
        times: Number of times of the forecast; 1 when the truth stays as it is.
        job: The options.
        lost: Of each mission that was left out, why: the current carried the glider away.
        unfinished: Whether more missions were to follow when this was written.
    """

    rows: tuple[MissionRow, ...]
    ensemble: str
    members: tuple[int, ...]
    times: int
    job: MissionJob
    lost: tuple[str, ...]
    unfinished: bool = False


def run_missions(
    series: Sequence[Ensemble], config: RunConfig, job: MissionJob, progress: Progress = silent
) -> Iterator[MissionResult]:
    """Yield the studies on an ensemble: the result so far after each mission, then the whole one.

    Args:
        series: The forecast at its times, in order; one alone may have no time, and the truth then stays as it is.
        config: Settings of the estimators.
        job: Which studies, on which missions.
        progress: Called with studies done, studies in all, and what is being run.

    Raises:
        ConfigError: An option is wrong.
        ForecastError: The current carried every glider out of the truth's water.
    """
    job.check()
    members = job.members(series[0].n_members)
    advance = Advance(len(members) * job.seeds * len(job.studies), progress)
    by_study: dict[str, list[list[Figure]]] = {study: [] for study in job.studies}
    lost = list[str]()

    def result(unfinished: bool) -> MissionResult:
        rows = tuple(row for study in job.studies for row in over_missions(study, by_study[study]))
        return MissionResult(
            rows, series[0].source, members, len(series), job, tuple(lost), unfinished
        )

    calls = (
        (series, member, seed, (config, job), advance)
        for member in members
        for seed in range(job.seeds)
    )
    for (_, member, seed, *_), found in each_counted(
        _run_mission, calls, advance, lambda *_: len(job.studies)
    ):
        for study, figures in found.items():
            if isinstance(figures, str):
                # one mission less is no reason to lose the others
                lost.append(f"member {member}, seed {seed}, {study}: {figures}")
            else:
                by_study[study].append(figures)
        yield result(True)
    if not any(by_study.values()):
        raise ForecastError(f"no mission is left; {lost[0]}")
    yield result(False)


def _run_mission(
    series: Sequence[Ensemble],
    member: int,
    seed: int,
    options: tuple[RunConfig, MissionJob],
    advance: Advance,
) -> dict[str, list[Figure] | str]:
    """Return the figures of each study on one mission; of one that is lost, why."""
    (config, job), case = options, withhold(series, member)
    own, field = own_estimator(case, config), build_field(*case.truths)
    flight: Flight | None = None
    found: dict[str, list[Figure] | str] = {}
    for study in job.studies:
        what = f"member {member}, {study}"
        try:
            flight = flight or staying(
                partial(fly_pings, field, job.pings, job.days, job.noise), 100 * member + seed
            )
            found[study] = _STUDIES[study](
                Scene(case, flight, own, config, job, partial(_report, advance, what))
            )
        except ForecastError as error:
            found[study] = str(error)
        advance(what)
    return found


def _report(advance: Advance, study: str, what: str) -> None:
    advance(f"{study}: {what}", 0)
