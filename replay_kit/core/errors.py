"""The tree of errors that replay-kit raises for bad input, and findings: contradictions in the inputs.

Every message states what was expected, what was found, where, and what to do about it. ``exit_code`` is what the
command line returns for the error; 3 means that an input is unusable, 2 that an option or the configuration is wrong.
"""

from collections.abc import Mapping, Sequence
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


class ReplayKitError(Exception):
    """Root of every error that replay-kit raises on purpose.

    Attributes:
        findings: The contradictions in the inputs that led to it.
        answer: What ``--json`` says of the run that it ended.
    """

    exit_code = 1

    def __init__(self, message: str = "", findings: Sequence[Finding] = ()) -> None:
        super().__init__(message)
        self.findings = tuple(findings)
        self.answer: dict[str, Any] = {}

    def _render_traceback_(self) -> list[str]:
        """Return what a notebook shows of it: one line, as on the command line; ``%debug`` has the frames."""
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
