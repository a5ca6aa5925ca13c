"""All studies on all missions, as one value."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.core.progress import Progress, silent
from replay_kit.studies.jobs import Advance, each_counted
from replay_kit.studies.missions.follow import Figure, MissionRow, over_missions
from replay_kit.studies.missions.instruments import biases, outliers
from replay_kit.studies.missions.scene import (
    MissionJob,
    Scene,
    fly_pings,
    own_estimator,
    staying,
    withhold,
)
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.messages import Flight

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
