"""Messages to observations: what a log says of the vehicle and of the water."""

from replay_kit.measurements.events import Skipped, Used
from replay_kit.measurements.interpret import (
    MAVLINK_NAMES,
    MeasurementState,
    finish,
    initial_state,
    interpret,
    observations,
)

__all__ = ["MAVLINK_NAMES", "MeasurementState", "Skipped", "Used", "finish", "initial_state", "interpret", "observations"]
