"""Errors that replay-kit raises for bad input, and findings of inconsistent inputs.

Every message states what was expected, what was found, where, and what to do. ``exit_code`` is the exit code of the command line: 3 for an
unusable input, 2 for a wrong option or configuration.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from replay_kit.core.words.text import time_text

#: ``warning``: reported and nothing else. ``misfit``: the forecast, not the log, is in doubt; the run is complete and ends with 6.
#: ``inconsistent``: the run goes on without what is named and ends with 6. ``unusable``: the input cannot be used.
Severity = Literal["warning", "misfit", "inconsistent", "unusable"]


class Caveat(str):
    """Note that is a reason against the verdict ``trust``, as on a forecast of another place or time."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class Finding:
    """A failed check: two inputs that contradict each other.

    Attributes:
        name: Name of the check, equal for all such findings.
        since_ns: Time of the message that established it [ns, UTC]; 0 if it holds for the whole run.
        evidence: Figures that show it.
        cause: Likely cause.
        advice: What to check or set.
        severity: Consequence.
        distrusts: Whether all profiles of the instrument are excluded, earlier ones too.
    """

    name: str
    since_ns: int
    evidence: str
    cause: str
    advice: str
    severity: Severity = "inconsistent"
    distrusts: bool = False

    def __str__(self) -> str:
        """Return the finding as a sentence."""
        return finding_text(finding_json(self))


def finding_json(finding: Finding) -> dict[str, Any]:
    """Return a finding for JSON; an unknown time is null."""
    return {
        "name": finding.name,
        "since": time_text(finding.since_ns) if finding.since_ns else None,
        "evidence": finding.evidence,
        "likely_cause": finding.cause,
        "set": finding.advice,
        "severity": finding.severity,
    }


def severity_word(severity: str) -> str:
    """Return the word for a severity."""
    return severity if severity in ("warning", "misfit") else "contradiction"


def finding_text(found: Mapping[str, Any], evidence: bool = True) -> str:
    """Return a finding as a sentence.

    Args:
        found: Finding in the form of ``finding_json``.
        evidence: Whether the sentence includes the evidence.
    """
    since = f" (since {found['since']})" if found["since"] else ""
    why = f"{found['evidence']}; " if evidence else ""
    return f"{found['name']}{since}: {why}likely cause: {found['likely_cause']}; {found['set']}"


def finding_line(found: Mapping[str, Any], evidence: bool = True) -> str:
    """Return a finding as a line on the terminal; the arguments are those of ``finding_text``."""
    return f"{severity_word(found['severity']).upper()}: {finding_text(found, evidence)}"


class ReplayKitError(Exception):
    """Root of every error that replay-kit raises on purpose.

    Attributes:
        findings: Findings that led to it.
        answer: Output of ``--json`` for the run that it ended.
    """

    exit_code = 1

    def __init__(self, message: str = "", findings: Sequence[Finding] = ()) -> None:
        super().__init__(message)
        self.findings = tuple(findings)
        self.answer: dict[str, Any] = {}

    def _render_traceback_(self) -> list[str]:
        """Return the error's line in a notebook, as on the command line; ``%debug`` has the traceback."""
        return [f"{type(self).__name__}: {self}"]


class ConfigError(ReplayKitError):
    """A bad option, configuration file or configuration key."""

    exit_code = 2


class LogError(ReplayKitError):
    """A log that cannot be opened or used at all."""

    exit_code = 3


class MeasurementError(ReplayKitError):
    """A log without a usable measurement of the current."""

    exit_code = 3


class ForecastError(ReplayKitError):
    """An ensemble or truth file that cannot be used."""

    exit_code = 3


class EstimatorError(ReplayKitError):
    """An estimate that cannot be computed from valid inputs."""


class PlanError(ReplayKitError):
    """A planning problem that is ill-posed: a start or goal outside the region or on land."""

    exit_code = 3
