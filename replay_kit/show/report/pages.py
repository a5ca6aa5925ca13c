"""Report pages: one vehicle, or several with a common estimate and a page for each."""

import shlex
from collections.abc import Callable, Mapping
from html import escape
from typing import Any

from replay_kit.core.errors import finding_line
from replay_kit.core.extensions import additions
from replay_kit.core.words.text import capitalized, count_text, time_text
from replay_kit.results.mcap.topics import CONFIG_NAME
from replay_kit.results.outcome.outcome import leaves
from replay_kit.results.result import ResultFile
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.section import dives_figure, section_figure
from replay_kit.show.numbers import Sentence, clock_text, number
from replay_kit.show.page.map import map_of
from replay_kit.show.page.page import Section, items_html, page_html, table_html
from replay_kit.show.report.answer import trust_section, words_section
from replay_kit.show.report.card import card_html
from replay_kit.show.report.plan import plan_section
from replay_kit.show.sentences import COLUMNS, estimate_sentences, vehicle_cells, vehicle_sentences

# Entries of a list of the summary that are shown.
_LONG = 12
# Records of how a result was made.
_RECORDS = ("inputs", "versions", "region", "options")


def again_section(contents: Contents) -> Section:
    """Return the section on reproducing the result, with the summary as a table."""
    metadata, html, missing = contents.metadata, "", []
    inputs = metadata.get("replay_kit.inputs", {})
    if any(name.startswith("log") for name in inputs):
        html = f"<p>The command; <code>config.toml</code> is attached to the result:</p><pre>{escape(_command(contents))}</pre>"
    elif inputs:
        made = "; replay-kit verify reproduces it" if "replay_kit.plan" in metadata else ""
        missing.append(f"This result was made by replay-kit plan; its options are below{made}.")
    else:
        missing.append("The result does not name its inputs.")
    rows = [
        [escape(f"{record} {name}"), escape(value)]
        for record in _RECORDS
        for name, value in metadata.get(f"replay_kit.{record}", {}).items()
        if value
    ]
    html += table_html(["record", "value"], rows, "Inputs with SHA-256, versions and options")
    if toml := contents.result.reader.text(CONFIG_NAME):
        html += f"<details><summary>config.toml</summary><pre>{escape(toml)}</pre></details>"
    else:
        missing.append("The result does not hold its configuration.")
    answer = "Files, versions, settings, and every number of the summary."
    html += _numbers(contents.outcome.to_json())
    return Section("again", "How was it made?", html, missing=missing, menu="Files", answer=answer)


def _command(contents: Contents) -> str:
    """Return the commands that make and verify the result."""
    inputs = contents.metadata["replay_kit.inputs"]
    logs, ensemble = (
        [text.partition(" sha256:")[0] for name, text in inputs.items() if name.startswith(begin)]
        for begin in ("log", "ensemble")
    )
    goal = contents.metadata.get("replay_kit.options", {}).get("goal", "")
    parts = ["replay-kit", "replay", *logs, "--ensemble", *(ensemble or ["ENSEMBLE"])]
    parts += ["--config", "config.toml", *([f"--goal={goal}"] if goal else [])]
    out = contents.result.reader.name
    return (
        f"{shlex.join([*parts, '-o', out])}\nreplay-kit verify {shlex.quote(out)} --inputs FOLDER"
    )


def _numbers(summary: Mapping[str, Any]) -> str:
    """Return the single values of a summary as an HTML table; of long lists their length."""
    rows = []
    for path, value in leaves(_shortened(summary)):
        shown = escape("unknown" if value is None else str(value))
        if isinstance(value, int | float) and not isinstance(value, bool):
            form = "," if isinstance(value, int) else ".6g"
            shown = number(path, value, f"{value:{form}}")
        rows.append([f"<code>{escape(path)}</code>", shown])
    heads, caption = ["path in the summary", "value"], "All numbers of the summary, as in --json"
    return table_html(heads, rows, caption)


def _shortened(value: Any) -> Any:
    """Return nested values with long lists replaced by a sentence, to limit the page's size."""
    if isinstance(value, Mapping):
        return {key: _shortened(item) for key, item in value.items()}
    if isinstance(value, list) and len(value) > _LONG:
        return f"{len(value)} entries, in the JSON of replay-kit replay --json"
    return [*map(_shortened, value)] if isinstance(value, list) else value


