"""The interface of every estimator: the static one, the one through time, and the baselines.

A state is an immutable value that only its own estimator reads. Everything that a replay, a dry run or a study asks of an estimator is a
member here; none of them needs to know which estimator it has.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.core.region import Region
from replay_kit.estimator.update.grouping import Grouping, ProfileGroup

State = TypeVar("State")


class Stepped(NamedTuple, Generic[State]):
    """The outcome of one measurement, or of several combined profiles.

    Attributes:
        event: The measurement or the group.
        before: The estimator's state before it.
        after: The estimator's state after it.
        innovation: To publish.
        against: Returns ``group_innovation`` of a state, where what it needs is there already; None where it is not.
    """

    event: Measurement | ProfileGroup
    before: State
    after: State
    innovation: Innovation
    against: Callable[[State], Array] | None = None


def each_stepped(
    state: State, measurements: Iterable[Measurement], steps: Iterable[tuple[State, Innovation]]
) -> Iterator[Stepped[State]]:
    """Yield the outcome of measurements, each alone.

    Args:
        state: Before them.
        measurements: In order.
        steps: The state after each, and its innovation.
    """
    for measurement, (after, innovation) in zip(measurements, steps, strict=True):
        yield Stepped(measurement, state, after, innovation)
        state = after


def require_estimator(value: object, what: str) -> "Estimator[Any]":
    """Return an estimator that comes from elsewhere.

    Args:
        value: The estimator.
        what: Where it comes from, for the error.

    Raises:
        ConfigError: It lacks what an estimator has.
    """
    needed = ("state_size", "initial", "step", "usable", "innovation", "flow", "predict", "steps")
    lacking = [name for name in needed if not hasattr(value, name)]
    if lacking:
        raise ConfigError(
            f"{what}: expected an Estimator, got {type(value).__name__} without {', '.join(lacking)}; derive it from "
            "replay_kit.estimator.Estimator"
        )
    estimator: Any = value
    return estimator  # type: ignore[no-any-return]


class Estimator(Protocol[State]):
    """An estimator whose state is an immutable value.

    Attributes:
        supports_path_means: Whether it assimilates means along a path; if not, it must be given profiles alone.
        block_size: Number of observations after which ``steps`` is most efficient; callers that buffer observations use it.
    """

    supports_path_means: ClassVar[bool] = False
    block_size: ClassVar[int] = 1

    @property
    def grouping(self) -> Grouping | None:
        """Which profiles are combined before they are given; None combines none."""
        return None

    @property
    def state_size(self) -> int:
        """Number of unknowns in a state."""
        ...

    @property
    def common_part(self) -> object | None:
        """The part that all states share, which ensemble and configuration give again: a checkpoint leaves it out. None without one."""
        return None

    def initial(self) -> State:
        """Return the state before any observation."""
        ...

    def predict(self, state: State, time_ns: int) -> State:
        """Return the state at a time [ns, UTC] without observations in between; unchanged for a static estimator or an earlier time."""
        return state

    def step(self, state: State, observation: Measurement) -> tuple[State, Innovation]:
        """Return the state after an observation, and its innovation with the observation's log-likelihood.

        An observation without a usable bin leaves the state unchanged.
        """
        ...

    def steps(
        self, state: State, observations: Iterable[Measurement]
    ) -> Iterator[tuple[State, Innovation]]:
        """Yield the state after each observation, and its innovation; an estimator may read ahead to be faster."""
        for observation in observations:
            state, innovation = self.step(state, observation)
            yield state, innovation

    def group_steps(
        self, state: State, items: Iterable[Measurement | ProfileGroup]
    ) -> Iterator[Stepped[State]]:
        """Yield the outcome of measurements and groups of profiles: several outcomes of a group where some of it is not used.

        An estimator without ``grouping`` is given none.
        """
        measurements = [item for item in items if not isinstance(item, ProfileGroup)]
        yield from each_stepped(state, measurements, self.steps(state, measurements))

    def usable(self, observation: Measurement) -> bool:
        """Return whether an observation has a bin that ``step`` would use."""
        ...

    def innovation(self, state: State, observation: Measurement) -> Array:
        """Return measured minus predicted, shape (n, 2) [m/s], local axes, without assimilation; NaN for bins that are not usable."""
        ...

    def group_innovation(self, state: State, group: ProfileGroup) -> Array:
        """Return the same of all bins of all profiles of a group, shape (n m, 2) [m/s]; 0 for bins that are not usable.

        An estimator without ``grouping`` takes each alone.
        """
        return np.concatenate(
            [np.nan_to_num(self.innovation(state, profile)) for profile in group.profiles]
        )

    def flow(self, state: State) -> FlowEstimate:
        """Return the current estimate of a state, at the state's time."""
        ...

    def of_vehicle(self, number: int, first: Region) -> Self:
        """Return the estimator of one of several vehicles with one state, with the window in which it begins [degrees]."""
        return self

    def window(self, state: State) -> Hashable:
        """Return what tells the vehicle's window from those of other vehicles; None where one window holds all."""
        return None

    def moved(self, state: State, measurement: Measurement | ProfileGroup) -> State:
        """Return the state with the vehicle where a measurement is, of which nothing is used."""
        return state

    def of_own(self, state: State) -> State:
        """Return a state without the windows of other vehicles."""
        return state

    def left_flows(self, state: State) -> Iterator[FlowEstimate]:
        """Yield the last estimates of windows that vehicles have left, in order; none where one window holds all."""
        return iter(())

    def without_left(self, state: State) -> State:
        """Return a state without the windows that vehicles have left, once their estimates were published."""
        return state

    def window_notes(self, state: State) -> list[str]:
        """Return notes on the windows, for the user; none where one holds all."""
        return []

    def weights(self, states: Sequence[State]) -> Sequence[Array | None]:
        """Return the mean weights of states, each of shape (Z r,), level after level; None where the basis is not the run's own."""
        return [None] * len(states)

    @property
    def basis_size(self) -> tuple[int | None, int | None]:
        """Number of modes (for each level, where levels have weights of their own) and of elements of the basis; None without a basis."""
        return None, None

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array | None:
        """Return a velocity minus the nearest flow that the estimator can represent; None when its flows have no fixed span.

        Args:
            points: shape (P, 2) [m], local east and north.
            depth: shape (P,) [m].
            velocity: shape (P, 2) [m/s], local axes.

        Returns:
            shape (P, 2) [m/s].
        """
        return None

    def notes(self) -> list[str]:
        """Return notes on how the prior was made, for the user."""
        return []

    def bias_notes(self, state: State) -> list[str]:
        """Return notes on what was estimated from the log, for the user: the prior's amplitude, systematic errors of the instrument."""
        return []

    def spread_record(self, state: State) -> dict[str, str]:
        """Return the amplitude of the prior's covariance in a state and the number of profiles it was fitted to; empty if not fitted."""
        return {}
