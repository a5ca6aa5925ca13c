"""State of a vehicle in a replay: its constant setup, and the states of all stages, kept in checkpoints."""

from dataclasses import dataclass, field
from typing import Any

from replay_kit.config.run import RunConfig
from replay_kit.estimator import Estimator
from replay_kit.measurements.checks.profile import EnsembleSpeeds
from replay_kit.measurements.observed import Stream
from replay_kit.workflows.replay.events import Events
from replay_kit.workflows.replay.stages.consistency import MonitoringState
from replay_kit.workflows.replay.stages.counts import Counts
from replay_kit.workflows.replay.stages.estimation import Dive
from replay_kit.workflows.replay.stages.plans import PlanningProblem, PlanningState
from replay_kit.workflows.replay.stages.publishing import PublishingState
from replay_kit.workflows.replay.surfacings.flight_bias import FlightState
from replay_kit.workflows.replay.surfacings.forecasts import ForecastState


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Constant setup of a vehicle.

    Attributes:
        estimator: Estimator of its observations.
        config: Settings of the run.
        problem: Planning problem; None plans nothing.
        speeds: Speeds of the ensemble to compare the log with; None for no comparison.
        name: Name of one of several; empty for the only one.
    """

    estimator: Estimator[Any]
    config: RunConfig
    problem: PlanningProblem | None = None
    speeds: EnsembleSpeeds | None = None
    name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class OfVehicle:
    """States of all stages of a vehicle.

    Attributes:
        stream: Of the measurements.
        dive: Present dive of the estimate.
        waiting: Events that wait for other vehicles, or for their group.
        due_ns: Due time of its last event [ns, UTC]; None before its first message.
        ended: Whether its logs have ended.
        publishing: Of publishing.
        planning: Of planning.
        counts: Counts of messages and observations.
        monitoring: Of the consistency checks.
        forecasts: Of the predicted surfacings.
        flight: Of the flight-model error.
        first_ns: Time of the first position or observation [ns, UTC]; None before it.
    """

    stream: Stream
    dive: Dive
    waiting: Events = field(default_factory=Events.none)
    due_ns: int | None = None
    ended: bool = False
    publishing: PublishingState = field(default_factory=PublishingState)
    planning: PlanningState = field(default_factory=PlanningState)
    counts: Counts = field(default_factory=Counts)
    monitoring: MonitoringState = field(default_factory=MonitoringState)
    forecasts: ForecastState = field(default_factory=ForecastState)
    flight: FlightState = field(default_factory=FlightState)
    first_ns: int | None = None
