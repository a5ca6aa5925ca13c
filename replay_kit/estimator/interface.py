"""What a replay or an experiment needs of any estimator, whatever its state is made of."""

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, Observation

State = TypeVar("State")


class Estimator(Protocol[State]):
    """An estimator whose state is a frozen value that only it looks into."""

    def initial(self) -> State:
        """Return the state before any observation."""
        ...

    def step(self, state: State, observation: Observation) -> tuple[State, Innovation]:
        """Return the state after an observation, and what the observation said."""
        ...

    def steps(self, state: State, observations: Iterable[Observation]) -> Iterator[tuple[State, Innovation]]:
        """Yield the state after each observation, and what it said; an estimator may look ahead to be quicker."""
        for observation in observations:
            state, innovation = self.step(state, observation)
            yield state, innovation

    def misfit(self, state: State, observation: Observation) -> Array:
        """Return measured minus predicted by a state, shape (n, 2) [m/s], local axes; NaN for bins not usable."""
        ...

    def flow(self, state: State) -> FlowEstimate:
        """Return the current estimate that a state stands for."""
        ...
