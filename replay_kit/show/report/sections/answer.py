"""The answer in words: what was measured and found, how sure it is, what was not used, what looks wrong, what to do next."""

from html import escape

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import heading_deg
from replay_kit.core.text import time_text
from replay_kit.results.outcome.verdict import LEAST_NIS, MOST_NIS
from replay_kit.results.views.along_track import mean_current_topics
from replay_kit.results.views.contents import Contents
from replay_kit.show.page.section import Section, cm, items_html, number, table_html
from replay_kit.show.report.sections.warnings import next_steps
from replay_kit.show.words import flight_correction_sentence, source_sentence


def words_section(contents: Contents) -> Section:
    """Return the answer in words."""
    html = (
        _part("What was measured", [_measured(contents)])
        + _part("What was found", _found(contents))
        + _part("How sure it is", [_sure(contents)])
        + _part("What was not used, and why", _not_used(contents))
        + f"<h3>What to do next</h3>{items_html(next_steps(contents))}"
        + _current_here(contents)
    )
    missing = [*contents.notes, *([contents.without_estimate] if contents.without_estimate else [])]
    title = "What was measured and found?"
    return Section(
        "answer", title, html, missing=missing, menu="Answer", answer=_in_short(contents)
    )


def _in_short(contents: Contents) -> str:
    used = contents.outcome.observations["used"]
    parts = [f"{used:,} {'measurement' if used == 1 else 'measurements'} of the current used"]
    rms = contents.outcome.rms_innovation
    if rms["before"] is not None and rms["prior"]:
        parts.append(
            f"misfit {100.0 * rms['prior']:.1f} cm/s of the forecast, {100.0 * rms['before']:.1f} cm/s of the estimate"
        )
    return f"{'; '.join(parts)}."


def _part(title: str, paragraphs: list[str]) -> str:
    texts = (
        text if text.startswith("<ul>") else f'<p class="answer">{text}</p>'
        for text in paragraphs
        if text
    )
    return f"<h3>{escape(title)}</h3>{''.join(texts)}"


def _measured(contents: Contents) -> str:
    outcome, result, track = contents.outcome, contents.result, contents.track
    observations, span = outcome.observations, contents.span_ns
    if span is None:
        return "The result holds neither a position nor a measurement."
    dives = int((result.dives.index > 0).sum())
    used, bins = observations["used"], observations["bins_used"]
    parts = [
        f"From {time_text(span[0])} to {time_text(span[1])} ({(span[1] - span[0]) / 3.6e12:.1f} hours) the log gave "
        f"{number('observations.used', used, f'{used:,}')} {'measurement' if used == 1 else 'measurements'} of the current that "
        f"{'was' if used == 1 else 'were'} used "
        f"({_values(number('observations.bins_used', bins, f'{bins:,}'), bins, _mean_currents_used(contents))})"
    ]
    parts.append(
        f", on {dives} {'dive' if dives == 1 else 'dives'}."
        if dives
        else ", without dives: a vessel at the surface, or a log without depths."
    )
    if track.distance.size:
        depth = f", at depths of {_depths(track.depth)}" if np.isfinite(track.depth).any() else ""
        parts.append(f" The vehicle travelled {track.distance[-1] / 1e3:.1f} km{depth}.")
    if contents.bins.depth.size:
        parts.append(f" The bins of profiles that were used lie at {_depths(contents.bins.depth)}.")
    parts += [f" {source_sentence(row)}." for row in observations.get("sources", ())]
    if correction := outcome.flight_correction:
        parts.append(f" {flight_correction_sentence(correction)}.")
    return "".join(parts)


def _mean_currents_used(contents: Contents) -> int:
    """Return how many of the measurements that were used are mean currents, of dives or between fixes: they have no depth bins."""
    table = contents.result.observations
    return int(
        (
            table["source_topic"].isin(mean_current_topics(table, contents.result.innovations))
            & (table["dof"] > 0)
        ).sum()
    )


def _values(shown: str, values: int, mean_currents: int) -> str:
    """Return what the values used are, in words.

    Args:
        shown: Their number, as the page shows it.
        values: Their number.
        mean_currents: Those that are mean currents; the others are depth bins of profiles.
    """
    name = f"mean {'current' if mean_currents == 1 else 'currents'}"
    if mean_currents == 0:
        return f"{shown} depth bins"
    if mean_currents == values:
        return f"{shown} {name}, without depth bins"
    return f"{shown} values: {mean_currents:,} {name}, {values - mean_currents:,} depth bins of profiles"


def _depths(depth: Array) -> str:
    # whole numbers have no negative zero
    return f"{round(float(np.nanmin(depth)))} to {round(float(np.nanmax(depth)))} m"


