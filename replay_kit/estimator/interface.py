"""Interface of estimators: four functions of an immutable state, and optional ones."""

from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import Innovation, Measurement, usable
from replay_kit.core.region import Region
from replay_kit.estimator.update.grouping import Grouping
from replay_kit.estimator.update.screening import columns_of, screened

State = TypeVar("State")
_FUNCTIONS = ("initial", "predict", "assimilate", "flow")


class Stepped(NamedTuple, Generic[State]):
    """Outcome of one measurement or group.

    Attributes:
        event: Measurement or group.
        before: State before it.
        after: State after it.
        innovation: Innovation to publish.
        against: Returns measured minus predicted for an earlier state, as ``Estimator.innovation``; None if nothing is used.
    """

    event: Measurement
    before: State
    after: State
    innovation: Innovation
    against: Callable[[State], Array] | None = None


def require_estimator(value: object, what: str) -> "Estimator[Any]":
    """Return an external estimator after a check.

    Args:
        value: Estimator.
        what: Source of it in the error.

    Raises:
        ConfigError: It lacks one of the four functions.
    """
    lacking = [name for name in _FUNCTIONS if not hasattr(value, name)]
    if lacking:
        raise ConfigError(
            f"{what}: expected an Estimator, got {type(value).__name__} without {', '.join(lacking)}; derive it from "
            "replay_kit.estimator.Estimator"
        )
    estimator: Any = value
    return estimator  # type: ignore[no-any-return]


class Estimator(Protocol[State]):
    """Estimator with an immutable state that only it reads.

    A custom estimator needs ``initial``, ``assimilate`` and ``flow``, and ``predict`` for a changing current.

    Attributes:
        supports_path_means: Whether it assimilates all kinds of measurements; otherwise only profiles.
        block_size: Number of measurements that it assimilates at little more cost than one.
    """

    supports_path_means: ClassVar[bool] = False
    block_size: ClassVar[int] = 1

    def initial(self) -> State:
        """Return the state before any observation."""
        ...

    def predict(self, state: State, time_ns: int) -> State:
        """Return the state at a time [ns, UTC] without observations; unchanged for a constant current or an earlier time."""
        return state

    def assimilate(
        self, state: State, block: Sequence[Measurement]
    ) -> tuple[State, list[Stepped[State]]]:
        """Return the state after measurements, and the outcome of each; several for a partly used group.

        A measurement without a usable value leaves the state unchanged. Without ``grouping`` there are no groups.
        """
        ...

    def flow(self, state: State) -> FlowEstimate:
        """Return the current estimate of a state, at the state's time."""
        ...

    # ---- what may be known beside these

    @property
    def grouping(self) -> Grouping | None:
        """Rule for combining profiles; None for no groups."""
        return None

    @property
    def unknowns(self) -> int:
        """Number of unknowns in a state; 0 if unknown."""
        return 0

    def usable(self, observation: Measurement) -> bool:
        """Return whether a measurement has a usable value."""
        return bool(usable(columns_of(observation)["flags"]).any())

    def innovation(self, state: State, event: Measurement) -> Array:
        """Return measured minus predicted, shape (n, 2) [m/s], local axes; unusable values are NaN, or 0 in a group."""
        flow = self.flow(state)
        ((group,), _), projection = screened([event], flow.grid), flow.grid.projection
        value, axes = group.local(np.arange(len(group.flags)))
        if group.linear is None:
            names = "longitude", "latitude"
            places = to_local(projection, *(group.columns[name][:, None] for name in names))
            predicted = flow.velocity(*places, group.columns["depth"])
        else:
            places = to_local(projection, group.linear.longitude, group.linear.latitude)
            predicted = group.linear.at_values(flow.velocity(*places, group.linear.depth))
        off = (value - predicted @ axes.T) @ axes
        off[~group.used] = 0.0 if len(off) > 1 else np.nan
        return np.asarray(off.reshape(-1, 2))

    def notes(self) -> list[str]:
        """Return notes on the prior for the user."""
        return []

    def remarks(self, state: State) -> list[str]:
        """Return notes on further estimated quantities for the user."""
        return []

    # ---- windows that follow vehicles

    def of_vehicle(self, number: int, first: Region) -> Self:
        """Return the estimator of one of several vehicles with a common state, with its first window [degrees]."""
        return self

    def window(self, state: State) -> Hashable:
        """Return the key of the vehicle's window; None for a single window."""
        return None

    def own_window(self, state: State) -> State:
        """Return a state without the windows of other vehicles."""
        return state

    def left_flows(self, state: State) -> Iterator[FlowEstimate]:
        """Yield the last estimates of windows left by vehicles, in order; empty for a single window."""
        return iter(())

    def without_left(self, state: State) -> State:
        """Return a state without windows left by vehicles, after their estimates were published."""
        return state
