"""Report pages: one vehicle, or several with a common estimate and a page for each."""

import json
import shlex
import tomllib
from collections.abc import Callable, Mapping, Sequence
from html import escape
from types import MappingProxyType
from typing import Any

from replay_kit.core.errors import finding_line
from replay_kit.core.extensions import additions
from replay_kit.core.text import count_text, time_text
from replay_kit.results.outcome.outcome import leaves
from replay_kit.results.result import ResultFile
from replay_kit.results.topics import CONFIG_NAME
from replay_kit.results.views.contents import Contents
from replay_kit.show.numbers import Sentence, clock_text, number
from replay_kit.show.page.map import map_of
from replay_kit.show.page.page import Section, page_html
from replay_kit.show.page.parts import items_html, table_html
from replay_kit.show.report.card import card_html
from replay_kit.show.report.sections.along_track import along_track_section
from replay_kit.show.report.sections.answer import words_section
from replay_kit.show.report.sections.plan import plan_section
from replay_kit.show.report.sections.trust import trust_section
from replay_kit.show.sentences import estimate_sentences
from replay_kit.show.vehicles import ABOUT_VALUE, COLUMNS, vehicle_cells, vehicle_sentences

#: Defaults of settings by table.
Defaults = Mapping[str, Mapping[str, Any]]
_NONE: Defaults = MappingProxyType({})
# Entries of a list of the summary that are shown.
_LONG = 12


def again_section(contents: Contents, defaults: Defaults) -> Section:
    """Return the section on reproducing the result, with the summary as a table."""
    metadata, missing, html = contents.metadata, list[str](), ""
    inputs = {
        name: text.rpartition(" sha256:")
        for name, text in metadata.get("replay_kit.inputs", {}).items()
    }
    if any(name.startswith("log") for name in inputs):
        html = (
            "<p>The command; <code>config.toml</code> is attached to the result:</p>"
            f"<pre>{escape(_command(contents, {name: file for name, (file, *_) in inputs.items()}))}</pre>"
        )
    elif inputs:
        made = "; replay-kit verify reproduces it" if "replay_kit.plan" in metadata else ""
        missing.append(f"This result was made by replay-kit plan; its options are below{made}.")
    else:
        missing.append("The result does not name its inputs.")
    digests = {name: (file, digest) for name, (file, _, digest) in inputs.items()}
    versions = {**metadata.get("contract", {}), **metadata.get("replay_kit.versions", {})}
    names = {"version": "contract of the result", "replay_kit": "replay-kit"}
    shown = {names.get(name, name): (value,) for name, value in versions.items()}
    region = {
        **metadata.get("replay_kit.region", {}),
        **metadata.get("replay_kit.options", {}),
    }
    options = {name.replace("_", " "): (value,) for name, value in region.items() if value}
    html += _rows_html("Inputs", ("input", "file", "SHA-256"), digests)
    html += _rows_html("Versions", ("what", "version"), shown) + _settings(
        contents, defaults, missing
    )
    html += _rows_html("Region, basis and options", ("what", "value"), options) + _numbers(contents)
    answer = "Files, versions, settings, and every number of the summary."
    return Section("again", "How was it made?", html, missing=missing, menu="Files", answer=answer)


def _rows_html(caption: str, heads: Sequence[str], rows: Mapping[str, Sequence[str]]) -> str:
    """Return texts by name as an HTML table; empty without any."""
    cells = [[escape(name), *map(escape, texts)] for name, texts in rows.items()]
    return table_html(heads, cells, caption) if cells else ""


def _command(contents: Contents, inputs: Mapping[str, str]) -> str:
    """Return the commands that make and verify the result."""
    logs, ensemble = (
        [file for name, file in inputs.items() if name.startswith(begin)]
        for begin in ("log", "ensemble")
    )
    goal = contents.metadata.get("replay_kit.options", {}).get("goal", "")
    parts = ["replay-kit", "replay", *logs, "--ensemble", *(ensemble or ["ENSEMBLE"])]
    parts += ["--config", "config.toml", *([f"--goal={goal}"] if goal else [])]
    out = contents.result.reader.name
    return (
        f"{shlex.join([*parts, '-o', out])}\nreplay-kit verify {shlex.quote(out)} --inputs FOLDER"
    )


def _settings(contents: Contents, defaults: Defaults, missing: list[str]) -> str:
    toml = contents.result.reader.text(CONFIG_NAME)
    if not toml:
        missing.append("The result does not hold its configuration.")
        return ""
    changed = {
        f"{section}.{key}": (json.dumps(value), json.dumps(defaults.get(section, {}).get(key)))
        for section, values in tomllib.loads(toml).items()
        for key, value in values.items()
        if value != defaults.get(section, {}).get(key)
    }
    if not changed:
        return "<p>All settings have their defaults.</p>"
    caption = "Settings that differ from their defaults"
    return _rows_html(caption, ("setting", "value", "default"), changed)


