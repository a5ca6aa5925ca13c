"""The odds of missions beside how many arrive, for the console, JSON, CSV and Markdown, and as a page."""

from dataclasses import asdict, fields

import numpy as np

from replay_kit.config.plan import ARRIVING
from replay_kit.show.page import Section
from replay_kit.studies.planning.odds import JudgedMission, PlanningResult
from replay_kit.studies.reports.charts import LABELS, chart_figure, misses_chart
from replay_kit.studies.reports.page import (
    PAGE,
    StudyReport,
    criteria_html,
    study_page,
    tables_html,
    words_html,
)
from replay_kit.studies.reports.tables import (
    Criterion,
    Table,
    answer_of,
    criteria_table,
    markdown,
    to_csv,
)
from replay_kit.workflows.planning.adapters import JUDGING

# Shares that arrive, least asked for: in fresh samples, in withheld truths.
_FRESH, _TRUTH = 0.87, 0.8
_HEADING = "Plans flown in truths that the estimates do not know"
_TITLE = (
    "Missions with headings corrected at each surfacing: share that arrives within the tolerance"
)
_COLUMNS = (
    "truth",
    "status",
    "arrive in the samples",
    "arrive in fresh samples",
    "miss in the truth [m]",
)
FILES = (PAGE, "report.md", "planning.json", "odds.csv")


def report_of(result: PlanningResult) -> StudyReport:
    """Return what the study says so far; undefined figures are null in JSON."""
    criteria = criteria_of(result)
    tables, words = _tables(result, criteria), [findings(result)]
    figures = {
        field.name: getattr(result, field.name)
        for field in fields(result)
        if field.name != "missions"
    }
    listed = [dict(zip(_COLUMNS, row, strict=True)) for row in tables[0].rows]
    answer = answer_of(
        {
            "criteria": [{**asdict(one), "met": one.met} for one in criteria],
            "missions": listed,
            "findings": words,
            **figures,
            "job": asdict(result.job),
        },
        *("numpy", "scipy", "casadi"),
    )

    reached = [one.miss for one in _reached(result)]
    title = "Miss distances of plans reported as reached"
    misses = misses_chart("misses", title, {LABELS["default"]: reached} if reached else {})

    def pages() -> dict[str, str]:
        figures = [chart_figure(misses)] if reached else []
        parts = [f"# {_HEADING}", conditions(result), *map(markdown, tables), *words]
        html = words_html([conditions(result)]) + criteria_html(criteria)
        sections = [
            Section("answer", "In words", html),
            Section("odds", "Odds of missions", words_html(words) + tables_html(tables), figures),
        ]
        return {
            "report.md": "\n\n".join(parts) + "\n",
            PAGE: study_page(_HEADING, sections, answer),
        }

    csv = {"odds.csv": to_csv(tables[0])}
    made = None if result.unfinished else pages
    beside = "report.md, planning.json, odds.csv"
    return StudyReport("planning", answer, tables, words, csv, made, beside)


def _tables(result: PlanningResult, criteria: tuple[Criterion, ...]) -> tuple[Table, ...]:
    rows = tuple(
        (one.truth, one.status, one.stated, one.fresh, one.miss) for one in result.missions
    )
    return Table("odds", _TITLE, _COLUMNS, rows), criteria_table("Acceptance criteria", criteria)


def _reached(result: PlanningResult) -> list[JudgedMission]:
    return [one for one in result.missions if one.status == "reached"]


def criteria_of(result: PlanningResult) -> tuple[Criterion, ...]:
    """Return the shares of plans reported as reached that arrive beside their limits; none without such a plan."""
    if not (reached := _reached(result)):
        return ()
    fresh = float(np.mean([one.fresh for one in reached]))
    arrived = float(np.mean([one.miss <= one.tolerance for one in reached]))
    in_samples = "share of fresh samples that arrives, mean over the plans reported as reached"
    in_truth = "share of the plans reported as reached that arrives in the withheld truth"
    return (
        Criterion(in_samples, fresh, at_least=_FRESH),
        Criterion(in_truth, arrived, at_least=_TRUTH),
    )


def findings(result: PlanningResult) -> str:
    """Return how many plans are reported as reached, and how many of these arrive, in words."""
    made, reached = len(result.missions), _reached(result)
    if not reached:
        return f"None of {made} missions is reported as reached: in none do {ARRIVING:.0%} of {JUDGING} samples arrive."
    stated, fresh, miss = np.array([(one.stated, one.fresh, one.miss) for one in reached]).T
    arrived = sum(one.miss <= one.tolerance for one in reached)
    return (
        f"{len(reached)} of {made} missions are reported as reached, as {ARRIVING:.0%} or more of {JUDGING} samples arrive "
        f"({stated.mean():.1%} in the mean). In {result.job.fresh} fresh samples {fresh.mean():.1%} arrive in the mean and "
        f"{fresh.min():.1%} in the worst plan; {np.mean(fresh >= _FRESH):.0%} of the plans have {_FRESH:.0%} or more. In the truth "
        f"{arrived} of {len(reached)} arrive; the median miss there is {np.median(miss):.0f} m."
    )


def conditions(result: PlanningResult) -> str:
    """Return what the study was made on."""
    job = result.job
    modes = "all modes" if result.modes is None else f"at most {result.modes} modes"
    levels = ", ".join(f"{level:.4g}" for level in result.levels)
    truths = ", ".join(f"`{truth}`" for truth in result.truths)
    return (
        f"{result.n_members} members of `{result.ensemble}`, levels {levels} m; truths, in turn: {truths}. Each estimate is made from "
        f"{job.pings} pings at random places, noise {job.noise:g} m/s, with {modes}. Seed {job.seed}. Missions on one truth share its "
        "estimate."
    )
