"""Messages to observations: what a log says of the vehicle and of the water."""

from replay_kit.measurements.events import NOT_A_KIND, Event, Skipped, Used
from replay_kit.measurements.interpret import (
    MAVLINK_NAMES,
    events_of,
    finish,
    initial_state,
    interpret,
    interpret_block,
    observations,
)
from replay_kit.measurements.messages.suggest import suggestions
from replay_kit.measurements.steps.state import MeasurementState

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
