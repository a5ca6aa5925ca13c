"""What the studies of planning result in: tables, figures beside their limits, findings and pictures."""

from collections.abc import Mapping
from dataclasses import dataclass

from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.reports.tables import Criterion, Picture, Table


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
