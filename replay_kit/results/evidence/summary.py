"""The log evidence of a log under its forecast, and under others that it is compared with, as JSON."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from replay_kit.core.evidence import BlockEvidence, Evidence, compare


@dataclass(frozen=True, slots=True)
class Rival:
    """Another forecast that explained the same log.

    Attributes:
        name: Of its file.
        evidence: Of the log under it.
    """

    name: str
    evidence: Evidence


def evidence_json(evidence: Evidence) -> dict[str, Any]:
    """Return the log evidence of a log, with at least one value, for JSON."""
    by_dive = [{"dive": dive, **_figures(block)} for dive, block in evidence.by_dive.items()]
    return {**_figures(evidence.total), "by_dive": by_dive}


def referee_json(name: str, evidence: Evidence, rivals: Sequence[Rival]) -> dict[str, Any]:
    """Return how forecasts explained a log, the first against each other, for JSON.

    Args:
        name: Of the first forecast's file.
        evidence: Of the log under it.
        rivals: The others, one at least.
    """
    units = "dives" if evidence.by_dive else "hours"
    return {
        "ensemble": name,
        "units": units,
        "against": [_against(evidence, rival) for rival in rivals],
    }


def _against(evidence: Evidence, rival: Rival) -> dict[str, Any]:
    found = compare(evidence, rival.evidence)
    return {
        "ensemble": rival.name,
        "compared": found.blocks,
        "not_compared": found.skipped,
        "gain": found.gain,
        "gain_mean": found.mean,
        "interval_90": list(found.interval),
        "better": found.verdict,
        **{f"other_{key}": value for key, value in _figures(rival.evidence.total).items()},
    }


def _figures(block: BlockEvidence) -> dict[str, Any]:
    measured = block.measurements
    return {
        "log_evidence": block.log_evidence,
        "values": block.values,
        "measurements": measured,
        "per_measurement": block.log_evidence / measured if measured else math.nan,
    }
