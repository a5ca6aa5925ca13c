"""The benchmark on the console, as CSV and JSON, and as a page: one table a task, with intervals."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from replay_kit.show.figures.values import Axis, Chart, Mark, Panel
from replay_kit.show.page.section import Section
from replay_kit.studies.bench.frame import BenchResult, BenchRow
from replay_kit.studies.reports.page import (
    LABELS,
    PAGE,
    StudyReport,
    chart_figure,
    lines_by,
    list_html,
    one_chart,
    study_page,
    tables_html,
    words_html,
)
from replay_kit.studies.reports.tables import (
    Cell,
    Table,
    answer_of,
    grouped,
    limits_text,
    met_text,
    number,
    rows_to_csv,
    to_text,
)

FILES = ("bench.csv", "bench.json", PAGE)
#: What a task asks.
TITLES = {
    "next-dive": "Mean current of the next dive, its way through the water known",
    "planned-dive": "Mean current of the next dive, its way through the water as in the last",
    "deny-dive": "Mean current of the next dive, without the last one",
    "deny-day": "Mean current of the next dive, without the dives of the day before",
    "profile": "Current by depth of the next dive",
    "deny-adcp": "Current by depth from mean currents, its own among them, without the ADCP",
    "pings": "A withheld truth from pings at random places",
    "outliers": "Simulated missions with outliers",
    "bias": "Simulated missions with biases of compass and scale",
    "plans": "Missions planned on estimates, flown in fresh samples of these and in the truth",
}
# Figures of which smaller ones are better, the first of a task's is what its methods are compared by.
_COMPARED = ("over last dive", "relative error")
_LEVELS = {"over last dive": 1.0, "over zero": 1.0, "coverage 90 %": 0.9, "coverage 50 %": 0.5}
_LEVELS |= {"relative error": 1.0, "NIS per degree of freedom": 1.0}
_OF_CASES = "Dots: single cases; diamond: all cases together; bars: the ends of the interval of 90 % from resampling cases."
_OF_PINGS = "All cases together after each number of pings; the table has their intervals."


def to_json(result: BenchResult) -> dict[str, Any]:
    """Return the JSON object of ``--json``; undefined figures are null."""
    rows = [asdict(row) for row in result.rows]
    answer = {"rows": rows, "lost": result.lost, **result.inputs}
    return answer_of({**answer, "unfinished": result.unfinished}, "numpy", "scipy")


def task_table(task: str, rows: Sequence[BenchRow]) -> Table:
    """Return the figures of one task: a row a method, or a row a figure where figures have limits."""
    cases = ", ".join(dict.fromkeys(case for row in rows for case in row.cases))
    title = f"{task}: {TITLES[task]}; {cases}"
    if any(row.met is not None for row in rows):
        columns = ("method", "figure", "value", "90 % interval", "required", "")
        return Table(task, title, columns, tuple(_limited(row) for row in rows))
    names = tuple(dict.fromkeys(row.figure for row in rows))
    pings = any(row.after is not None for row in rows)
    by_method = grouped(rows, lambda row: (row.method, row.after))
    cells = []
    for (method, after), alike in by_method.items():
        values = {row.figure: _cell(row) for row in alike}
        first = (method, after) if pings else (method,)
        cells.append((*first, *(values.get(name, "") for name in names)))
    return Table(task, title, ("method", *(("pings",) if pings else ()), *names), tuple(cells))


def _limited(row: BenchRow) -> tuple[Cell, ...]:
    required = limits_text(row.at_least, row.at_most), met_text(row.met)
    return row.method, row.figure, row.value, _interval(row), *required


def _cell(row: BenchRow) -> str:
    return f"{to_text(row.value)} {_interval(row)}".rstrip()


def _interval(row: BenchRow) -> str:
    return f"[{to_text(row.low)}, {to_text(row.high)}]" if row.low == row.low else ""


def report_of(result: BenchResult) -> StudyReport:
    """Return what the benchmark says so far: a table a task, and what is missing."""
    return StudyReport(
        "bench",
        to_json(result),
        [task_table(task, rows) for task, rows in _by_task(result).items()],
        [f"Missing: {why}" for why in result.lost],
        {"bench.csv": rows_to_csv(BenchRow, result.rows)},
        None if result.unfinished else lambda: {PAGE: bench_page(result)},
    )


def bench_page(result: BenchResult) -> str:
    """Return the page of a finished run: a section a task."""
    by_task = _by_task(result)
    words = [line for task, rows in by_task.items() for line in _best(task, rows)]
    about = "Each task gives every method the same records, in order, and scores its answers. Intervals are from resampling cases."
    answer = words_html([about]) + list_html(words) + _criteria_html(result.rows)
    methods = list(dict.fromkeys(_label(row.method) for row in result.rows))
    sections = [Section("answer", "In words", answer, missing=[f"{why}." for why in result.lost])]
    sections += [
        Section(
            task,
            TITLES[task],
            tables_html([task_table(task, rows)]),
            [chart_figure(chart, methods) for chart in _charts(task, rows)],
        )
        for task, rows in by_task.items()
    ]
    return study_page("Benchmark", sections, to_json(result))


def _criteria_html(rows: Sequence[BenchRow]) -> str:
    """Return how many figures keep to their limits, and those that do not; empty without limits."""
    limited = [row for row in rows if row.met is not None]
    if not limited:
        return ""
    not_met = [
        f"{row.task}, {row.method}, {row.figure}: *{to_text(row.value)}*, required {limits_text(row.at_least, row.at_most)}"
        for row in limited
        if not row.met
    ]
    met = f"{len(limited) - len(not_met)} of {len(limited)} criteria are met"
    if not not_met:
        return words_html([f"{met}."])
    return words_html([f"{met}; these are not:"]) + list_html(not_met)


def _by_task(result: BenchResult) -> dict[str, list[BenchRow]]:
    return grouped(result.rows, lambda row: row.task)


def _best(task: str, rows: Sequence[BenchRow]) -> list[str]:
    """Return which method errs least, after each number of pings."""
    compared = [row for row in rows if row.figure in _COMPARED and row.value == row.value]
    return [
        f"{task}{'' if after is None else f', {after} pings'}: *{_label(best.method)}* errs least, {best.figure} {number(best.value)} "
        f"{_interval(best)}".rstrip()
        for after, alike in grouped(compared, lambda row: row.after).items()
        for best in (min(alike, key=lambda row: row.value),)
    ]


def _label(method: str) -> str:
    return LABELS.get(method, method).replace("_", " ")


def _charts(task: str, rows: Sequence[BenchRow]) -> list[Chart]:
    """Return the figures of a task against the number of pings, or method by method with the cases of each."""
    charts = []
    for k, (figure, alike) in enumerate(grouped(rows, lambda row: row.figure).items()):
        known = [row for row in alike if row.value == row.value]
        level, title = _LEVELS.get(figure), figure if "[" in figure else f"{figure} [1]"
        if any(row.after is not None for row in known):
            points = ((_label(row.method), row.after or 0, row.value) for row in known)
            x, panel = Axis("pings", log=True), Panel(figure, Axis(title), lines_by(points), level)
            caption = _OF_PINGS
        else:
            labels = tuple(_label(row.method) for row in known)
            y = Axis("method [name]", labels=labels)
            x, panel, caption = Axis(title), Panel(figure, y, _dots(known)), _OF_CASES
        if known:
            charts.append(one_chart(f"{task}-{k}", figure, caption, x, panel))
    return charts


def _dots(rows: Sequence[BenchRow]) -> list[Mark]:
    parts = (
        (
            "each case",
            [(value, k) for k, row in enumerate(rows) for value in row.by_case],
            "circle-open",
        ),
        ("all cases", [(row.value, k) for k, row in enumerate(rows)], "diamond"),
        (
            "interval",
            [(end, k) for k, row in enumerate(rows) for end in (row.low, row.high)],
            "line-ns",
        ),
    )
    return [
        Mark("points", known[:, 0], known[:, 1], name, symbol=symbol)
        for name, each, symbol in parts
        if len(known := np.array([point for point in each if point[0] == point[0]], np.float64))
    ]
