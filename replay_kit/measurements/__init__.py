"""Messages to observations: what a log says of the vehicle and of the water."""

from replay_kit.logs.tables.schemas import NOT_A_KIND
from replay_kit.logs.tables.suggest import suggestions
from replay_kit.measurements.events import Event, Skipped, Used
from replay_kit.measurements.interpret import (
    MAVLINK_NAMES,
    MeasurementState,
    events_of,
    finish,
    initial_state,
    interpret,
    interpret_block,
    observations,
)

__all__ = [
    "MAVLINK_NAMES",
    "NOT_A_KIND",
    "Event",
    "MeasurementState",
    "Skipped",
    "Used",
    "events_of",
    "finish",
    "initial_state",
    "interpret",
    "interpret_block",
    "observations",
    "suggestions",
]
