"""Messages to observations: what a log says of the vehicle and of the water."""

from replay_kit.logs.tables.suggest import suggestions
from replay_kit.measurements.observed import observations

__all__ = ["observations", "suggestions"]
