"""The answer in words: what was measured, the sentences of the summary, what was not used, what to do next."""

from collections.abc import Iterator

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.text import count_text, time_text
from replay_kit.results.views.contents import Contents
from replay_kit.show.numbers import Sentence, sentence
from replay_kit.show.page.section import Section, items_html
from replay_kit.show.report.sections.warnings import next_steps
from replay_kit.show.words import estimate_sentences, found_sentences


def words_section(contents: Contents) -> Section:
    """Return the answer in words."""
    outcome = contents.outcome
    parts = {
        "What was measured": [Sentence([_measured(contents)]), *estimate_sentences(outcome)],
        "What was found": [*_found(contents), *found_sentences(outcome)],
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
    used, rms = outcome.observations, outcome.rms_innovation
    forms = f"{{used}} measurement{'s' * (used['used'] != 1)} of the current used"
    parts = [sentence(forms, used, "observations.").html]
    if rms["before"] is not None and rms["prior"]:
        forms = "misfit {prior:cm} of the forecast, {before:cm} of the estimate"
        parts.append(sentence(forms, rms, "rms_innovation.").html)
    return f"{'; '.join(parts)}."


def _measured(contents: Contents) -> str:
    """Return when and where."""
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
            parts.append(f"{what} at {_depths(depth)}")
    return "; ".join(parts)


def _depths(depth: Array) -> str:
    # whole numbers have no negative zero
    return f"{round(float(np.nanmin(depth)))} to {round(float(np.nanmax(depth)))} m"


def _found(contents: Contents) -> Iterator[Sentence]:
    """Yield the speed of the current and its error over the region."""
    slices, plans = contents.slices, contents.result.plans
    if slices is None:
        what = "The result holds a plan alone" if len(plans) else "Nothing was estimated"
        yield Sentence([f"{what}."])
        return
    fields = slices.fields[0, -1]
    speed, error = np.hypot(*fields[:2]), fields[2:]
    for name, values in (("Current", speed), ("Standard error of a component", error)):
        if np.isfinite(values).any():
            ends = f"{np.nanmin(values):.3f} to {np.nanmax(values):.3f} m/s"
            yield Sentence(
                [f"{name} at {slices.depths[0]:g} m, at the end of the log: {ends} in the region"]
            )


def _not_used(contents: Contents) -> Iterator[Sentence]:
    """Yield what of each topic was not used."""
    messages = contents.outcome.messages
    if messages is None:
        why = "it is of an earlier version, or of a run that did not end"
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
