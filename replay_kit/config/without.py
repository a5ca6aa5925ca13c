"""What a run leaves out of its log, to see what would have been estimated without it."""

import re
from collections.abc import Sequence
from typing import Literal

Kind = Literal["dac", "drift", "profiles"]
_KINDS = ("dac", "drift", "profiles")
_EXPECTED = "expected dac, drift, profiles or dives:3-5"


def checked(rules: Sequence[str]) -> None:
    """Raise ValueError for a rule that is none, or is given twice."""
    for rule in rules:
        if rule in _KINDS:
            continue
        found = re.fullmatch(r"dives:(\d{1,9})(?:-(\d{1,9}))?", rule)
        if found is None:
            raise ValueError(f"{_EXPECTED}; '{rule}' is none of them")
        first, last = _dives(rule)
        if first < 1 or last < first:
            raise ValueError(
                f"{_EXPECTED}; in '{rule}' dives count from 1, the first before the last"
            )
    if repeated := sorted({rule for rule in rules if list(rules).count(rule) > 1}):
        raise ValueError(f"{_EXPECTED}, each once; '{repeated[0]}' is there twice")


def rules_for(rules: Sequence[str], kind: Kind, dive: int) -> tuple[str, ...]:
    """Return the rules that leave out a measurement of some kind and dive.

    Args:
        rules: As configured.
        kind: Of the measurement.
        dive: Its dive's number; 0 before the first dive, or without dives.
    """
    return tuple(
        rule
        for rule in rules
        if rule == kind or (rule not in _KINDS and _dives(rule)[0] <= dive <= _dives(rule)[1])
    )


def _dives(rule: str) -> tuple[int, int]:
    """Return the first and the last dive of a rule ``dives:FIRST-LAST``."""
    first, _, last = rule.partition(":")[2].partition("-")
    return int(first), int(last or first)
