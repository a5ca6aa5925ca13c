"""Report sections in words, on observations, findings, exclusions and next steps, and on consistency with its warnings."""

from collections.abc import Iterator
from html import escape
from typing import NamedTuple

import numpy as np

from replay_kit.core.errors import severity_word
from replay_kit.core.words.text import capitalized, count_text, time_text
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.outcome.verdict import doubtful_errors
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.figure import Figure
from replay_kit.show.figures.trust import trust_figures
from replay_kit.show.numbers import Sentence, Shown, number, sentence
from replay_kit.show.page.page import Section, items_html, table_html
from replay_kit.show.sentences import estimate_sentences, flown_sentences, trust_sentences

_KINDS = {"stop": "Stop", "care": "Care", "note": "Note"}


def found_warnings(contents: Contents) -> list[tuple[str, str]]:
    """Return the alarms, warnings and notes, each with its kind and an escaped sentence."""
    outcome, events = contents.outcome, contents.result.events
    notes, care = outcome.notes, [*_cautions(outcome)]
    told = dict.fromkeys(events["message"][events["level"].isin(["warning", "error"])])
    said = [text for text in told if text not in notes]
    care += [escape(_sentence(text)) for text in said]
    severity = {one["name"]: severity_word(one["severity"]) for one in outcome.consistency}
    whole = {
        one["name"]: f"{one['name']}: {one['evidence']}; {one['set']}"
        for one in outcome.consistency
    }
    alarms = [
        (
            "stop"
            if one.about in ("unsafe", "failed") or severity.get(one.about) == "contradiction"
            else "care",
            escape(_sentence(whole.get(one.about, one.text))),
        )
        for one in outcome.alarms
        # what was found with the last message alone is no event
        if one.kind == "plan" or not any(text.startswith(one.about) for text in said)
    ]
    read = [("note", escape(_sentence(note))) for note in notes]
    return [*alarms, *(("care", text) for text in care), *read]


def next_steps(contents: Contents) -> list[str]:
    """Return the next steps as escaped sentences."""
    outcome, plans, out = contents.outcome, contents.result.plans, []
    plan = outcome.plan
    if plan and (plan["status"] == "failed" or plan.get("heading_deg") is None):
        why = "No command" if plan["status"] == "reached" else "No plan was found"
        out.append(f"{why}: {escape(plan['message'])}.")
    elif not len(plans):
        out.append("Give a goal with <code>--goal LON,LAT,DEPTH</code> to plan a mission.")
    if doubtful_errors(outcome) and (outcome.nis_per_dof or 0.0) > 1.0:
        # mean currents have no bins whose quality could be tested
        look = (
            "Run <code>replay-kit qc</code> on the log and compare"
            if contents.bins.time_ns.size
            else "Compare"
        )
        out.append(
            f"{look} the innovations below dive by dive: either the instrument is biased, or the "
            "ensemble does not fit this region and time. Until then, treat the standard errors as too small."
        )
    if outcome.losses or outcome.late:
        out.append(
            "Recover the log from the vehicle again if possible: the losses are listed above."
        )
    if contents.estimate is None and contents.measured.count:
        out.append("Replay the log again, to its end, for the current and its uncertainty.")
    reasons = "; ".join(map(escape, outcome.verdict.reasons if outcome.complete else ()))
    return out or [f"Check before use: {reasons}." if reasons else NO_STEP]


def _sentence(text: str) -> str:
    """Return a note as a sentence; a leading name of a file or variable keeps its case."""
    is_name = (
        any(letter in text.split(maxsplit=1)[0] for letter in "._/") if text.strip() else False
    )
    return (text if is_name else capitalized(text)) + ("" if text.endswith(".") else ".")


def _cautions(outcome: Outcome) -> Iterator[str]:
    """Yield escaped sentences on losses, rejections and surfacings that missed."""
    late, losses = outcome.late, outcome.losses
    if losses:
        yield f"{len(losses)} damaged parts of the logs were lost."
    if late:
        count = number("late", late, f"{late:,}")
        yield f"{count} messages came later than the reorder window allows."
    if outcome.lost_pings:
        yield escape(_sentence(outcome.lost_pings))
    rejected, counts = outcome.observations["rejected"], outcome.observations
    if rejected > 0.1 * (total := counts["used"] + rejected):
        form = f"{{rejected}} of {total:,} measurements were rejected."
        yield sentence(form, counts, "observations.").html
    share = (outcome.surfacings or {}).get("inside_ellipse")
    if share is not None and share < 0.6:
        form = (
            "Only {inside_ellipse:share} of the surfacings lie in the ellipse predicted to hold 90 %: the vehicle did not fly "
            "these plans, or the current is less certain than stated."
        )
        yield sentence(form, {"inside_ellipse": share}, "surfacings.").html


