"""What the stages of a replay publish, as values, and how each is written."""

from dataclasses import dataclass

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Innovation, VehicleState
from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import Outcome
from replay_kit.results import ResultWriter


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Mean weights after a measurement.

    Attributes:
        time_ns: Time of the measurement [ns, UTC].
        weights: shape (r Z,), level after level.
        levels: shape (Z,) [m].
    """

    time_ns: int
    weights: Array
    levels: Array


@dataclass(frozen=True, slots=True, eq=False)
class DepthSlices:
    """A flow to be written at some depths, followed by a digest of the messages so far.

    Attributes:
        time_ns: [ns, UTC].
        flow: The flow.
        depths: [m].
    """

    time_ns: int
    flow: FlowEstimate
    depths: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PublishedPlan:
    """A plan.

    Attributes:
        plan: The plan.
        projection: The local frame of its track.
    """

    plan: Plan
    projection: Projection


@dataclass(frozen=True, slots=True, eq=False)
class LeftWindow:
    """The last estimate of a window that the vehicle has left.

    Attributes:
        number: Of the window, from 1.
        flow: The estimate.
    """

    number: int
    flow: FlowEstimate


@dataclass(frozen=True, slots=True)
class LogWarning:
    """A warning for ``/log``.

    Attributes:
        time_ns: [ns, UTC].
        text: The warning.
    """

    time_ns: int
    text: str


#: A position, what a measurement changed, a plan, how a plan turned out, a window's last estimate, or a warning.
Output = VehicleState | Innovation | Weights | DepthSlices | PublishedPlan | Outcome | LeftWindow | LogWarning


def write(writer: ResultWriter, output: Output) -> None:
    """Write an output to a result."""
    match output:
        case VehicleState():
            writer.fix(output)
        case Innovation():
            writer.innovation(output)
        case Weights(time_ns, weights, levels):
            writer.estimate(time_ns, weights, levels)
        case DepthSlices(time_ns, flow, depths):
            writer.grids(time_ns, flow, depths)
            writer.digest(time_ns)
        case PublishedPlan(plan, projection):
            writer.plan(plan, projection)
        case Outcome():
            writer.outcome(output)
        case LeftWindow(number, flow):
            writer.window(number, flow)
        case LogWarning(time_ns, text):
            writer.log(time_ns, "warning", text)