def _shortened(value: Any) -> Any:
    """Return nested values with long lists replaced by a sentence, to limit the page's size."""
    if isinstance(value, Mapping):
        return {key: _shortened(item) for key, item in value.items()}
    if isinstance(value, list):
        long = f"{len(value)} entries, in the JSON of replay-kit replay --json"
        return long if len(value) > _LONG else [_shortened(item) for item in value]
    return value


def _numbers(contents: Contents) -> str:
    rows = []
    for path, value in leaves(_shortened(contents.outcome.to_json())):
        exact = isinstance(value, int | float) and not isinstance(value, bool)
        shown = (
            number(path, value, f"{value:,}" if isinstance(value, int) else f"{value:.6g}")
            if exact
            else escape("unknown" if value is None else str(value))
        )
        rows.append([f"<code>{escape(path)}</code>", shown])
    return table_html(
        ["path in the summary", "value"], rows, "All numbers of the summary, as in --json"
    )


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


#: The sections from top to bottom; each is a pure function of the opened result.
SECTIONS: tuple[Callable[[Contents], Section], ...] = (
    *(map_section, words_section, along_track_section, trust_section, plan_section),
)


def report_html(
    result: ResultFile,
    notes: tuple[str, ...] = (),
    defaults: Defaults = _NONE,
) -> str:
    """Return a result as a self-contained, reproducible HTML page.

    Args:
        result: Opened result.
        notes: Notes on opening the result.
        defaults: Defaults of the settings by table; the page names those that differ.
    """
    contents = Contents(result, notes)
    added = additions("sections", callable, "a function").values()
    sections = [section(contents) for section in (*SECTIONS, *added)]
    sections.insert(len(SECTIONS), again_section(contents, defaults))
    title = contents.outcome.mission or f"Report on {result.reader.name}"
    return page_html(title, sections, _subtitle(contents))


def _subtitle(contents: Contents) -> str:
    span, dives = contents.span_ns, int((contents.result.dives.index > 0).sum())
    if span is None:
        return ""
    begin, end = map(clock_text, span)
    fixes = contents.result.fixes
    measured = fixes.index[~fixes["dead_reckoned"].to_numpy(bool)] if len(fixes) else fixes.index
    fix = f"last fix {clock_text(measured[-1].value)} UTC" if len(measured) else ""
    dive = count_text(dives, "dive") if dives else ""
    used = count_text(contents.outcome.observations["used"], "observation")
    return " · ".join(filter(None, [f"{begin} to {end} UTC", fix, dive, used]))


def several_html(contents: Contents, pages: Mapping[str, str], defaults: Defaults) -> str:
    """Return the report page on all vehicles of a result.

    Args:
        contents: Contents of the result.
        pages: File names of the vehicles' pages by vehicle.
        defaults: See ``report_html``.
    """
    sections = [
        map_section(contents, _card(contents, pages)),
        _vehicles(contents, pages),
        again_section(contents, defaults),
    ]
    span, outcome = contents.span_ns, contents.outcome
    begin, end = ("", "") if span is None else (time_text(each)[:16] for each in span)
    parts = [
        f"{begin} to {end} UTC",
        count_text(len(contents.each), "vehicle"),
        count_text(outcome.observations["used"], "observation"),
    ]
    return page_html(f"Report on {contents.result.reader.name}", sections, " · ".join(parts))


def _card(contents: Contents, pages: Mapping[str, str]) -> str:
    """Return the summary card of several vehicles: verdict, and a line for each."""
    outcome = contents.outcome
    rows = [
        f"{_link(str(name), pages)}: {Sentence([used]).html} observations; {Sentence([verdict]).html}"
        for name, used, *_, verdict in vehicle_cells(outcome)
    ]
    return (
        f"<h3>{escape(str(outcome.verdict).capitalize())}</h3>"
        f"{items_html([escape(text) for text in outcome.basis])}<h3>Vehicles</h3>{items_html(rows)}"
    )


def _vehicles(contents: Contents, pages: Mapping[str, str]) -> Section:
    """Return the section on vehicles: table, value of their measurements, and notes."""
    outcome = contents.outcome
    rows = [
        (_link(str(name), pages), *(Sentence([cell]).html for cell in rest))
        for name, *rest in vehicle_cells(outcome)
    ]
    before = (*contents.notes, *map(finding_line, outcome.consistency))
    after = (*outcome.notes, *vehicle_sentences(outcome))
    said = [
        *map(escape, before),
        *(each.html for each in estimate_sentences(outcome)),
        *map(escape, after),
    ]
    table = table_html(
        COLUMNS, rows, "Vehicles: what each measured, and what the estimate would be without it"
    )
    html = f"{table}<p>{escape(ABOUT_VALUE)}.</p>{items_html(said)}"
    return Section("vehicles", "Vehicles", html)


def _link(name: str, pages: Mapping[str, str]) -> str:
    page = pages.get(name)
    return escape(name) if page is None else f'<a href="{escape(page)}">{escape(name)}</a>'