def words_section(contents: Contents) -> Section:
    """Return the report section in words."""
    outcome = contents.outcome
    used = estimate_sentences(outcome) if outcome.complete else ()
    lacks = (
        "The result holds only a plan." if len(contents.result.plans) else "Nothing was estimated."
    )
    found = [] if contents.slices is not None else [Sentence([lacks])]
    parts = {
        "What was measured": [Sentence([_measured(contents)]), *used],
        "What was found": [*found, *flown_sentences(outcome)],
        "What was not used, and why": [*_not_used(contents)],
    }
    lists = (
        f"<h3>{title}</h3>{items_html([each.html for each in said])}"
        for title, said in parts.items()
        if said
    )
    html = f"{''.join(lists)}<h3>What to do next</h3>{items_html(next_steps(contents))}"
    missing = [*contents.notes, *([contents.without_estimate] if contents.without_estimate else [])]
    title = "What was measured and found?"
    return Section(
        "answer", title, html, missing=missing, menu="Answer", answer=_in_short(contents)
    )


def _in_short(contents: Contents) -> str:
    outcome = contents.outcome
    if not outcome.complete:
        return "Observations used: unknown."
    used, rms = outcome.observations, outcome.rms_innovation
    forms = f"{{used}} measurement{'s' * (used['used'] != 1)} of the current used"
    parts = [sentence(forms, used, "observations.").html]
    if rms["before"] is not None and rms["prior"]:
        forms = "misfit {prior:cm} of the forecast, {before:cm} of the estimate"
        parts.append(sentence(forms, rms, "rms_innovation.").html)
    return f"{'; '.join(parts)}."


def _measured(contents: Contents) -> str:
    """Return the time span, positions and depths of the observations as text."""
    track, span = contents.track, contents.span_ns
    if span is None:
        return "The result holds neither a position nor a measurement."
    hours, dives = (span[1] - span[0]) / 3.6e12, int((contents.result.dives.index > 0).sum())
    parts = [f"{time_text(span[0])} to {time_text(span[1])} ({hours:.1f} hours)"]
    parts.append(count_text(dives, "dive") if dives else "without dives")
    if track.distance.size:
        parts.append(f"{track.distance[-1] / 1e3:.1f} km travelled")
    for what, depth in (("positions", track.depth), ("bins used", contents.bins.depth)):
        if np.isfinite(depth).any():
            # whole numbers have no negative zero
            least, most = round(float(np.nanmin(depth))), round(float(np.nanmax(depth)))
            parts.append(f"{what} at {least} to {most} m")
    return "; ".join(parts)


def _not_used(contents: Contents) -> Iterator[Sentence]:
    """Yield a sentence on the unused messages of each topic."""
    messages = contents.outcome.messages
    if messages is None:
        why = contents.outcome.unjudged or "an earlier version made it"
        yield Sentence([f"The result does not hold the counts of messages: {why}."])
        return
    for k, row in enumerate(messages):
        if row["skipped"]:
            why = "; ".join(
                f"{{reasons.{n}.count}} x {{reasons.{n}.reason}}"
                for n in range(len(row["reasons"]))
            )
            template = f"{{topic}}: {{skipped}} of {{read}} messages; {why}"
            yield sentence(template, row, f"messages.{k}.")


#: The next step of a result that needs none.
NO_STEP = "No action needed."
_ITSELF = {
    "good": "log fits itself",
    "care": "log raises doubts",
    "stop": "log contradicts itself",
    "none": "log not judged",
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
    worst = worst if outcome.complete else "none"
    said = "; ".join(f"{one['name']}: {one['evidence']}" for one in clashes)
    itself = Light(
        _ITSELF[worst],
        worst,
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
        "fits forecast" if fits else "does not fit forecast",
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
    before, after = f"{capitalized(said)} (NIS/dof ", ", 1 expected)."
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
    warnings = [
        f'<li class="{kind}"><b>{_KINDS[kind]}</b> {text}</li>'
        for kind, text in sorted(found_warnings(contents), key=lambda one: [*_KINDS].index(one[0]))
    ]
    html = "<p>No problems detected.</p>"
    if warnings:
        html = f'<ul class="warnings">{"".join(warnings)}</ul>'
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
    judged = outcome.unjudged and f"No verdict: {outcome.unjudged}"
    answer = escape(_sentence(judged or str(outcome.verdict)))
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