def _found(contents: Contents) -> list[str]:
    rms = contents.outcome.rms_innovation
    out = []
    slices = contents.slices
    if slices is not None:
        speed = np.hypot(slices.fields[0, -1, 0], slices.fields[0, -1, 1])
        if np.isfinite(speed).any():
            out.append(
                f"At {slices.depths[0]:g} m, at the end of the log, the estimated current over the region is "
                f"{np.nanmean(speed):.2f} m/s on average and {np.nanmax(speed):.2f} m/s at most."
            )
    before, prior = rms["before"], rms["prior"]
    if before is not None and prior is not None:
        change = 100.0 * (1.0 - before / prior) if prior else 0.0
        verdict = (
            f"{change:.0f} % closer"
            if change > 0.5
            else f"{-change:.0f} % further away"
            if change < -0.5
            else "no closer"
        )
        out.append(
            f"The estimate, before it used a measurement, differed from it by {cm('rms_innovation.before', before)} "
            "(RMS of a component), the "
            f"prior forecast by {cm('rms_innovation.prior', prior)}: the estimate is {verdict}. "
            f"After the update {cm('rms_innovation.after', rms['after'])} remain, which include the instrument's own noise."
        )
    truth = contents.outcome.truth
    if truth:
        out.append(
            f"Against the known truth its RMSE is {cm('truth.rmse', truth['rmse'])}; "
            f"the ensemble mean's {cm('truth.ensemble_mean_rmse', truth['ensemble_mean_rmse'])}."
        )
    if not out and len(contents.result.plans):
        return ["The result holds a plan alone."]
    return out or ["Nothing was estimated from the measurements of this log."]


def _sure(contents: Contents) -> str:
    nis, slices, parts = contents.outcome.nis_per_dof, contents.slices, []
    if slices is not None:
        errors = slices.fields[0, -1, 2:]
        if np.isfinite(errors).any():
            parts.append(
                f"At {slices.depths[0]:g} m the standard error of a component is {np.nanmin(errors):.3f} m/s where it "
                "is least, near the track, "
                f"and {np.nanmax(errors):.3f} m/s where it is greatest."
            )
    if nis is not None:
        if LEAST_NIS <= nis <= MOST_NIS:
            verdict = "near 1, so the stated errors hold"
        elif nis > MOST_NIS:
            verdict = "above 1, so the true errors are larger than stated"
        else:
            verdict = "below 1, so the stated errors are larger than the true ones"
        parts.append(
            f"The normalised innovation squared per degree of freedom is {number('nis_per_dof', nis, f'{nis:.2f}')}: {verdict}."
        )
    return " ".join(parts) or "The result holds no uncertainty to judge."


def _not_used(contents: Contents) -> list[str]:
    outcome = contents.outcome
    observations = outcome.observations
    bins = observations.get("bins_rejected", {})
    why = ", ".join(
        f"{number(f'observations.bins_rejected.{name}', n, f'{n:,}')} {escape(name.replace('_', ' '))}"
        for name, n in bins.items()
    )
    rejected = observations["rejected"]
    if not observations["used"] + rejected:
        return ["The result holds no measurement."]
    verb = "measurement was" if rejected == 1 else "measurements were"
    first = (
        f"{number('observations.rejected', rejected, f'{rejected:,}')} {verb} rejected as a whole."
        + (
            f" Bins not used (a bin can have several reasons): {why}."
            if why
            else " Every bin of the others was used."
        )
    )
    rows = [
        f"{escape(row['topic'])}: {number(f'messages.{k}.skipped', row['skipped'], format(row['skipped'], ','))} of "
        f"{number(f'messages.{k}.read', row['read'], format(row['read'], ','))} messages; "
        + "; ".join(
            f"{number(f'messages.{k}.reasons.{n}.count', why['count'], format(why['count'], ','))} x {escape(why['reason'])}"
            for n, why in enumerate(row["reasons"])
        )
        for k, row in enumerate(outcome.messages or ())
        if row["skipped"]
    ]
    if outcome.messages is None:
        return [
            first,
            "The result does not hold the counts of messages: it is of an earlier version, or of a run that did not end.",
        ]
    return [first, items_html(rows) if rows else "Every message that was read was used."]


def _current_here(contents: Contents) -> str:
    """Return the current at the last position, by depth."""
    flow, track = contents.estimate, contents.track
    if flow is None or track.time_ns.size == 0:
        return ""
    found = flow.velocity_at(track.longitude[-1], track.latitude[-1], flow.levels)
    if not np.isfinite(found.u).any():
        return ""
    rows = []
    for depth, u, v, eu, ev in zip(
        flow.levels, found.u, found.v, found.u_standard_error, found.v_standard_error, strict=True
    ):
        if np.isfinite(u):
            error = f"{np.hypot(eu, ev) / np.sqrt(2.0):.3f}" if np.isfinite(eu) else "unknown"
            rows.append(
                [
                    f"{depth:g}",
                    f"{np.hypot(u, v):.3f}",
                    f"{float(heading_deg(u, v)):.0f}",
                    f"{u:+.3f}",
                    f"{v:+.3f}",
                    error,
                ]
            )
    heads = [
        "depth [m]",
        "speed [m/s]",
        "flows to [° true]",
        "eastward [m/s]",
        "northward [m/s]",
        "standard error [m/s]",
    ]
    return table_html(
        heads, rows, "The estimated current at the last position, at the end of the log"
    )
