"""The figures of an outcome as sentences, without the heavy libraries."""

from collections.abc import Iterator, Mapping, Sequence
from statistics import median
from typing import Any

from replay_kit.core.text import place_text


def plan_sentence(plan: Mapping[str, Any]) -> str:
    """Return a plan of an outcome as a sentence."""
    if plan["status"] == "failed" or plan.get("heading_deg") is None:
        return f"{plan['status']}: {plan['message']}"
    return (
        f"{plan['status']}: steer {plan['heading_deg']:.1f} degrees true at {plan['speed']:.2f} m/s through water, "
        f"{plan['glide_angle_deg']:.2f} degrees down; {plan['message']}"
    )


def outcomes_sentence(found: Mapping[str, Any]) -> str:
    """Return the errors of the surfacings that plans predicted, one at least, as a sentence."""
    share = found["inside_ellipse"]
    return (
        f"{found['count']} predicted by the plan before; median distance {found['distance_median_m']:.0f} m, "
        f"{found['delay_median_s'] / 60.0:+.0f} min"
        + ("" if share is None else f", {100.0 * share:.0f} % inside the 90 % ellipse")
    )


def surfacings_sentences(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield the figures of ``surfacings_json``, and the coming surfacing, as sentences."""
    yield from past_sentences(found)
    if (following := found["next"]) is not None:
        yield f"next, flown as the last dive: {place_of_next(following)}"


def past_sentences(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield the figures of ``surfacings_json`` of the dives so far as sentences."""
    count, figures, each = found["count"], found["later"] or found, found["each"]
    radius = median(one["radius_90_m"] for one in each)
    yield (
        f"{count} expected from {_from(each)}: {round(found['inside_50'] * count)} inside the 50 % ellipse, "
        f"{round(found['inside_90'] * count)} inside the 90 % one; median distance {found['distance_median_m']:.0f} m, "
        f"median radius of 90 % {radius:.0f} m{_beside(figures, each)}"
    )
    if early := [f"dive {one['dive']} ({_early(one)})" for one in each if one["earlier_dives"] < 2]:
        yield "of these " + ", ".join(early)


def place_of_next(following: Mapping[str, Any]) -> str:
    """Return the place of the coming surfacing of ``surfacings_json``, with its ellipse of 90 %."""
    (longitude, latitude), outer = following["expected"], following["ellipse_90"]
    return (
        f"{place_text(longitude, latitude)}, 90 % within {outer['major_m']:.0f} x {outer['minor_m']:.0f} m along "
        f"{outer['bearing_deg']:.0f} degrees{_calibration(following)}"
    )


def _calibration(following: Mapping[str, Any]) -> str:
    """Return by how many scored surfacings an ellipse is calibrated, in words; empty for results that do not say it."""
    if "scored" not in following:
        return ""
    scored = following["scored"]
    if "calibration" not in following:
        return f" (not calibrated: {scored} scored)"
    return f" (calibrated by {scored} scored surfacings: {following['calibration']:.2f} times as large)"


def _from(each: Sequence[Mapping[str, Any]]) -> str:
    """Return what surfacings were expected from, which is said of those without mean currents."""
    bases = {one.get("basis") for one in each}
    if "estimate" in bases:
        return "the displacements of the dives before each and the current of the estimate, without mean currents"
    return (
        "the displacements of the dives before each, without mean currents"
        if "displacements" in bases
        else "the dives before each"
    )


def _beside(figures: Mapping[str, Any], each: Sequence[Mapping[str, Any]]) -> str:
    gain, ratio = figures["log_score_gain"], figures["radius_ratio"]
    if gain is None or ratio is None:
        return ""
    kept = "velocity over ground" if any("basis" in one for one in each) else "current"
    return f"; beside the last dive's {kept} with its spread: radius {ratio:.2f} times as large, log score {gain:+.2f} a dive"


def _early(one: Mapping[str, Any]) -> str:
    before = "without an earlier one" if one["earlier_dives"] == 0 else "after a single one"
    return f"{before}: {'inside' if one['inside_90'] else 'outside'} its 90 % ellipse of {one['radius_90_m']:.0f} m"


def evidence_sentence(found: Mapping[str, Any]) -> str:
    """Return the figures of ``evidence_json`` as a sentence."""
    dives = len(found["by_dive"])
    a_dive = (
        f", {sum(each['log_evidence'] for each in found['by_dive']) / dives:.1f} a dive"
        if dives
        else ""
    )
    return f"{found['log_evidence']:.1f} of {found['measurements']} measurements, {found['per_measurement']:.2f} a measurement{a_dive}"


def referee_sentences(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for each forecast of ``referee_json`` that the run's was compared with."""
    unit, one = found["units"], found["units"].removesuffix("s")
    for other in found["against"]:
        names = found["ensemble"], other["ensemble"]
        if not other["compared"]:
            yield f"{names[0]} against {names[1]}: they have no {one} in common with the same measurements"
            continue
        low, high = other["interval_90"]
        about = (
            f"fewer than three {unit}, no interval"
            if low is None or low != low
            else f"90 % interval {low:+.2f} to {high:+.2f}"
        )
        better = {
            "first": f"{names[0]} explained the log better",
            "second": f"{names[1]} explained the log better",
        }
        verdict = better.get(other["better"], "the log does not tell which explained it better")
        left = (
            f"; {other['not_compared']} {unit} with unlike measurements left out"
            if other["not_compared"]
            else ""
        )
        yield (
            f"{names[0]} against {names[1]}: {verdict}; log evidence {other['gain_mean']:+.2f} a {one} over {other['compared']} {unit} "
            f"({about}){left}"
        )


#: The sources beside the vehicle's own profiles and mean currents.
SOURCES = {"shear": "geostrophic shear", "radar": "HF radar", "drifters": "drifters"}


def source_sentence(row: Mapping[str, Any]) -> str:
    """Return what a source of ``observations.sources`` gave, as a sentence."""
    rms = [
        "none" if row[f"rms_{name}"] is None else f"{100.0 * row[f'rms_{name}']:.1f}"
        for name in ("prior", "before", "after")
    ]
    nis = "none" if row["nis_per_dof"] is None else f"{row['nis_per_dof']:.2f}"
    return "; ".join(
        (
            f"{SOURCES[row['kind']]}: {row['used']} measurements used ({row['values']} values), {row['rejected']} rejected",
            f"RMS innovation {rms[0]} cm/s by the prior forecast, {rms[1]} before and {rms[2]} after each update; NIS per value {nis}",
            *row["doubts"],
        )
    )


def flight_correction_sentence(found: Mapping[str, Any]) -> str:
    """Return the figures of ``flight_correction_json`` as a sentence."""
    count = found["corrected"]
    along, across = (
        f"{100.0 * found[name]:.0f} ± {100.0 * found[f'{name}_std']:.0f} %"
        for name in ("along", "across")
    )
    return (
        f"{count} mean {'current was' if count == 1 else 'currents were'} corrected for the flight model's error, by "
        f"{100.0 * found['rms_m_s']:.1f} cm/s RMS, {100.0 * found['largest_m_s']:.1f} cm/s at most; from {found['dives']} dives this error "
        f"is {along} of the way through the water along it and {across} across it, with a log evidence of at least {found['evidence']:.1f} "
        "whichever dive is left out"
    )
