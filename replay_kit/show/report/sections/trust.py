"""Whether the answer can be trusted: innovations, their spread against the stated errors, the error's decrease, the gate."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

from replay_kit.core.errors import severity_word
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.outcome.verdict import LEAST_NIS, MOST_NIS, nis_sentence
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.slices import EXPECTED, Calibration, calibration, information_by_dive
from replay_kit.show.figures.on_page import figure_of
from replay_kit.show.figures.trust import trust_charts
from replay_kit.show.page.page import figure_html
from replay_kit.show.page.section import Figure, Section, cm, number, table_html
from replay_kit.show.report.sections.warnings import warnings_html
from replay_kit.show.words import (
    evidence_sentence,
    referee_sentences,
    surfacings_sentences,
)

_ITSELF = {
    "good": "log fits itself",
    "care": "log raises doubts",
    "stop": "log contradicts itself",
}


class Light(NamedTuple):
    """The answer to a question of trust.

    Attributes:
        name: What holds, or does not, in a few words.
        color: ``good``, ``care``, ``stop`` or ``none`` where nothing tells.
        text: Why, as a sentence.
        figures: Keys of the figures that show it.
    """

    name: str
    color: str
    text: str
    figures: tuple[str, ...]


def lights(contents: Contents) -> tuple[Light, Light, Light]:
    """Return whether the log fits itself, whether it fits the forecast, and whether the stated errors hold."""
    outcome = contents.outcome
    clashes = [one for one in outcome.consistency if one["severity"] != "misfit"]
    words = {severity_word(one["severity"]) for one in clashes}
    worst = "stop" if "contradiction" in words else "care" if clashes else "good"
    said = "; ".join(f"{one['name']}: {one['evidence']}" for one in clashes)
    itself = Light(
        _ITSELF[worst],
        worst if outcome.complete else "none",
        said or "No contradiction was found in the log.",
        ("innovations",),
    )
    return itself, _against_forecast(outcome), _errors_hold(outcome)


def _against_forecast(outcome: Outcome) -> Light:
    misfits = [one["evidence"] for one in outcome.consistency if one["severity"] == "misfit"]
    rms, outside = outcome.rms_innovation, "; ".join([*outcome.outside, *misfits])
    before, prior = rms["before"], rms["prior"]
    if before is None or not prior:
        return Light("forecast not compared", "none", "No measurement was compared with it.", ())
    gain = (
        f"RMS misfit of the forecast {100.0 * prior:.1f}, of the estimate {100.0 * before:.1f} cm/s"
    )
    fits = before <= prior and not outside
    return Light(
        "fits the forecast" if fits else "misfits the forecast",
        "good" if fits else "care",
        f"{gain}{f'; {outside}' if outside else ''}.",
        ("dives", "error"),
    )


def _errors_hold(outcome: Outcome) -> Light:
    nis = outcome.nis_per_dof
    if nis is None:
        return Light("errors not tested", "none", "No measurement tested them.", ())
    hold = LEAST_NIS <= nis <= MOST_NIS
    return Light(
        "stated errors hold" if hold else "stated errors do not hold",
        "good" if hold else "care",
        f"{nis_sentence(nis)[:1].upper()}{nis_sentence(nis)[1:]}.",
        ("calibration",),
    )


def trust_section(contents: Contents) -> Section:
    """Return innovations, calibration, the decrease of the error and the decisions of the gate."""
    if not len(contents.result.observations):
        return Section(
            "trust",
            "How far can it be trusted?",
            warnings_html(contents),
            missing=["The result holds no measurement to compare the estimate with."],
            menu="Trust",
            answer=_answer(contents),
        )
    charts, missing = trust_charts(contents)
    shown = {key: figure_of(chart) for key, chart in charts.items()}
    blocks, placed = [], list[Figure]()
    for light in lights(contents):
        figures = [shown[key] for key in light.figures if key in shown]
        own = "".join(map(figure_html, figures))
        placed += figures
        head = f'<summary><span class="light {light.color}">{escape(light.name)}</span> {escape(light.text)}</summary>'
        blocks.append(f'<details class="lit">{head}{own}</details>')
    tables = (
        _coverage_html(calibration(contents.result.innovations))
        + _gate_html(contents)
        + _dives_html(contents, contents.outcome.by_dive)
        + _evidence_html(contents)
        + surfacings_html(contents.outcome.expected_surfacings)
    )
    html = warnings_html(contents) + "".join(blocks)
    html += f'<details class="lit"><summary>The figures as tables</summary>{tables}</details>'
    return Section(
        "trust",
        "How far can it be trusted?",
        html,
        placed,
        missing,
        menu="Trust",
        answer=_answer(contents),
        placed=True,
    )


def _answer(contents: Contents) -> str:
    if not contents.outcome.complete:
        return "No verdict: the run did not finish, or an earlier version made the result."
    return f"{escape(str(contents.outcome.decision).capitalize())}."


def _coverage_html(found: Calibration) -> str:
    if not found.coverage:
        return ""
    rows = [
        [f"{limit:g}", f"{100 * EXPECTED[limit]:.1f} %", f"{100 * share:.1f} %"]
        for limit, share in found.coverage.items()
    ]
    return table_html(
        ["standard deviations", "expected", "found"],
        rows,
        "Share of the innovations within the stated errors",
    )


def _gate_html(contents: Contents) -> str:
    table = contents.result.observations
    rows = [
        [escape(name), f"{count:,}"]
        for name, count in table["decision"].value_counts().sort_index().items()
    ]
    inflated = int((table["prior_inflation"] > 1.0).sum())
    text = (
        f"<p>The estimate's covariance was inflated {inflated} times because the latest measurements lay outside it.</p>"
        if inflated
        else ""
    )
    notes = [note for note in contents.outcome.notes if "bias" in note]
    biases = "".join(f"<p>{escape(note)}.</p>" for note in notes)
    return (
        table_html(
            ["decision of the gate", "measurements"], rows, "What was done with the measurements"
        )
        + text
        + biases
    )


def _evidence_html(contents: Contents) -> str:
    """Return the log evidence of the run, and of the forecasts that it was compared with, in words."""
    found, compared = contents.outcome.evidence, contents.outcome.referee
    if not found:
        return ""
    sentences = [
        f"Log evidence: {evidence_sentence(found)}",
        *(referee_sentences(compared) if compared else ()),
    ]
    return "".join(f"<p>{escape(sentence)}.</p>" for sentence in sentences)


def _dives_html(contents: Contents, dives: Sequence[Mapping[str, Any]]) -> str:
    if not dives:
        return "<p>The log has no dives with measurements to compare.</p>"
    information = information_by_dive(contents.result.observations)
    rows = []
    for k, dive in enumerate(dives):
        key = f"by_dive.{k}"
        nis = dive["nis_per_dof"]
        rows.append(
            [
                number(f"{key}.dive", dive["dive"], str(dive["dive"])),
                number(f"{key}.profiles", dive["profiles"], str(dive["profiles"])),
                number(f"{key}.bins", dive["bins"], str(dive["bins"])),
                cm(f"{key}.rms_innovation_predicted", dive["rms_innovation_predicted"]),
                cm(f"{key}.rms_innovation_prior", dive["rms_innovation_prior"]),
                number(f"{key}.nis_per_dof", nis, "" if nis is None else f"{nis:.2f}"),
                f"{information.get(dive['dive'], 0.0):.1f}",
            ]
        )
    heads = [
        "dive",
        "profiles",
        "bins",
        "missed by the estimate before it",
        "missed by the prior forecast",
        "NIS/dof",
        "independent values determined",
    ]
    return table_html(
        heads, rows, "The dives: each predicted from the dives before it, and what it added"
    )


_SURFACING_HEADS = (
    "dive",
    "earlier dives",
    "distance [m]",
    "50 % ellipse [m]",
    "90 % ellipse [m]",
    "held by",
    "log score",
    "log score of the last dive's current",
)


def surfacings_html(found: Mapping[str, Any] | None) -> str:
    """Return the expected surfacings of a summary as a table with its sentences; empty without any."""
    if not found:
        return ""
    words = "".join(
        f"<p>{escape(sentence[0].upper() + sentence[1:])}.</p>"
        for sentence in surfacings_sentences(found)
    )
    rows = [
        _surfacing_row(f"expected_surfacings.each.{k}", one) for k, one in enumerate(found["each"])
    ]
    return (
        table_html(
            list(_SURFACING_HEADS), rows, "Surfacings: each expected from the dives before it"
        )
        + words
    )


def _surfacing_row(key: str, one: dict[str, Any]) -> list[str]:
    held = "50 %" if one["inside_50"] else "90 %" if one["inside_90"] else "neither"
    axes = [
        f"{one[name]['major_m']:.0f} x {one[name]['minor_m']:.0f}"
        for name in ("ellipse_50", "ellipse_90")
    ]
    scores = [
        number(f"{key}.{name}", one[name], _score(one[name]))
        for name in ("log_score", "persistent_log_score")
    ]
    counts = [
        number(f"{key}.{name}", one[name], str(one[name])) for name in ("dive", "earlier_dives")
    ]
    return [
        *counts,
        number(f"{key}.distance_m", one["distance_m"], f"{one['distance_m']:.0f}"),
        *axes,
        held,
        *scores,
    ]


def _score(score: float | None) -> str:
    return "" if score is None else f"{score:.2f}"
