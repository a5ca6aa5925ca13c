"""Tasks on real dives: each record asked of each method, and the answers scored against what was measured."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.evidence import coverage, crps_gaussian
from replay_kit.core.progress import Progress, silent
from replay_kit.core.surfacing import SHARES
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.studies.bench.frame import Figure, Lost, of_case
from replay_kit.studies.bench.methods import Background, Entry, LastDive, methods_of
from replay_kit.studies.bench.missions import Mission
from replay_kit.studies.bench.records import (
    PROFILE_TASKS,
    Answer,
    Program,
    Record,
    UnansweredError,
    records,
)
from replay_kit.studies.jobs import Advance, check_positive, each_counted
from replay_kit.workflows.replay.scoring import rms_length

_CM = 100.0


@dataclass(frozen=True, slots=True)
class DiveJob:
    """What is asked of whom.

    Attributes:
        tasks: Of ``DIVE_TASKS``.
        methods: Of ``methods_of``; None for all.
        programs: Commands by the names that they are reported under.
        seconds: Time limit of a program for each record.
        first: The first predicted dive of a mission that is scored, counted from 1.
    """

    tasks: tuple[str, ...]
    methods: tuple[str, ...] | None = None
    programs: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 10.0
    first: int = 3

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        check_positive(**{"time-limit": self.seconds, "first": self.first})


def run_dives(
    missions: Sequence[Mission],
    estimator: EvolvingEstimator | None,
    job: DiveJob,
    progress: Progress = silent,
) -> Iterator[list[Figure | Lost]]:
    """Yield the figures of each task on each mission; its cases are the missions.

    Args:
        missions: With their dives.
        estimator: On an ensemble; None without.
        job: What is asked.
        progress: Called with tasks done, tasks in all, and what is being done.

    Raises:
        ConfigError: An option is wrong.
    """
    job.check()
    advance = Advance(len(missions) * len(job.tasks), progress)
    calls = ((task, mission, estimator, job, advance) for task in job.tasks for mission in missions)
    for _, found in each_counted(_run_task, calls, advance, lambda *_: 1):
        yield found


def _run_task(
    task: str,
    mission: Mission,
    estimator: EvolvingEstimator | None,
    job: DiveJob,
    advance: Advance,
) -> list[Figure | Lost]:
    asked = list(records(task, mission))
    advance(f"{mission.name}, {task}")
    if not asked:
        return []
    predicted = [k for k, each in enumerate(asked) if each.known]
    if len(predicted) < job.first:
        reason = (
            f"{len(predicted)} dives can be predicted, and the first {job.first - 1} are not scored"
        )
        return [Lost(task, mission.name, reason)]
    if estimator is not None:
        background = Background(estimator)
        asked = [replace(each, backgrounds=background.of(each)) for each in asked]
    known = methods_of(task in PROFILE_TASKS, estimator is not None)
    makers: dict[str, Callable[[], Entry]] = {
        name: make for name, make in known.items() if job.methods is None or name in job.methods
    }
    for name, command in job.programs.items():
        makers[name] = lambda command=command: Program(command, job.seconds)  # type: ignore[misc]
    baseline = list(map(LastDive(), asked))
    found = list[Figure | Lost]()
    for name, make in makers.items():
        answers, missing = _answers(make(), asked, baseline)
        scored = slice(predicted[job.first - 1], None)
        figures = _scored(name, asked[scored], answers[scored], baseline[scored])
        if missing:
            words = f"{name}: {len(missing)} of {len(asked)} answers missing, scored as the last dive; the first: {missing[0]}"
            found.append(Lost(task, mission.name, words))
        found += of_case(figures, task, mission.name)
    return found


def _answers(
    entry: Entry, asked: Sequence[Record], baseline: Sequence[Answer]
) -> tuple[list[Answer], list[str]]:
    """Return a method's answers, the baseline's where its own are missing, and why these are."""
    answers, missing = list[Answer](), list[str]()
    try:
        for record, instead in zip(asked, baseline, strict=True):
            try:
                answers.append(entry(record))
            except UnansweredError as error:
                missing.append(f"dive {record.target.number}, {error}")
                answers.append(instead)
    finally:
        if isinstance(entry, Program):
            entry.close()
    return answers, missing


def _scored(
    name: str, asked: Sequence[Record], answers: Sequence[Answer], baseline: Sequence[Answer]
) -> list[Figure]:
    errors = [one.velocity - each.truth for one, each in zip(answers, asked, strict=True)]
    off = np.concatenate(errors)
    last = np.concatenate(
        [one.velocity - each.truth for one, each in zip(baseline, asked, strict=True)]
    )
    figures = [
        Figure(name, "RMS error [cm/s]", _CM**2 * float(np.sum(off**2)), len(off), pool="rms"),
        _ratio(name, "over last dive", off, last),
        Figure(name, "CRPS [cm/s]", _CM * _crps(errors, answers), len(off)),
    ]
    if asked[0].task in PROFILE_TASKS:
        none = np.concatenate([each.truth for each in asked])
        return [*figures, _ratio(name, "over zero", off, none), *_intervals(name, errors, answers)]
    fixes = [
        each.target.seconds * np.hypot(*error[0])
        for each, error in zip(asked, errors, strict=True)
        if each.target.path is not None and each.target.path.fixes is not None
    ]
    if fixes:
        figures.append(
            Figure(
                name,
                "surfacing error [m]",
                float(np.sum(np.square(fixes))),
                len(fixes),
                pool="rms",
            )
        )
    return figures + _regions(name, asked, answers, baseline)


def _ratio(name: str, figure: str, off: Array, reference: Array) -> Figure:
    over = rms_length(reference)
    ratio = rms_length(off) / over if over else np.nan
    # a method without any error has no logarithm, and no mission of a geometric mean can be zero
    part = float(np.log(ratio)) if ratio > 0.0 else np.nan
    return Figure(name, figure, part, pool="geometric")


def _crps(errors: Sequence[Array], answers: Sequence[Answer]) -> float:
    """Return the sum over vectors of the mean of their components' CRPS [m/s]; the absolute error without a stated one."""
    return float(
        sum(
            0.5 * np.sum(np.abs(error) if one.std is None else crps_gaussian(error, one.std))
            for error, one in zip(errors, answers, strict=True)
        )
    )


