"""The driver of a replay: it passes events through the stages and hands what they publish to the writer.

The stages (``estimation``, ``publishing``, ``plans``, ``statistics``) are functions of frozen states and know neither the writer nor the
clock. Their states together are what a checkpoint keeps.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Measurement, Observation, PathMean, VehicleState
from replay_kit.estimator import BLOCK, Estimator
from replay_kit.measurements import Event
from replay_kit.results import ResultWriter
from replay_kit.workflows.replay import plans
from replay_kit.workflows.replay.build import flow_at
from replay_kit.workflows.replay.estimation import EstimationState, assimilate
from replay_kit.workflows.replay.outputs import Output, write
from replay_kit.workflows.replay.plans import PlanningProblem, PlanningState
from replay_kit.workflows.replay.publishing import PublishingState, depth_slices, publish_step
from replay_kit.workflows.replay.statistics import RunStatistics
from replay_kit.workflows.replay.stopwatch import Stopwatch

# Events that wait at most: a log may hold positions and nothing else.
_BUFFERED = 4096


@dataclass(frozen=True, slots=True, eq=False)
class ReplayState:
    """The states of all stages between two blocks of observations.

    Attributes:
        estimation: Of the estimate.
        publishing: Of the depth slices.
        planning: Of the plans.
        statistics: What was counted.
        last_ns: Time of the last message [ns, UTC].
    """

    estimation: EstimationState
    publishing: PublishingState = field(default_factory=PublishingState)
    planning: PlanningState = field(default_factory=PlanningState)
    statistics: RunStatistics = field(default_factory=RunStatistics)
    last_ns: int = 0


class Session:
    """One replay as it runs.

    It is mutable as the only one of its parts: a stream of events goes through it, and a block of them waits in it, because the estimator
    assimilates a block of observations in little more time than one. A checkpoint is made only when none waits. Without a ``writer``
    nothing is published.
    """

    def __init__(
        self,
        estimator: Estimator[Any],
        levels: Array,
        config: RunConfig,
        problem: PlanningProblem | None = None,
        clock: Stopwatch | None = None,
    ) -> None:
        """Begin with the prior.

        Args:
            estimator: Assimilates.
            levels: shape (Z,) [m], of the weights.
            config: The run's settings.
            problem: What to plan; None plans nothing.
            clock: Wall time of each stage so far; None for a new one.
        """
        self.estimator = estimator
        self.config = config
        self.problem = problem
        self.writer: ResultWriter | None = None
        self.clock = clock or Stopwatch()
        self._levels = levels
        paths = (PathMean,) if getattr(estimator, "takes_paths", False) else ()
        self._inputs: tuple[type[VehicleState | Observation | PathMean], ...] = (VehicleState, Observation, *paths)
        self._buffer: list[VehicleState | Measurement] = []
        self._n_observations = 0
        prior = estimator.initial()
        self.restore(ReplayState(EstimationState(prior, prior)))

    @property
    def state(self) -> ReplayState | None:
        """The states of all stages; None while observations wait, for which there is no state yet."""
        if self._buffer:
            return None
        return ReplayState(self.estimation, self.publishing, self.planning, self.statistics, self.last_ns)

    def restore(self, state: ReplayState) -> None:
        """Continue from a state."""
        self.estimation, self.publishing, self.planning = state.estimation, state.publishing, state.planning
        self.statistics, self.last_ns = state.statistics, state.last_ns

    def take(self, events: Sequence[Event]) -> None:
        """Count the messages used and skipped, and assimilate positions and measurements as soon as a block of them is complete."""
        self.statistics = self.statistics.after_events(event for event in events if not isinstance(event, self._inputs))
        for event in events:
            if isinstance(event, self._inputs):
                self._buffer.append(event)
                self._n_observations += isinstance(event, Measurement)
                if self._n_observations == BLOCK or len(self._buffer) == _BUFFERED:
                    self.assimilate_buffer()

    def assimilate_buffer(self) -> None:
        """Assimilate the observations that wait, then publish everything in the order of the log."""
        with self.clock.stage("estimate"):
            self.estimation, steps = assimilate(self.estimator, self.estimation, self._buffer)
        self._buffer, self._n_observations = [], 0
        self.statistics = self.statistics.after_steps(steps)
        for step in steps:
            before, after = partial(flow_at, self.estimator, step.before), partial(flow_at, self.estimator, step.after)
            self._plan(plans.before_step, step, before)
            if self.writer is not None:
                self.publishing, outputs = publish_step(self.publishing, step, self._levels, self.config.output, after)
                self._write(outputs)
            self._plan(plans.after_step, step, after)

    def conclude(self) -> FlowEstimate:
        """Finish a surfacing, plan from the last position and publish the last depth slices; return the last estimate."""
        at = partial(flow_at, self.estimator, self.estimation.current)
        self._plan(plans.finish_surfacing, at)
        flow = at(self.last_ns)
        self._plan(plans.make_plan, flow, self.last_ns)
        self._write((depth_slices(self.last_ns, flow, self.config.output),))
        return flow

    def _plan(self, stage: Callable[..., tuple[PlanningState, tuple[Output, ...]]], *arguments: Any) -> None:
        """Make one step of the planning stage, if there is something to plan."""
        if self.problem is not None:
            with self.clock.stage("plan"):
                self.planning, outputs = stage(self.problem, self.planning, *arguments)
            self._write(outputs)

    def _write(self, outputs: Iterable[Output]) -> None:
        """Write outputs, if there is a result."""
        if self.writer is not None:
            for output in outputs:
                with self.clock.stage("write"):
                    write(self.writer, output)
