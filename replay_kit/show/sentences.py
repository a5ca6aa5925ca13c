"""Sentences on the figures of an outcome, and the table of several vehicles with a common estimate."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from replay_kit.core.plan import Odds
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.numbers import Sentence, Shown, joined_sentences, sentence


def estimate_sentences(outcome: Outcome) -> Iterator[Sentence]:
    """Yield sentences on observations, innovations and the flight-model correction."""
    counts = outcome.observations
    rejected = ", ".join(f"{{bins_rejected.{name}}} {name}" for name in counts["bins_rejected"])
    means, sources = counts.get("mean_currents", 0), counts.get("sources", ())
    others = sum(row["used"] for row in sources)
    n = counts["used"] - means - others
    profiles = (
        f"{n} profiles used ({profile_bins(counts)} bins)"
        if means or others
        else "{used} profiles used ({bins_used} bins)"
    )
    currents = f"{{mean_currents}} mean {'current' if means == 1 else 'currents'} used"
    used = [
        *([profiles] if n or not means + others else []),
        *([currents] if means else []),
        "{rejected} rejected",
    ]
    yield sentence(
        f"Observations: {', '.join(used)}; bins not used: {rejected or 'none'}",
        counts,
        "observations.",
    )
    for k, row in enumerate(sources):
        yield joined_sentences("Also used: ", [source_sentence(row, f"observations.sources.{k}.")])
    if outcome.rms_innovation["prior"] is not None:
        yield sentence(
            "RMS innovation: {rms_innovation.before:cm} before each update, {rms_innovation.after:cm} after it, "
            "{rms_innovation.prior:cm} by the prior forecast; NIS per degree of freedom {nis_per_dof:.2f}",
            {"rms_innovation": outcome.rms_innovation, "nis_per_dof": outcome.nis_per_dof},
        )
    if outcome.flight_correction is not None:
        yield joined_sentences(
            "Flight model: ", [flight_correction_sentence(outcome.flight_correction)]
        )


def profile_bins(counts: Mapping[str, Any]) -> int:
    """Return the number of used profile bins, without other observations, which count as bins of two components."""
    values = sum(row["values"] for row in counts.get("sources", ()))
    # values of one component alone, as radials, are halves of a bin, which it counts as none
    return max(0, int(counts["bins_used"] - counts.get("mean_currents", 0) - values // 2))


def flown_sentences(outcome: Outcome) -> Iterator[Sentence]:
    """Yield sentences on errors of planned surfacings, and on the score against a truth."""
    if outcome.surfacings is not None:
        yield outcomes_sentence(outcome.surfacings)
    if outcome.truth is not None:
        yield from truth_sentences(outcome.truth)


def trust_sentences(outcome: Outcome) -> Iterator[Sentence]:
    """Yield sentences on log evidence, other forecasts and predicted surfacings."""
    if outcome.evidence is not None:
        yield evidence_sentence(outcome.evidence)
    if outcome.comparison is not None:
        yield from (
            joined_sentences("Comparison: ", [one])
            for one in comparison_sentences(outcome.comparison)
        )
    if outcome.predicted_surfacings is not None:
        yield surfacings_sentence(outcome.predicted_surfacings)


def odds_sentence(odds: Odds) -> Sentence:
    """Return a sentence on the odds of a plan."""
    form = "{reached:share} of {n_samples} simulated flights arrive"
    return sentence(form, asdict(odds), "plan.odds.")


def energy_sentence(energy: float, battery: float | None) -> Sentence:
    """Return a sentence on an energy [J], with its fraction of the battery [J] if stated."""
    fields, form = {"energy_j": energy, "battery_j": battery}, "{energy_j:kJ}"
    if battery is not None and battery > 0.0:
        more = ": more than the battery holds" if energy > battery else ""
        form += f", {100.0 * energy / battery:.1f} % of {{battery_j:MJ}}{more}"
    return sentence(form, fields, "plan.")


def outcomes_sentence(found: Mapping[str, Any]) -> Sentence:
    """Return a sentence on the errors of one or more surfacings predicted by plans."""
    share = (
        ""
        if found["inside_ellipse"] is None
        else ", {inside_ellipse:share} inside the 90 % ellipse"
    )
    return sentence(
        "Surfaced {distance_median_m:km} from the plan, {delay_median_s:min} (median of {count})"
        + share,
        found,
        "surfacings.",
    )


def truth_sentences(truth: Mapping[str, Any]) -> Iterator[Sentence]:
    """Yield sentences on errors against a known truth."""
    yield sentence(
        "Against the truth over {points} grid points: RMSE {rmse:cm} (relative error {rel_error:.3f}); ensemble mean "
        "{ensemble_mean_rmse:cm}",
        truth,
        "truth.",
    )


def surfacings_sentence(found: Mapping[str, Any]) -> Sentence:
    """Return a sentence on the errors of surfacings predicted from earlier dives."""
    at, figures = ("later.", found["later"]) if found["later"] else ("", found)
    sharper = ""
    if figures["log_score_gain"] is not None and figures["radius_ratio"] is not None:
        sharper = (
            f"; ellipses {{{at}radius_ratio:.2f}} times as large as with the last dive's current, "
            f"log score {{{at}log_score_gain:+.2f}} a dive"
        )
    return sentence(
        "Predicted surfacings: {inside_50:share} of {count} inside the 50 % ellipse, {inside_90:share} inside the 90 % ellipse; "
        f"median distance {{distance_median_m:.0f}} m, mean radius of 90 % {{radius_90_mean_m:.0f}} m{sharper}",
        found,
        "predicted_surfacings.",
    )


def by_habit(predicted: Mapping[str, Any] | None) -> bool:
    """Return whether persistence predicted surfacings better than plans, from ``surfacings_json``."""
    record = (predicted or {}).get("record") or {}
    return record.get("shown") == "habit" and bool(predicted and predicted["next"])


def evidence_sentence(found: Mapping[str, Any]) -> Sentence:
    """Return a sentence on ``evidence_json``."""
    each = [one["log_evidence"] for one in found["by_dive"]]
    a_dive = f", {sum(each) / len(each):.1f} a dive" if each else ""
    return sentence(
        "Log evidence: {log_evidence:.1f} of {measurements} measurements, {per_measurement:.2f} a measurement"
        + a_dive,
        found,
        "evidence.",
    )


def comparison_sentences(found: Mapping[str, Any]) -> Iterator[Sentence]:
    """Yield a sentence for each compared forecast of ``comparison_json``."""
    unit, one = found["units"], found["units"].removesuffix("s")
    for k, other in enumerate(found["against"]):
        at = f"against.{k}."
        names = f"{{ensemble}} against {{{at}ensemble}}: "
        if not other["compared"]:
            said = f"{names}they have no {one} in common with the same measurements"
        else:
            low = other["interval_90"][0]
            about = (
                f"fewer than three {unit}, no interval"
                if low is None or low != low
                else f"90 % interval {{{at}interval_90.0:+.2f}} to {{{at}interval_90.1:+.2f}}"
            )
            better = {
                "first": "{ensemble} explained the log better",
                "second": f"{{{at}ensemble}} explained the log better",
            }
            verdict = better.get(other["better"], "the difference is not significant")
            left = f"; {{{at}not_compared}} {unit} with unlike measurements left out"
            said = (
                f"{names}{verdict}; log evidence {{{at}gain_mean:+.2f}} a {one} over {{{at}compared}} {unit} "
                f"({about}){left if other['not_compared'] else ''}"
            )
        yield sentence(said, found, "comparison.")


#: The sources beside the vehicle's own profiles and mean currents.
SOURCES = {
    "shear": "geostrophic shear",
    "radar": "HF radar",
    "drifters": "drifters",
    "sensors": "other sensors",
}


def source_sentence(row: Mapping[str, Any], at: str = "") -> Sentence:
    """Return a sentence on a source of ``observations.sources``.

    Args:
        row: Record of the source.
        at: Path prefix of its fields, ending with a dot.
    """
    compared = (
        "RMS innovation {rms_prior:cm/s} cm/s by the prior forecast, {rms_before:cm/s} before and {rms_after:cm/s} after each update; "
        "NIS per value {nis_per_dof:.2f}"
    )
    said = (
        f"{SOURCES[row['kind']]}: {{used}} measurement{'s' * (row['used'] != 1)} used ({{values}} values), {{rejected}} rejected",
        *([compared] if row["rms_prior"] is not None else []),
        *(f"{{doubts.{k}}}" for k in range(len(row["doubts"]))),
    )
    return sentence("; ".join(said), row, at)


def flight_correction_sentence(found: Mapping[str, Any]) -> Sentence:
    """Return a sentence on ``flight_correction_json``."""
    along, across = (f"{{{name}:%}} ± {{{name}_std:%}} %" for name in ("along", "across"))
    return sentence(
        f"{{corrected}} mean {'current was' if found['corrected'] == 1 else 'currents were'} corrected for the flight model's error, by "
        f"{{rms_m_s:cm/s}} cm/s RMS, {{largest_m_s:cm/s}} cm/s at most; from {{dives}} dives this error "
        f"is {along} of the way through the water along it and {across} across it, with a log evidence of at least {{evidence:.1f}} "
        "whichever dive is left out",
        found,
        "flight_correction.",
    )


#: Headings of ``vehicle_rows``.
COLUMNS = ("vehicle", "used", "misfit before [cm/s]", "errors", "plan", "verdict")


def vehicle_rows(outcome: Outcome) -> list[tuple[str, ...]]:
    """Return the rows of ``vehicle_cells`` as text."""
    return [tuple(str(Sentence([cell])) for cell in row) for row in vehicle_cells(outcome)]


def vehicle_cells(outcome: Outcome) -> list[tuple[str | Shown, ...]]:
    """Return a row for each vehicle, including those without observations."""
    rows = [_row(name, of_vehicle) for name, of_vehicle in outcome.vehicles.items()]
    aside = [name for name in outcome.unused if name not in outcome.vehicles]
    return rows + [(name, "0", *[""] * (len(COLUMNS) - 3), "not used") for name in aside]


def _row(name: str, outcome: Outcome) -> tuple[str | Shown, ...]:
    counts, plan, word = outcome.observations, outcome.plan, outcome.verdict.word
    found = [one["name"] for one in outcome.consistency]
    path, used = f"vehicles.{name}", counts["used"]
    return (
        name,
        Shown(f"{path}.observations.used", used, f"{used:,}"),
        _cm(f"{path}.rms_innovation.before", outcome.rms_innovation["before"]),
        outcome.errors_text.removeprefix("errors "),
        "" if plan is None else plan["status"],
        f"{word}: {found[0]}" if found else word,
    )


def vehicle_sentences(outcome: Outcome) -> Iterator[str]:
    """Yield sentences on alarms and notes of each vehicle."""
    for name, of_vehicle in outcome.vehicles.items():
        yield from (f"ALARM: {name}: {alarm.text}" for alarm in of_vehicle.alarms)
        yield from (f"Note: {name}: {note}" for note in of_vehicle.notes)


def _cm(key: str, value: float | None) -> str | Shown:
    return "" if value is None else Shown(key, value, f"{100.0 * value:.2f}")
