"""The driver of a replay: it passes events through the stages and hands what they publish to the writer.

The stages (``estimation``, ``publishing``, ``plans``, ``statistics``) are functions of frozen states and know neither the writer nor the
clock. Their states together are what a checkpoint keeps.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from typing import Any

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import replace
from replay_kit.core.as_flown import FlownDive
from replay_kit.core.block import Block
from replay_kit.core.errors import Finding
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Measurement, PathMean, VehicleState
from replay_kit.core.progress import Stopwatch
from replay_kit.core.surfacing import DiveOutcome
from replay_kit.estimator import Estimator
from replay_kit.measurements.checks.profile import EnsembleSpeeds
from replay_kit.measurements.observed import rows
from replay_kit.results.mcap_writer import ResultWriter
from replay_kit.workflows.replay.inputs.estimator import flow_at
from replay_kit.workflows.replay.shared import Queued, SharedEstimate
from replay_kit.workflows.replay.stages import consistency, plans
from replay_kit.workflows.replay.stages.consistency import MonitoringState
from replay_kit.workflows.replay.stages.estimation import (
    EstimationState,
    Step,
    assimilate,
    inputs_of,
    kept,
)
from replay_kit.workflows.replay.stages.planner import VehiclePlanner
from replay_kit.workflows.replay.stages.plans import PlanningProblem, PlanningState
from replay_kit.workflows.replay.stages.publishing import (
    Output,
    PublishingState,
    depth_slices,
    publish_innovations,
    publish_step,
    publish_track,
    publish_windows,
    withdraw_windows,
)
from replay_kit.workflows.replay.statistics import RunStatistics
from replay_kit.workflows.replay.surfacings.flight_bias import FlightState, as_used
from replay_kit.workflows.replay.surfacings.forecasts import (
    ForecastState,
    forecast_end,
    forecast_mean,
    forecast_step,
    forecast_track,
)

# An event as it may be used, and what was found with it, each with whether two sources contradict each other since.
Given = tuple[VehicleState | Measurement, Sequence[tuple[Finding, bool]]]
# where a result is of one vehicle, its name begins nothing
_ONLY = nullcontext()


@dataclass(frozen=True, slots=True, eq=False)
class ReplayState:
    """The states of all stages between two blocks of observations.

    Attributes:
        estimation: Of the estimate.
        publishing: Of the depth slices.
        planning: Of the plans.
        statistics: What was counted.
        monitoring: Of the consistency checks.
        forecasts: Of the surfacings expected.
        flight: Of the flight model's error.
        last_ns: Time of the last message [ns, UTC].
        first_ns: Time of the first position or measurement [ns, UTC]; None before it.
        queued: What waits for the estimate; None where that is kept elsewhere.
    """

    estimation: EstimationState
    publishing: PublishingState = field(default_factory=PublishingState)
    planning: PlanningState = field(default_factory=PlanningState)
    statistics: RunStatistics = field(default_factory=RunStatistics)
    monitoring: MonitoringState = field(default_factory=MonitoringState)
    forecasts: ForecastState = field(default_factory=ForecastState)
    flight: FlightState = field(default_factory=FlightState)
    last_ns: int = 0
    first_ns: int | None = None
    queued: Queued | None = None


class Session:
    """One replay as it runs.

    It is mutable: a stream of events goes through it, and a block of them waits in the estimate that it gives them to, because the
    estimator assimilates a block of observations in little more time than one. Without a ``writer`` nothing is published.
    """

    def __init__(
        self,
        estimator: Estimator[Any],
        config: RunConfig,
        problem: PlanningProblem | None = None,
        speeds: EnsembleSpeeds | None = None,
        shared: SharedEstimate | None = None,
        name: str = "",
    ) -> None:
        """Begin with the prior.

        Args:
            estimator: Assimilates.
            config: The run's settings.
            problem: What to plan; None plans nothing.
            speeds: Of the ensemble, with which those of the log are compared; None compares none.
            shared: The estimate that is given the measurements, with the clock of its stages; None for one of its own.
            name: Of the vehicle, where it is one of several.
        """
        self.estimator = self.built = estimator
        self._speeds = speeds
        self.config = config
        self._problem = problem
        self._flown: tuple[tuple[FlownDive, ...], PlanningProblem | None] = ((), problem)
        self.writer: ResultWriter | None = None
        self._inputs = inputs_of(estimator)
        self.name = name
        self.shared = shared or SharedEstimate(Stopwatch())
        self.clock = self.shared.clock
        prior = estimator.initial()
        self.restore(ReplayState(EstimationState(prior, prior)))
        self._number = self.shared.add(self)

    @property
    def state(self) -> ReplayState:
        """The states of all stages, with the observations that wait for their block."""
        return self.state_with(self.shared.queued)

    def state_with(self, queued: Queued | None) -> ReplayState:
        """Return the states of all stages; where vehicles share the estimate, its queue is kept beside them, and None here."""
        return ReplayState(
            self.estimation,
            self.publishing,
            self.planning,
            self.statistics,
            self.monitoring,
            self.forecasts,
            self.flight,
            self.last_ns,
            self.first_ns,
            queued,
        )

    @property
    def vehicles(self) -> tuple["Session", ...]:
        """The sessions of the vehicles that share the estimate: this one."""
        return (self,)

    @property
    def problem(self) -> PlanningProblem | None:
        """What is planned, for a vehicle that flies as its dives so far; None where nothing is."""
        problem, dives = self._problem, self.forecasts.dives
        if problem is None or not dives or not isinstance(problem.planner, VehiclePlanner):
            return problem
        if self._flown[0] is not dives and (flown := self.forecasts.as_flown) is not None:
            # asked for at every event, and another one only after a dive
            self._flown = dives, replace(problem, planner=problem.planner.as_flown(flown))
        return self._flown[1]

    def restore(self, state: Any) -> None:
        """Continue from a ``ReplayState``."""
        self.estimation, self.publishing, self.planning = (
            state.estimation,
            state.publishing,
            state.planning,
        )
        self.statistics, self.monitoring, self.last_ns = (
            state.statistics,
            state.monitoring,
            state.last_ns,
        )
        self.forecasts, self.flight = state.forecasts, state.flight
        self.first_ns: int | None = state.first_ns
        self.estimator = consistency.trusting(self.built, self.monitoring)
        if state.queued is not None:
            self.shared.restore(state.queued)

    def take_block(self, block: Block) -> dict[int, list[Given]]:
        """Check what a block of messages measured, count these, and return the events by the place of their message in the stream."""
        with self.clock.stage("check"):
            self.monitoring, block, found = consistency.checked(
                self.monitoring, block, self.config, self._speeds
            )
        self.statistics = self.statistics.after_messages(block.counts())
        given: dict[int, list[Given]] = {}
        for k, (due, event) in enumerate(
            zip(block.events[:, 0].tolist(), rows(block), strict=True)
        ):
            given.setdefault(due, []).append((event, found.get(k, ())))
        return given

    def take_message(self, time_ns: int, given: Sequence[Given]) -> None:
        """Take the events of a message, as of ``take_block``."""
        self.last_ns = time_ns
        self.shared.begin(self._number, time_ns)
        for event, found in given:
            first_ns = event.time_ns if self.first_ns is None else self.first_ns
            self.first_ns = min(first_ns, event.time_ns)
            means = self.monitoring.means
            if any(contradict for _, contradict in found) and self.shared.has_others(self._number):
                self.monitoring, found = consistency.left_out(self.monitoring, found)
            self.monitoring = consistency.noted(self.monitoring, event, found, self.config)
            if found:
                self._act_on([finding for finding, _ in found], means, time_ns)
            if (
                isinstance(event, PathMean)
                and event.beside_profiles
                and not self.config.measurements.flight_bias
            ):
                self._expect(forecast_mean(self.forecasts, event))
            else:
                self._use(event)

    def _use(self, checked: VehicleState | Measurement) -> None:
        """Give an event that was checked to the estimate, or count it."""
        event = self._corrected(checked)
        if isinstance(event, Measurement) and self.monitoring.left_out:
            counts = self.statistics.profiles
            counts = replace(counts, rejected=counts.rejected + 1)
            self.statistics = RunStatistics(self.statistics.messages, counts)
        elif isinstance(event, self._inputs):
            self.shared.give(self._number, event)
            return
        # one beside profiles that were computed from it is no loss
        elif not (isinstance(event, PathMean) and event.beside_profiles):
            self.statistics = self.statistics.with_unsupported(event)
        if isinstance(event, PathMean):
            self._expect(forecast_mean(self.forecasts, event))

    def _corrected(self, event: VehicleState | Measurement) -> VehicleState | Measurement:
        """Return an event as the estimate is given it: of a mean current without the flight model's error, from which it can be rebuilt."""
        self.flight, used = as_used(self.flight, event, self.config.measurements)
        if isinstance(used, PathMean) and used is not event:
            self.monitoring = replace(self.monitoring, means=(*self.monitoring.means[:-1], used))
        return used

    def _act_on(self, found: Sequence[Finding], means: Sequence[PathMean], time_ns: int) -> None:
        """Rebuild the estimate without an instrument that is not believed, and open the gate between sources that contradict each other."""
        self.shared.assimilate(last=True)
        self.estimator = consistency.trusting(self.built, self.monitoring)
        if consistency.is_distrusted(found):
            kept = means if self.estimator.supports_path_means else ()
            self.shared.rebuild(self._number, kept)
            publishes = self.shared.vehicles[0]
            publishes.publishing = withdraw_windows(publishes.publishing)
        self.estimation, self.monitoring, counts = consistency.readmitted(
            self.estimator, self.estimation, self.monitoring, self.statistics.profiles
        )
        self.shared.spread(self.estimation.current)
        self.statistics = RunStatistics(self.statistics.messages, counts)
        named = self.monitoring.findings
        self._write(map(_warning, found))
        self._write((lambda writer: writer.consistency(time_ns, named),))

    def after_steps(self, steps: Sequence[Step]) -> None:
        """Count the steps of a block, and publish its innovations."""
        self.statistics = self.statistics.after_steps(steps)
        self.monitoring = consistency.with_gated(self.monitoring, steps)
        self._write(publish_innovations(steps))

    def count_again(self, steps: Sequence[Step]) -> None:
        """Count the steps of an estimate that was rebuilt."""
        counts = consistency.rebuilt(self.statistics.profiles, steps)
        self.statistics = RunStatistics(self.statistics.messages, counts)
        fresh = replace(self.monitoring, gated=(), decisions={})
        self.monitoring = consistency.with_gated(fresh, steps)

    def follow_up(self, steps: Sequence[Step]) -> None:
        """Publish steps, plan where a plan is due, and compare the dives that they end with what was expected."""
        for _, run in groupby(steps, lambda step: isinstance(step.event, VehicleState)):
            own = list(run)
            if not self._passed(own):
                for step in own:
                    self._follow_up(step)

    def _passed(self, steps: Sequence[Step]) -> bool:
        """Publish positions in a row from which nothing else follows, and return whether the steps were that."""
        track = [step.event for step in steps if isinstance(step.event, VehicleState)]
        if self._problem or self.shared.is_pooled or not track:
            return False
        depth = self.config.measurements.surface_depth
        if (after := forecast_track(self.forecasts, track, depth)) is None:
            return False
        self.forecasts = after
        if self.writer is not None:
            flow = partial(self._flow, steps[0].after)
            self.publishing, outputs = publish_track(self.publishing, track, flow)
            self._write(outputs)
        return True

    def _follow_up(self, step: Step) -> None:
        """Publish a step, and what follows from it."""
        before, after = partial(self._flow, step.before), partial(self._flow, step.after)
        self._plan(plans.before_step, step, before)
        if self.writer is not None:
            if pooled := self.shared.is_pooled:
                window = self.estimator.window(step.after)
                due_ns = self.shared.next_slices_ns.get(window)
                self.publishing = replace(self.publishing, next_slices_ns=due_ns)
            self.publishing, outputs = publish_step(
                self.publishing, step, self.config.output, after
            )
            if pooled:
                self.shared.next_slices_ns[window] = self.publishing.next_slices_ns
            self._write(outputs)
        self._expect(
            forecast_step(self.forecasts, step, before, self.config.measurements.surface_depth)
        )
        self._plan(plans.after_step, step, after)

    def after_block(self) -> None:
        """Publish the last estimates of the windows that vehicles have left, and forget them."""
        if self.writer is not None:
            self.publish_windows(
                map(self._dated, self.estimator.left_flows(self.estimation.current))
            )
        for vehicle in self.shared.vehicles:
            vehicle.estimation = kept(vehicle.estimator, vehicle.estimation)

    def publish_windows(self, flows: Iterator[FlowEstimate]) -> list[int]:
        """Publish the last estimates of windows; return their numbers."""
        before = self.publishing.windows
        self.publishing, windows = publish_windows(self.publishing, flows)
        self._write(windows)
        return list(range(before + 1, self.publishing.windows + 1))

    def conclude(self, about: Mapping[str, str]) -> FlowEstimate:
        """Finish a surfacing, plan from the last position and publish the last slices; return the last estimate, with its citation."""
        flow = self._dated(replace(self.end(), about=about))
        self.publish(flow, self.last_ns)
        return flow

    def end(self) -> FlowEstimate:
        """Finish a surfacing and plan from the last position; return the estimate that was planned on."""
        at = partial(self._flow, self.estimation.current)
        self._expect(forecast_end(self.forecasts))
        flow = at(self.last_ns)
        self._plan(plans.plan_at_end, at, flow, self.last_ns)
        return flow

    def publish(self, flow: FlowEstimate, time_ns: int) -> None:
        """Publish the last depth slices of an estimate for a time [ns, UTC]."""
        self._write((depth_slices(time_ns, flow, self.config.output),))

    def _flow(self, state: Any, time_ns: int) -> FlowEstimate:
        """Return the estimate of a state for a time [ns, UTC], with the current beside it as the dives so far show it."""
        flow, local = flow_at(self.estimator, state, time_ns), self.forecasts.local
        return flow if local is None else replace(flow, local=local)

    def flow_now(self) -> FlowEstimate:
        """Return the estimate at the time of the last message, with what waits for its block or group; that goes on waiting."""
        if not self.last_ns:
            return self.estimator.flow(self.estimation.current)
        waiting = [event for _, event in self.shared.queued.waiting]
        state, _ = assimilate(self.estimator, self.estimation, waiting)
        return self._dated(self._flow(state.current, self.last_ns))

    def _dated(self, flow: FlowEstimate) -> FlowEstimate:
        """Return an estimate with the span of its data, which ends at its time."""
        if self.first_ns is None or flow.time_ns is None:
            return flow
        return replace(flow, span_ns=(self.first_ns, max(self.first_ns, flow.time_ns)))

    def _plan(
        self, stage: Callable[..., tuple[PlanningState, tuple[Output, ...]]], *arguments: Any
    ) -> None:
        """Make one step of the planning stage, if there is something to plan."""
        if (problem := self.problem) is not None:
            with self.clock.stage("plan"):
                self.planning, outputs = stage(problem, self.planning, *arguments)
            self._write(outputs)

    def _expect(self, expected: tuple[ForecastState, tuple[DiveOutcome, ...]]) -> None:
        """Take up the state of the forecasts of surfacings, and write the outcomes of those that came."""
        self.forecasts, outcomes = expected
        if outcomes:
            self._write(map(_dive_outcome, outcomes))

    def _write(self, outputs: Iterable[Output]) -> None:
        """Write outputs, if there is a result."""
        if self.writer is not None:
            own = self.writer.of(self.name) if self.name else _ONLY
            with own, self.clock.stage("write"):
                for output in outputs:
                    output(self.writer)


def _warning(finding: Finding) -> Output:
    return lambda writer: writer.log(finding.since_ns, "warning", str(finding))


def _dive_outcome(outcome: DiveOutcome) -> Output:
    return lambda writer: writer.dive_outcome(outcome)
