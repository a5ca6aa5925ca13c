"""What a replay knows of its vehicles: what stays the same, and the states of all stages, which a checkpoint keeps."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

from replay_kit.config.run import RunConfig
from replay_kit.estimator import Estimator
from replay_kit.measurements.checks.profile import EnsembleSpeeds
from replay_kit.measurements.observed import Stream
from replay_kit.workflows.replay.events import Events
from replay_kit.workflows.replay.stages.consistency import MonitoringState
from replay_kit.workflows.replay.stages.counts import Counts
from replay_kit.workflows.replay.stages.estimation import Dive, Given
from replay_kit.workflows.replay.stages.plans import PlanningProblem, PlanningState
from replay_kit.workflows.replay.stages.publishing import PublishingState
from replay_kit.workflows.replay.surfacings.flight_bias import FlightState
from replay_kit.workflows.replay.surfacings.forecasts import ForecastState


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What of a vehicle stays the same.

    Attributes:
        estimator: Assimilates what it measures.
        config: The run's settings.
        problem: What to plan; None plans nothing.
        speeds: Of the ensemble, with which those of the log are compared; None compares none.
        name: Where it is one of several; empty for the only one.
    """

    estimator: Estimator[Any]
    config: RunConfig
    problem: PlanningProblem | None = None
    speeds: EnsembleSpeeds | None = None
    name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class OfVehicle:
    """The states of all stages of a vehicle.

    Attributes:
        stream: Of the measurements.
        dive: Of the estimate.
        waiting: Its events that wait for those of others, or for the next of their group.
        due_ns: When its last event was due [ns, UTC]; None before its first message.
        ended: Whether its logs have ended.
        publishing: Of what is published.
        planning: Of the plans.
        counts: Of messages and measurements.
        monitoring: Of the consistency checks.
        forecasts: Of the surfacings expected.
        flight: Of the flight model's error.
        first_ns: Time of the first position or measurement [ns, UTC]; None before it.
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


@dataclass(frozen=True, slots=True, eq=False)
class RunState:
    """What a checkpoint keeps.

    Attributes:
        current: The estimator's state.
        vehicles: Of each vehicle.
        waiting: Events that wait until there are enough to be assimilated together.
        kept: Measurements of several vehicles so far, in order; none of one.
        next_slices_ns: Of each window, when its next depth slices are due [ns, UTC].
        messages: Number of messages taken.
        last_ns: Time of the last one [ns, UTC].
    """

    current: Any
    vehicles: tuple[OfVehicle, ...]
    waiting: tuple[Given, ...] = ()
    kept: tuple[Given, ...] = ()
    next_slices_ns: Mapping[Hashable, int | None] = field(default_factory=dict)
    messages: int = 0
    last_ns: int = 0
