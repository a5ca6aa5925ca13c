"""The verdict with which a summary opens: what was used, whether the inputs agree, what the estimate gained, how far to trust it."""

import math
from collections.abc import Sequence

from replay_kit.core.errors import Finding, severity_word

# Normalised innovations squared per degree of freedom between which stated errors are taken for right.
LEAST_NIS, MOST_NIS = 0.5, 2.0


def verdict(
    profiles: tuple[int, int],
    lost_pings: str,
    findings: Sequence[Finding],
    rms: tuple[float, float, float],
    trust: tuple[float, Sequence[str]],
) -> tuple[str, ...]:
    """Return the verdict on a replay, in four parts of which the last may be several sentences.

    Args:
        profiles: Number of observations used and rejected.
        lost_pings: Which pings a setting would keep; empty when they are few.
        findings: Contradictions in the inputs.
        rms: RMS component of measured minus estimated before and after each update, and against the ensemble alone [m/s].
        trust: Mean normalised innovation squared per degree of freedom, and what the measurements cannot tell.
    """
    return (_usage(*profiles, lost_pings), _consistency(findings), _gain(*rms), *_trust(*trust))


def _usage(used: int, rejected: int, lost_pings: str) -> str:
    share = f"{used} of {used + rejected} observations used"
    return f"{share}; {lost_pings}" if lost_pings else share


def _consistency(findings: Sequence[Finding]) -> str:
    """Return whether the log contradicts itself, and then whether log and forecast fit, as one sentence."""
    named = dict.fromkeys(
        finding.name for finding in findings if severity_word(finding.severity) == "contradiction"
    )
    others = [
        f"{finding.name}: {finding.evidence}" for finding in findings if finding.name not in named
    ]
    if not named:
        return (
            f"the log does not contradict itself, but {'; '.join(others)}"
            if others
            else "no contradiction found"
        )
    return "; ".join(
        (f"{len(named)} contradiction{'s' * (len(named) > 1)}: {', '.join(named)}", *others)
    )


def _gain(before: float, after: float, prior: float) -> str:
    if not math.isfinite(prior):
        return "no observation changed the estimate: it is the ensemble's"
    words = " -> ".join(f"{100.0 * value:.1f}" for value in (prior, before, after))
    return f"RMS difference to the measurements {words} cm/s (ensemble alone, before and after each update)"


def _trust(nis: float, doubts: Sequence[str]) -> tuple[str, ...]:
    words = []
    if nis > MOST_NIS:
        words.append(
            f"errors are larger than stated (NIS {nis:.2f} per degree of freedom, 1 expected)"
        )
    elif nis < LEAST_NIS:
        words.append(
            f"errors are smaller than stated (NIS {nis:.2f} per degree of freedom, 1 expected)"
        )
    elif math.isfinite(nis):
        words.append(f"stated errors fit (NIS {nis:.2f} per degree of freedom)")
    return (*words, *doubts)
