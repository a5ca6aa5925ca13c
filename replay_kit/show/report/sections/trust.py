"""Report section on consistency: innovations, calibration, error over time, and gate."""

from html import escape
from typing import NamedTuple

from replay_kit.core.errors import severity_word
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.outcome.verdict import doubtful_errors
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.figure import Figure
from replay_kit.show.figures.trust import trust_figures
from replay_kit.show.numbers import Sentence, Shown, sentence
from replay_kit.show.page.page import Section
from replay_kit.show.page.parts import items_html, table_html
from replay_kit.show.report.sections.answer import warnings_html
from replay_kit.show.sentences import trust_sentences

_ITSELF = {
    "good": "log fits itself",
    "care": "log raises doubts",
    "stop": "log contradicts itself",
}


class Light(NamedTuple):
    """Status light of a consistency test.

    Attributes:
        name: Outcome in a few words.
        color: ``good``, ``care``, ``stop``, or ``none`` if untested.
        text: Reason.
        figures: Keys of the supporting figures.
    """

    name: str
    color: str
    text: Sentence
    figures: tuple[str, ...]


def lights(contents: Contents) -> tuple[Light, Light, Light]:
    """Return the lights for consistency of the log, misfit of the forecast, and calibration of errors."""
    outcome = contents.outcome
    clashes = [one for one in outcome.consistency if one["severity"] != "misfit"]
    words = {severity_word(one["severity"]) for one in clashes}
    worst = "stop" if "contradiction" in words else "care" if clashes else "good"
    said = "; ".join(f"{one['name']}: {one['evidence']}" for one in clashes)
    itself = Light(
        _ITSELF[worst],
        worst if outcome.complete else "none",
        Sentence([said or "No contradiction was found in the log."]),
        ("innovations",),
    )
    return itself, _against_forecast(outcome), _errors_hold(outcome)


def _against_forecast(outcome: Outcome) -> Light:
    misfits = [one["evidence"] for one in outcome.consistency if one["severity"] == "misfit"]
    rms, outside = outcome.rms_innovation, "; ".join([*outcome.outside, *misfits])
    before, prior = rms["before"], rms["prior"]
    if before is None or not prior:
        why = Sentence(["No measurement was compared with the forecast."])
        return Light("forecast not compared", "none", why, ())
    forms = "RMS misfit of the forecast {prior:cm/s}, of the estimate {before:cm/s} cm/s"
    gain = sentence(forms, rms, "rms_innovation.").parts
    fits = before <= prior and not outside
    return Light(
        "fits forecast" if fits else "misfits forecast",
        "good" if fits else "care",
        Sentence([*gain, f"; {outside}." if outside else "."]),
        ("dives", "error"),
    )


def _errors_hold(outcome: Outcome) -> Light:
    nis = outcome.nis_per_dof
    if nis is None:
        return Light(
            "errors not tested",
            "none",
            Sentence(["No measurement tested the standard errors."]),
            (),
        )
    said, shown, hold = outcome.errors_text, f"{nis:.2f}", not doubtful_errors(outcome)
    before, after = f"{said[:1].upper()}{said[1:]} (NIS/dof ", ", 1 expected)."
    return Light(
        "errors hold" if hold else "errors do not hold",
        "good" if hold else "care",
        Sentence([before, Shown("nis_per_dof", nis, shown), after]),
        ("calibration",),
    )


def trust_section(contents: Contents) -> Section:
    """Return the section on innovations, calibration, error over time and gate decisions."""
    outcome, figures, parts = contents.outcome, dict[str, Figure](), {}
    missing = ["The result holds no measurement to compare the estimate with."]
    html = warnings_html(contents)
    if contents.measured.count:
        figures, missing = trust_figures(contents)
        told = [each.html for each in trust_sentences(outcome)]
        html += _gate_html(contents) + (items_html(told) if told else "")
        for light in lights(contents):
            head = (
                f'<span class="light {light.color}">{escape(light.name)}</span> {light.text.html}'
            )
            parts[head] = [key for key in light.figures if key in figures]
    placed = [figures[key] for keys in parts.values() for key in keys]
    answer = "No verdict: the run did not finish, or an earlier version made the result."
    if outcome.complete:
        answer = f"{escape(str(outcome.verdict).capitalize())}."
    title = "How far can it be trusted?"
    return Section("trust", title, html, placed, missing, "Trust", answer, parts=parts)


def _gate_html(contents: Contents) -> str:
    sums = contents.measured.sums
    rows = [
        [escape(name), f"{count:,}"]
        for name, count in sums.groupby("decision")["measurements"].sum().items()
    ]
    notes = [note for note in contents.outcome.notes if "bias" in note]
    biases = "".join(f"<p>{escape(note)}.</p>" for note in notes)
    return (
        table_html(["decision of the gate", "measurements"], rows, "Decisions of the gate") + biases
    )
