"""The figures of expected surfacings as sentences, without the heavy libraries."""

from collections.abc import Iterator, Mapping, Sequence
from statistics import median
from typing import Any

from replay_kit.core.text import place_text


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
        f"{outer['bearing_deg']:.0f} degrees"
    )


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
