"""The options of the studies of planning, and what they result in: tables, figures beside their limits, findings and pictures."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from replay_kit.studies.jobs import check_names, check_not_negative, check_positive
from replay_kit.studies.reports.tables import Criterion, Picture, Table
from replay_kit.studies.twins.truths import members_named

# Members that are the truth in turn when none are named.
_TRUTHS = 20


@dataclass(frozen=True, slots=True)
class PlanningJob:
    """Which studies, on which truths, of what size.

    Attributes:
        studies: Their names.
        leave_out: Positions of members from 0, with commas between them, or ``all``: each is the truth in turn; None for at most
            twenty, evenly spread.
        pairs: Starts and goals of glides, of missions and of odds, spread over the truths.
        pings: Given to each estimate.
        noise: Standard deviation of each component of each bin [m/s].
        legs: Of each mission.
        depth: Of a mission's dives, at most [m].
        fresh: Samples that a plan called reached is flown in, beside those that judged it.
        seed: Of all random draws.
    """

    studies: tuple[str, ...]
    leave_out: str | None = None
    pairs: int = 100
    pings: int = 450
    noise: float = 0.09
    legs: int = 10
    depth: float = 500.0
    fresh: int = 500
    seed: int = 0

    def check(self, known: Collection[str]) -> None:
        """Raise ConfigError when an option is wrong."""
        check_names("--study", self.studies, known)
        counts = ("pairs", "pings", "legs", "fresh", "noise")
        check_positive(**{name: getattr(self, name) for name in counts})
        check_not_negative(seed=self.seed)

    def members(self, n_members: int) -> tuple[int, ...]:
        """Return the positions of the members left out in turn.

        Raises:
            ConfigError: They are no positions.
        """
        if self.leave_out is None:
            count = min(_TRUTHS, n_members, self.pairs)
            return tuple(int(k) for k in (np.arange(count) + 0.5) * n_members / count)
        return members_named(self.leave_out, n_members)


@dataclass(frozen=True, slots=True, eq=False)
class StudyReport:
    """The outcome of one study.

    Attributes:
        study: Its name; names of tables and pictures begin with it.
        title: What it is about.
        tables: Its tables.
        criteria: Figures beside the limits that they should keep to.
        findings: What the tables show, a paragraph each.
        pictures: To be drawn.
        failed: Why the study has no outcome; empty when it has.
    """

    study: str
    title: str
    tables: tuple[Table, ...]
    criteria: tuple[Criterion, ...] = ()
    findings: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    failed: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class PlanningResult:
    """The outcomes of the chosen studies, and what they were made on.

    Attributes:
        reports: Study by study; those of the job that are missing were not done when this was written.
        ensemble: Its file.
        truths: Their files, or the members left out in turn.
        n_members: Of the ensemble.
        levels: [m].
        modes: Limit on the basis flows of a level; None for all.
        job: The options.
        seconds: Wall time of each study [s].
    """

    reports: tuple[StudyReport, ...]
    ensemble: str
    truths: tuple[str, ...]
    n_members: int
    levels: tuple[float, ...]
    modes: int | None
    job: PlanningJob
    seconds: Mapping[str, float]
