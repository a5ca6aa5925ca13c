"""The log evidence as sentences."""

from collections.abc import Iterator, Mapping
from typing import Any


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
