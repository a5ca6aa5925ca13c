"""The studies to the console and to files: a report in Markdown, a CSV for each table, JSON, pictures."""

import csv
import io
import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as ConsoleTable

from replay_kit import __version__
from replay_kit.core.atomic import atomic_file
from replay_kit.studies.planning.run import PlanningResult
from replay_kit.studies.planning.told import Asked, Cell, Picture, Table, Told

_PACKAGES = ("numpy", "scipy", "casadi", "matplotlib")


def replaced_files(out: Path, studies: tuple[str, ...]) -> list[Path]:
    """Return the files in a folder that a run of some studies would replace."""
    patterns = ["report.md", "planning.json", *(f"{study}*.{ending}" for study in studies for ending in ("csv", "png"))]
    return sorted(path for pattern in patterns for path in out.glob(pattern))


def to_json(result: PlanningResult) -> dict[str, Any]:
    """Return the JSON object of ``planning.json`` and ``--json``; undefined figures are null."""
    return {
        "studies": {told.study: _told_json(told, result.seconds[told.study]) for told in result.told},
        "ensemble": result.ensemble,
        "truths": list(result.truths),
        "n_members": result.n_members,
        "levels": list(result.levels),
        "modes": result.modes,
        "job": {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(result.job).items()},
        "versions": {"replay-kit": __version__, **{name: version(name) for name in _PACKAGES}},
    }


def _told_json(told: Told, seconds: float) -> dict[str, Any]:
    asked = [{**{name: _plain(value) for name, value in asdict(one).items()}, "met": one.met} for one in told.asked]
    tables = {table.name: [dict(zip(table.columns, map(_plain, row), strict=True)) for row in table.rows] for table in told.tables}
    failed = {"failed": told.failed} if told.failed else {}
    return {"asked": asked, "tables": tables, "words": list(told.words), "seconds": seconds, **failed}


def to_csv(table: Table) -> str:
    """Return a table as CSV; what is not known is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows([_plain(cell) for cell in row] for row in table.rows)
    return text.getvalue()


def report(result: PlanningResult) -> str:
    """Return the studies as Markdown."""
    parts = ["# Plans flown in truths that the estimates do not know", conditions(result)]
    for told in result.told:
        parts += [f"## {told.title}", *(_markdown(table.title, *_cells(table)) for table in told.tables if table.shown)]
        if told.asked:
            parts.append(_markdown("What is asked", _ASKED, [_asked_cells(one) for one in told.asked]))
        parts += told.words
        parts += [f"![{picture.caption}]({picture.name}.png)\n\n*{picture.caption}.*" for picture in told.pictures]
    done = {told.study for told in result.told}
    if left := [study for study in result.job.studies if study not in done]:
        parts.append(f"Not done when this was written: {', '.join(left)}.")
    return "\n\n".join(parts) + "\n"


def conditions(result: PlanningResult) -> str:
    """Return what the studies were made on."""
    job, modes = result.job, "all modes" if result.modes is None else f"at most {result.modes} modes"
    levels, truths = ", ".join(f"{level:.4g}" for level in result.levels), ", ".join(f"`{truth}`" for truth in result.truths)
    return (
        f"{result.n_members} members of `{result.ensemble}`, levels {levels} m; truths, in turn: {truths}. Estimates are made "
        f"of {job.pings} pings at random places, noise {job.noise:g} m/s, with {modes}. Seed {job.seed}. Intervals hold 90 % of the "
        "medians of resampled cases; those of one truth share its estimates, which the intervals do not count."
    )


def write_planning(out: Path, result: PlanningResult) -> None:
    """Write everything into a folder that exists, each file whole or not at all; existing ones are replaced."""
    for told in result.told:
        for table in told.tables:
            _write(out / f"{table.name}.csv", to_csv(table).encode())
        for picture in told.pictures:
            _write(out / f"{picture.name}.png", drawn(picture))
    _write(out / "planning.json", (json.dumps(to_json(result), indent=1, allow_nan=False) + "\n").encode())
    _write(out / "report.md", report(result).encode())


def drawn(picture: Picture) -> bytes:
    """Return a picture as PNG."""
    # matplotlib takes half a second to load, and nothing but this needs it
    import matplotlib
    from matplotlib.figure import Figure

    content = io.BytesIO()
    with matplotlib.rc_context({"font.size": 11.0, "axes.titlesize": 11.0}):
        figure = Figure(figsize=picture.size, layout="constrained", dpi=110.0)
        picture.draw(figure)
        figure.savefig(content, format="png")
    return content.getvalue()


def print_planning(result: PlanningResult, console: Console) -> None:
    """Print the tables, what is asked, and what they show."""
    for told in result.told:
        for table in told.tables:
            if table.shown:
                _print(console, f"{told.study}: {table.title}", *_cells(table))
        if told.asked:
            _print(console, f"{told.study}: what is asked", _ASKED, [_asked_cells(one) for one in told.asked])
        for words in told.words:
            console.print(words, soft_wrap=True, markup=not told.failed)


_ASKED = ("figure", "value", "90 % interval", "asked", "")


def _asked_cells(one: Asked) -> tuple[str, ...]:
    low, high = math.isfinite(one.at_least), math.isfinite(one.at_most)
    asked = f">= {one.at_least:.4g}" if low else f"<= {one.at_most:.4g}" if high else ""
    interval = f"{one.low:.4g} to {one.high:.4g}" if math.isfinite(one.low) else ""
    return one.what, _text(one.value), interval, asked, "met" if one.met else "NOT MET"


def _cells(table: Table) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    return table.columns, [tuple(_text(cell) for cell in row) for row in table.rows]


def _print(console: Console, title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    shown = ConsoleTable(*columns, title=title, title_justify="left")
    for cells in rows:
        shown.add_row(*cells)
    console.print(shown)


def _markdown(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines: Iterator[tuple[str, ...]] = iter([columns, tuple("---" for _ in columns), *rows])
    return "\n".join([f"**{title}**", "", *("| " + " | ".join(cells) + " |" for cells in lines)])


def _text(cell: Cell) -> str:
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, float):
        # whole metres read better than powers of ten
        return "-" if not math.isfinite(cell) else f"{cell:.0f}" if abs(cell) >= 1e3 else f"{cell:.3g}"
    return str(cell)


def _plain(cell: Cell) -> Cell | None:
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell


def _write(path: Path, content: bytes) -> None:
    with atomic_file(path) as file:
        file.write(content)
