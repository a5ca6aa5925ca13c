"""The publishing stage: what is published of each step, and when the depth slices are due."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from replay_kit.config.run import OutputConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import VehicleState
from replay_kit.workflows.replay.estimation import Step
from replay_kit.workflows.replay.outputs import DepthSlices, LeftWindow, Output, Weights


@dataclass(frozen=True, slots=True)
class PublishingState:
    """What the publishing stage remembers.

    Attributes:
        next_slices_ns: When the next depth slices are due [ns, UTC]; None before the first measurement.
        windows: Number of windows left by the vehicle whose last estimates were published.
        withdrawn: How many of these, the first ones, belong to an estimate that was rebuilt.
    """

    next_slices_ns: int | None = None
    windows: int = 0
    withdrawn: int = 0


def publish_step(
    state: PublishingState, step: Step, levels: Array, settings: OutputConfig, flow_at: Callable[[int], FlowEstimate]
) -> tuple[PublishingState, tuple[Output, ...]]:
    """Return the state after a step, and what is published of it.

    Args:
        state: Before the step.
        step: A position, or a measurement with its assimilation.
        levels: shape (Z,) [m], of the weights.
        settings: Interval and depths of the slices.
        flow_at: Returns the estimate after the step for a time [ns, UTC].
    """
    if isinstance(step.event, VehicleState) or step.assimilation is None:
        return state, (step.event,) if isinstance(step.event, VehicleState) else ()
    now_ns, (innovation, weights) = step.event.time_ns, (step.assimilation.innovation, step.assimilation.weights)
    outputs: list[Output] = [innovation]
    if innovation.accepted and weights is not None:
        outputs.append(Weights(now_ns, weights, levels))
    if state.next_slices_ns is None or now_ns >= state.next_slices_ns:
        state = replace(state, next_slices_ns=now_ns + int(settings.interval * 1e9))
        outputs.append(depth_slices(now_ns, flow_at(now_ns), settings))
    return state, tuple(outputs)


def publish_windows(state: PublishingState, flows: Iterator[FlowEstimate]) -> tuple[PublishingState, tuple[LeftWindow, ...]]:
    """Return the state after the last estimates of windows that the vehicle has left since, and these with their numbers."""
    left = tuple(LeftWindow(number, flow) for number, flow in enumerate(flows, state.windows + 1))
    return replace(state, windows=state.windows + len(left)), left


def withdraw_windows(state: PublishingState) -> PublishingState:
    """Return the state after the estimate was rebuilt: the windows published before it do not count."""
    return replace(state, withdrawn=state.windows)


def depth_slices(time_ns: int, flow: FlowEstimate, settings: OutputConfig) -> DepthSlices:
    """Return a flow with the depths at which it is published: those of the settings, or the first, middle and last level."""
    levels = flow.levels
    return DepthSlices(time_ns, flow, settings.depths or tuple(float(levels[i]) for i in sorted({0, levels.size // 2, levels.size - 1})))
