"""What the stages of a replay publish, as values, and how each is written."""

from dataclasses import dataclass

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Innovation, VehicleState
from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import DiveOutcome, Outcome
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
class VehiclePose:
    """Where the vehicle is in the local frame.

    Attributes:
        time_ns: [ns, UTC].
        place: Local east, local north and depth [m].
        heading: Of its way, clockwise from local north [rad].
    """

    time_ns: int
    place: tuple[float, float, float]
    heading: float


@dataclass(frozen=True, slots=True)
class AtVehicle:
    """The estimate at the vehicle.

    Attributes:
        time_ns: [ns, UTC].
        place: Longitude, latitude [degrees] and depth [m].
        velocity: Towards true east and true north [m/s].
        error: Standard errors of both [m/s]; NaN where unknown.
    """

    time_ns: int
    place: tuple[float, float, float]
    velocity: tuple[float, float]
    error: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Findings:
    """All contradictions so far, at a time [ns, UTC]."""

    time_ns: int
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True)
class LogWarning:
    """A warning for ``/log``.

    Attributes:
        time_ns: [ns, UTC].
        text: The warning.
    """

    time_ns: int
    text: str


#: A position, what a measurement changed, a plan, how a plan or an expected surfacing turned out, a window's last estimate,
#: contradictions, or a warning.
Output = (
    VehicleState
    | VehiclePose
    | Innovation
    | Weights
    | AtVehicle
    | DepthSlices
    | PublishedPlan
    | Outcome
    | DiveOutcome
    | LeftWindow
    | Findings
    | LogWarning
)


def write(writer: ResultWriter, output: Output) -> None:
    """Write an output to a result."""
    match output:
        case VehicleState():
            writer.fix(output)
        case VehiclePose(time_ns, place, heading):
            writer.vehicle(time_ns, place, heading)
        case AtVehicle(time_ns, place, velocity, error):
            writer.at_vehicle(time_ns, place, velocity, error)
        case Findings(time_ns, findings):
            writer.consistency(time_ns, findings)
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
        case DiveOutcome():
            writer.dive_outcome(output)
        case LeftWindow(number, flow):
            writer.window(number, flow)
        case LogWarning(time_ns, text):
            writer.log(time_ns, "warning", text)
