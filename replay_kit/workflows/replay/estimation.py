"""The estimation stage: blocks of positions and measurements in, the estimate before and after each of them out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Innovation, Measurement, VehicleState
from replay_kit.estimator import Estimator
from replay_kit.workflows.replay.build import weights_of


@dataclass(frozen=True, slots=True, eq=False)
class EstimationState:
    """The estimate so far.

    Attributes:
        current: The estimator's state.
        dive_start: The estimator's state before the dive's first measurement.
        dive: Number of the dive.
    """

    # Any: each kind of estimator has a state of its own, which only it reads
    current: Any
    dive_start: Any
    dive: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Assimilation:
    """The assimilation of one measurement.

    Attributes:
        innovation: Measured minus predicted, and the decision.
        dive_innovation: shape (n, 2) [m/s], measured minus predicted from all dives before the measurement's own.
        weights: shape (r Z,), mean weights after the measurement; None for an estimator without weights of the run's basis.
    """

    innovation: Innovation
    dive_innovation: Array
    weights: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One event of the log, with the estimate before and after it.

    Attributes:
        event: A position or a measurement.
        before: The estimator's state before it.
        after: The estimator's state after it.
        assimilation: Of a measurement; None for a position.
    """

    event: VehicleState | Measurement
    before: Any
    after: Any
    assimilation: Assimilation | None = None


def assimilate(
    estimator: Estimator[Any], state: EstimationState, events: Sequence[VehicleState | Measurement]
) -> tuple[EstimationState, list[Step]]:
    """Return the state after a block of events, and a step for each of them.

    Args:
        estimator: Assimilates the measurements of the block together.
        state: Before the block.
        events: In the order of the log.
    """
    # Any: only an estimator that supports mean currents along paths is given some
    measurements: list[Any] = [event for event in events if isinstance(event, Measurement)]
    done = list(estimator.steps(state.current, measurements))
    results = iter(zip(done, weights_of(estimator, [after for after, _ in done]), strict=True))
    steps = []
    for event in events:
        before = state.current
        if isinstance(event, VehicleState):
            steps.append(Step(event, before, before))
            continue
        (after, innovation), weights = next(results)
        if event.dive != state.dive:
            state = EstimationState(before, before, event.dive)
        # Any: as above
        measurement: Any = event
        dive_innovation = estimator.misfit(state.dive_start, measurement)
        state = replace(state, current=after)
        steps.append(Step(event, before, after, Assimilation(innovation, dive_innovation, weights)))
    return state, steps