def map_section(contents: Contents, card: str = "") -> Section:
    """Return the map section of a result with all its vehicles, by default with the summary card."""
    missing = []
    if contents.slices is None:
        missing.append("The result holds no current: the map shows only positions and plans.")
    if contents.track.time_ns.size == 0:
        missing.append("The result holds no position of the vehicle.")
    drawn, beside = map_of(contents), card or card_html(contents)
    figures = [] if drawn is None else [drawn]
    return Section("map", "Map", "", figures, missing, "Map", beside=beside)


def along_track_section(contents: Contents) -> Section:
    """Return the report section on profiles along the track and DACs."""
    each = section_figure(contents), dives_figure(contents)
    figures = [figure for figure in each if figure.panels[0].marks]
    missing = [figure.panels[0].note for figure in each if figure not in figures]
    title = "How does it change along the track, with depth and time?"
    profiles, dives = contents.bins.profiles, len(contents.mean_currents)
    answer = f"{profiles:,} profiles and {dives:,} DACs, compared with the estimate."
    return Section("section", title, "", figures, missing, "Section", answer)


#: The sections from top to bottom; each is a pure function of the opened result.
SECTIONS: tuple[Callable[[Contents], Section], ...] = (
    *(map_section, words_section, along_track_section, trust_section, plan_section),
)


def report_html(result: ResultFile, notes: tuple[str, ...] = ()) -> str:
    """Return a result as a self-contained, reproducible HTML page.

    Args:
        result: Opened result.
        notes: Notes on opening the result.
    """
    contents = Contents(result, notes)
    added = additions("sections", callable, "a function").values()
    sections = [section(contents) for section in (*SECTIONS, again_section, *added)]
    title = contents.outcome.mission or f"Report on {result.reader.name}"
    return page_html(title, sections, _subtitle(contents))


def _subtitle(contents: Contents) -> str:
    span, fixes = contents.span_ns, contents.result.fixes
    if span is None:
        return ""
    begin, end = map(clock_text, span)
    measured = fixes.index[~fixes["dead_reckoned"].to_numpy(bool)]
    fix = f"last fix {clock_text(measured[-1].value)} UTC" if len(measured) else ""
    dives = int((contents.result.dives.index > 0).sum())
    used = count_text(contents.outcome.observations["used"], "observation")
    dive = count_text(dives, "dive") if dives else ""
    return " · ".join(filter(None, [f"{begin} to {end} UTC", fix, dive, used]))


def several_html(contents: Contents, pages: Mapping[str, str]) -> str:
    """Return the report page on all vehicles of a result.

    Args:
        contents: Contents of the result.
        pages: File names of the vehicles' pages by vehicle.
    """
    outcome, span = contents.outcome, contents.span_ns
    links = {name: f'<a href="{escape(page)}">{escape(name)}</a>' for name, page in pages.items()}
    rows = [
        (links.get(str(name), escape(str(name))), *(Sentence([cell]).html for cell in rest))
        for name, *rest in vehicle_cells(outcome)
    ]
    briefs = [f"{name}: {used} observations; {verdict}" for name, used, *_, verdict in rows]
    card = (
        f"<h3>{escape(capitalized(str(outcome.verdict)))}</h3>"
        f"{items_html([*map(escape, outcome.basis)])}<h3>Vehicles</h3>{items_html(briefs)}"
    )
    said = [
        *map(escape, (*contents.notes, *map(finding_line, outcome.consistency))),
        *(each.html for each in estimate_sentences(outcome)),
        *map(escape, (*outcome.notes, *vehicle_sentences(outcome))),
    ]
    caption = "Vehicles: what each measured, and what the estimate would be without it"
    html = f"{table_html(COLUMNS, rows, caption)}{items_html(said)}"
    sections = [map_section(contents, card), Section("vehicles", "Vehicles", html)]
    parts = [
        *([f"{time_text(span[0])[:16]} to {time_text(span[1])[:16]} UTC"] if span else []),
        count_text(len(contents.each), "vehicle"),
        count_text(outcome.observations["used"], "observation"),
    ]
    title = f"Report on {contents.result.reader.name}"
    return page_html(title, [*sections, again_section(contents)], " · ".join(parts))
