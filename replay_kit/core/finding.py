"""A contradiction in the inputs: what was found, since when, on what evidence, and what a person can do."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from replay_kit.core.text import time_text

#: ``warning``: reported and nothing else. ``misfit``: the forecast, not the log, is in doubt; the run is complete and ends with 6.
#: ``inconsistent``: the run goes on without what is named and ends with 6. ``unusable``: the input cannot be used.
Severity = Literal["warning", "misfit", "inconsistent", "unusable"]


@dataclass(frozen=True, slots=True)
class Finding:
    """A contradiction.

    Attributes:
        name: What contradicts what, in a few words that are the same for all such findings.
        since_ns: Time of the message with which it was established [ns, UTC]; 0 when it holds for the whole run.
        evidence: The figures.
        cause: The likely cause.
        advice: What to check or set.
        severity: What follows.
        distrusts: Whether the instrument's profiles are not used: neither later ones nor those before.
    """

    name: str
    since_ns: int
    evidence: str
    cause: str
    advice: str
    severity: Severity = "inconsistent"
    distrusts: bool = False

    def __str__(self) -> str:
        """Return it as a sentence."""
        return finding_text(finding_json(self))


def finding_json(finding: Finding) -> dict[str, Any]:
    """Return a finding for JSON; a time that is not known is null."""
    return {
        "name": finding.name,
        "since": time_text(finding.since_ns) if finding.since_ns else None,
        "evidence": finding.evidence,
        "likely_cause": finding.cause,
        "set": finding.advice,
        "severity": finding.severity,
    }


def severity_word(severity: str) -> str:
    """Return what a finding of some severity is called."""
    return severity if severity in ("warning", "misfit") else "contradiction"


def finding_text(found: Mapping[str, Any]) -> str:
    """Return a finding, as ``finding_json`` has it, as a sentence."""
    since = f" (since {found['since']})" if found["since"] else ""
    return f"{found['name']}{since}: {found['evidence']}; likely cause: {found['likely_cause']}; {found['set']}"


def finding_line(found: Mapping[str, Any]) -> str:
    """Return a finding, as ``finding_json`` has it, as a line of an answer on the terminal."""
    return f"{severity_word(found['severity']).upper()}: {finding_text(found)}"
