"""The one tree of errors that replay-kit raises for bad input.

Every message states what was expected, what was found, where, and what to do about it. ``exit_code`` is what the
command line returns for the error; 3 means that an input is unusable, 2 that an option or the configuration is wrong.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from replay_kit.core.finding import Finding


class ReplayKitError(Exception):
    """Root of every error that replay-kit raises on purpose.

    Attributes:
        findings: The contradictions in the inputs that led to it.
        answer: What ``--json`` says of the run that it ended.
    """

    exit_code = 1

    def __init__(self, message: str = "", findings: "Sequence[Finding]" = ()) -> None:
        super().__init__(message)
        self.findings = tuple(findings)
        self.answer: dict[str, Any] = {}


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
