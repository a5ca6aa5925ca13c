"""Observations of the vehicle and the current from messages of a log."""

from replay_kit.logs.tables.mapped import suggestions
from replay_kit.measurements.observed import observations

__all__ = ["observations", "suggestions"]