def _intervals(name: str, errors: Sequence[Array], answers: Sequence[Answer]) -> list[Figure]:
    if any(one.std is None for one in answers):
        return []
    off = np.concatenate(errors)
    std = np.concatenate([one.std for one in answers if one.std is not None])
    score = float(np.sum(-0.5 * (off / std) ** 2 - np.log(std) - 0.5 * np.log(2.0 * np.pi)))
    return [
        Figure(name, "log score [nats]", score, len(off)),
        *(
            Figure(
                name, f"coverage {100 * share:g} %", coverage(off, std, share) * off.size, off.size
            )
            for share in (0.5, 0.9)
        ),
    ]


def _regions(
    name: str, asked: Sequence[Record], answers: Sequence[Answer], baseline: Sequence[Answer]
) -> list[Figure]:
    """Return what stated distributions are worth over the last dive's, and which shares they hold; nothing where one is missing."""
    gains, held = [], []
    for record, one, last in zip(asked, answers, baseline, strict=True):
        if one.stated is None:
            return []
        truth = record.truth[0]
        if last.stated is not None:
            gains.append(one.stated.log_density(truth) - last.stated.log_density(truth))
        held.append(one.stated.holds(truth, SHARES))
    shares = np.sum(held, axis=0).tolist()
    return [
        Figure(name, "log score gain [nats]", float(np.mean(gains)) if gains else np.nan),
        *(
            Figure(name, f"coverage {share} %", part, len(held))
            for share, part in zip((50, 90), shares, strict=True)
        ),
    ]
