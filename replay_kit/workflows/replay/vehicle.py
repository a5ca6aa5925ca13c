"""A vehicle in a replay: its constant setup, and the states of all stages, kept in checkpoints."""

from dataclasses import dataclass, field, fields
from typing import Any, cast

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import replace
from replay_kit.core.as_flown import FlownDive
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import kind_of
from replay_kit.core.observation.table import MEAN, PING, POSITION, Block, Integers
from replay_kit.estimator import Estimator
from replay_kit.measurements.checks.profile import EnsembleSpeeds
from replay_kit.measurements.observed import Stream, path_mean
from replay_kit.workflows.replay.account import Account
from replay_kit.workflows.replay.consistency import MonitoringState, with_tracks
from replay_kit.workflows.replay.events import Aside, Events
from replay_kit.workflows.replay.inputs.forecast import flow_at
from replay_kit.workflows.replay.inputs.planner import VehiclePlanner
from replay_kit.workflows.replay.inputs.scan import VehicleLogs
from replay_kit.workflows.replay.plans import PlanningProblem, PlanningState
from replay_kit.workflows.replay.publishing import PublishingState
from replay_kit.workflows.replay.steps import Counts, Dive, Sums, counts_with
from replay_kit.workflows.replay.surfacings import FlightState, ForecastState


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Constant setup of a vehicle.

    Attributes:
        estimator: Estimator of its observations.
        config: Settings of the run.
        problem: Planning problem; None plans nothing.
        speeds: Speeds of the ensemble to compare the log with; None for no comparison.
        name: Name of one of several; empty for the only one.
        logs: Its logs; None for messages from elsewhere.
    """

    estimator: Estimator[Any]
    config: RunConfig
    problem: PlanningProblem | None = None
    speeds: EnsembleSpeeds | None = None
    name: str = ""
    logs: VehicleLogs | None = None


@dataclass(slots=True, eq=False)
class VehicleRun:
    """Vehicle of a running replay: its setup, and the states of all stages, which are replaced as it goes on.

    Attributes:
        setup: Its constant setup.
        stream: State of the measurements.
        dive: Present dive of the estimate.
        waiting: Events that wait for other vehicles, or for their group.
        due_ns: Due time of its last event [ns, UTC]; None before its first message.
        ended: Whether its logs have ended.
        publishing: State of publishing.
        planning: State of planning.
        counts: Counts of messages and observations.
        monitoring: State of the consistency checks.
        forecasts: State of the predicted surfacings.
        flight: State of the flight-model error.
        first_ns: Time of the first position or observation [ns, UTC]; None before it.
        flown: Flights of the dives so far, and the planning problem with their flight parameters; None before it is asked for.
    """

    setup: Setup
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
    flown: tuple[tuple[FlownDive, ...], PlanningProblem] | None = None

    @property
    def state(self) -> dict[str, Any]:
        """What changes with messages, by name, as kept in a checkpoint."""
        names = (one.name for one in fields(self) if one.name not in ("setup", "flown"))
        return {name: getattr(self, name) for name in names}

    @property
    def account(self) -> Account:
        """Account of the messages of its logs and of its observations so far."""
        logs = self.setup.logs
        assert logs is not None
        return Account(
            self.counts, [log.report() for log in logs.files], logs.merged, logs.files[0].input
        )

    @property
    def estimator(self) -> Estimator[Any]:
        """Its estimator, whose gate rejects neither of two contradicting sources."""
        # Any: those that have a gate are dataclasses
        found: Any = self.setup.estimator
        if self.monitoring.contradict and getattr(found, "probability", None) is not None:
            found = replace(found, probability=None)
        return cast(Estimator[Any], found)

    @property
    def problem(self) -> PlanningProblem | None:
        """Its planning problem with flight parameters as flown so far; None without a goal."""
        problem, dives = self.setup.problem, self.forecasts.dives
        if problem is None or not dives or not isinstance(problem.planner, VehiclePlanner):
            return problem
        if self.flown is None or self.flown[0] is not dives:
            # asked for at every event, and another one only after a dive
            flown = self.forecasts.as_flown
            if flown is not None:
                settings = problem.settings.resolved(flown.is_plausible)
                planner = problem.planner.as_flown(flown)
                problem = replace(problem, planner=planner, settings=settings)
            self.flown = dives, problem
        return self.flown[1]

    @property
    def notes(self) -> list[str]:
        """Note on a glide that is planned because nothing showed a glider."""
        problem, asked = self.problem, self.setup.config.planner.kind
        if problem is None or problem.settings.kind == "mission" or asked != "auto":
            return []
        return [
            "the plan is a single glide, as the log shows neither mean currents of dives nor dives at a glider's speed; for a glider ask "
            "for a mission (--planner mission)"
        ]

    def flow(self, state: Any, time_ns: int) -> FlowEstimate:
        """Return the estimate of a state for a time [ns, UTC], with the local correction from the dives so far."""
        flow, local = flow_at(self.estimator, state, time_ns), self.forecasts.local
        return flow if local is None else replace(flow, local=local)

    def admit(self, block: Block, rows: Integers) -> None:
        """Let events of a block wait for assimilation; DACs that are not assimilated still serve to predict surfacings.

        Args:
            block: Checked block.
            rows: shape (n, 3), rows of ``block.events``.
        """
        config, accepts = self.setup.config, self.setup.estimator.supports_path_means
        if config.consistency.on_failure != "ignore":
            self.monitoring = with_tracks(self.monitoring, block, rows)
        bias, left_out = config.measurements.flight_bias, self.monitoring.left_out
        kind, others, unused, means = rows[:, 1], list[Any](), list[str](), self.monitoring.means
        is_ping, keep, before = kind == PING, np.ones(len(rows), np.bool_), 0
        for k in np.flatnonzero(kind >= MEAN).tolist():
            is_mean, row = kind[k] == MEAN, int(rows[k, 2])
            event: Any = path_mean(block, row) if is_mean else block.linear[row]
            if is_mean:
                pings, before = rows[before:k][is_ping[before:k], 2], k
                flight = self.flight.with_profiles(block, pings)
                self.flight, event = flight.with_mean(event, bias)
                means += (event,)
            # profiles beside a mean current were computed from it
            beside = is_mean and event.beside_profiles
            fits = accepts and (bias or not beside)
            if not (fits or beside or left_out):
                unused.append(kind_of(event))
            if fits and not left_out:
                others.append(event)
            elif is_mean:
                others.append(Aside(event))
            else:
                keep[k] = False
        self.flight = self.flight.with_profiles(block, rows[before:][is_ping[before:], 2])
        self.monitoring = replace(self.monitoring, means=means)
        if left_out:
            keep &= ~is_ping
            self.counts = self.counts.plus(Sums(rejected=int(np.count_nonzero(kind != POSITION))))
        if unused:
            unsupported = counts_with(self.counts.unsupported, ((name, 1) for name in unused))
            self.counts = replace(self.counts, unsupported=unsupported)
        events = Events.of(replace(block, events=rows[keep]), others)
        self.waiting = self.waiting.followed_by(events, self.due_ns)
        if len(self.waiting):
            self.due_ns = int(self.waiting.due[-1])
        if len(events):
            first_ns = int(events.time.min())
            self.first_ns = first_ns if self.first_ns is None else min(first_ns, self.first_ns)
