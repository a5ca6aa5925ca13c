"""Whether the answer can be trusted: innovations, their spread against the stated errors, the error's decrease, the gate."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from replay_kit.results.views.contents import Contents
from replay_kit.results.views.slices import EXPECTED, Calibration, calibration, information_by_dive
from replay_kit.show.figures.on_page import figure_of
from replay_kit.show.figures.trust import trust_charts
from replay_kit.show.page.section import Section, cm, number, table_html
from replay_kit.show.words import (
    evidence_sentence,
    referee_sentences,
    surfacings_sentences,
)


def trust_section(contents: Contents) -> Section:
    """Return innovations, calibration, the decrease of the error and the decisions of the gate."""
    if not len(contents.result.observations):
        return Section(
            "trust",
            "Trust",
            missing=["The result holds no measurement to compare the estimate with."],
        )
    charts, missing = trust_charts(contents)
    dives = contents.outcome.by_dive
    html = (
        _coverage_html(calibration(contents.result.innovations))
        + _gate_html(contents)
        + _dives_html(contents, dives)
        + _evidence_html(contents)
        + surfacings_html(contents.outcome.expected_surfacings)
    )
    return Section("trust", "Trust", html, [figure_of(chart) for chart in charts.values()], missing)


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
