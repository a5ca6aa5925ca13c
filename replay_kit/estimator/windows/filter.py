"""Estimator of windows that follow vehicles."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Measurement
from replay_kit.core.region import Region, centre_of, inside_box
from replay_kit.estimator.estimator import ReducedBasisEstimator
from replay_kit.estimator.interface import Estimator, Stepped
from replay_kit.estimator.state import State
from replay_kit.estimator.update.grouping import Grouping
from replay_kit.estimator.update.screening import columns_of
from replay_kit.estimator.windows.handover import hand_over
from replay_kit.estimator.windows.placing import WindowedState, next_window

# Measurements in a row outside the window after which a window is made about them: one may have a wrong position.
_STRAYS = 3


@dataclass(frozen=True, slots=True, eq=False)
class WindowedEstimator(Estimator[WindowedState]):
    """Estimates of windows; each begins with the information of its vehicle's previous window in their overlap.

    Vehicles near each other share a window. Each measurement is assimilated in all windows that contain it, once in each. Results refer to
    the vehicle's window. All windows have one local frame and the same levels.

    Attributes:
        first: First window of the vehicle [degrees].
        margin: Required distance of a vehicle from its window's sides [m].
        bounds: Box of the forecast [degrees].
        build: Returns the estimator of a window, with a cache of the latest.
        grouping: Rule for combining profiles; None for no groups.
        vehicle: Number of the vehicle of the measurements.
    """

    first: Region
    margin: float
    bounds: Region
    build: Callable[[Region], ReducedBasisEstimator]
    grouping: Grouping | None = None
    vehicle: int = 0

    supports_path_means = True
    block_size = ReducedBasisEstimator.block_size

    @property
    def unknowns(self) -> int:
        """Number of unknowns of the first window."""
        return self.build(self.first).unknowns

    def of_vehicle(self, number: int, first: Region) -> "WindowedEstimator":
        """Return the estimator of one of several vehicles, with its first window."""
        return replace(self, vehicle=number, first=first)

    def initial(self) -> WindowedState:
        """Return the state without a window; a vehicle's first one begins with its first measurement."""
        return WindowedState()

    def window(self, state: WindowedState) -> Region:
        """Return the vehicle's window; before its first measurement one that contains its start, or its first one."""
        held = state.where.get(self.vehicle)
        return held or state.holding(centre_of(self.first), self.bounds, 0.0) or self.first

    def _own(self, state: WindowedState) -> tuple[ReducedBasisEstimator, State]:
        """Return estimator and state of the vehicle's window, the prior if there is none yet."""
        estimator = self.build(region := self.window(state))
        return estimator, state.states.get(region) or estimator.initial()

    def assimilate(
        self, state: WindowedState, block: Sequence[Measurement]
    ) -> tuple[WindowedState, list[Stepped[WindowedState]]]:
        """Return the state after measurements, each in its window, and their outcomes."""
        found, waiting = list[Stepped[WindowedState]](), list[Measurement]()
        for item in block:
            if waiting and (len(waiting) == self.block_size or not self._stays(state, item)):
                state, steps = self._in_window(state, waiting)
                found, waiting = found + steps, []
            if not waiting:
                state = self.moved(state, item)
            waiting.append(item)
        if waiting:
            state, steps = self._in_window(state, waiting)
            found += steps
        return state, found

    def _in_window(
        self, state: WindowedState, block: Sequence[Measurement]
    ) -> tuple[WindowedState, list[Stepped[WindowedState]]]:
        """Return the state after measurements and groups in the vehicle's window, and their outcomes."""
        (estimator, state_of_window), window = self._own(state), self.window(state)
        found, states = list[Stepped[WindowedState]](), dict(state.states)
        for region, one in state.states.items() if self.vehicle not in state.strays else ():
            held = [item for item in block if inside_box(region, *_places(item)).all()]
            if region != window and held:
                states[region] = self.build(region).assimilate(one, held)[0]
        before = replace(state, states=states)
        for step in estimator.assimilate(state_of_window, block)[1]:
            after = replace(before, states={**states, window: step.after})
            found.append(Stepped(step.event, before, after, step.innovation))
            before = after
        return before, found

    def _stays(self, state: WindowedState, observation: Measurement) -> bool:
        """Return whether an observation leaves the vehicle in its window for certain."""
        region, place = self.window(state), _place(observation)
        stays = next_window(region, self.margin, self.bounds, place) is None
        return stays and self.vehicle not in state.strays and bool(inside_box(region, *place))

    def moved(self, state: WindowedState, measurement: Measurement) -> WindowedState:
        """Return the state with the vehicle in the window required by a measurement."""
        place, region = _place(measurement), self.window(state)
        if self.vehicle not in state.where:
            state = state.entered(self.vehicle, region, self._own(state)[1])
        strays, following = state.strays.get(self.vehicle, 0) + 1, None
        if inside_box(region, *place) or not inside_box(self.bounds, *place):
            strays = 0
        if strays in (0, _STRAYS):
            following = next_window(region, self.margin, self.bounds, place)
        other = following and state.holding(place, self.bounds, 0.5 * self.margin)
        if other is not None:
            return state.entered(self.vehicle, other, state.states[other])
        if following is None or following in state.unusable:
            return state.with_strays(self.vehicle, strays)
        try:
            begun, loss = hand_over(*self._own(state), self.build(following))
        except ForecastError as error:
            state = replace(state, unusable={**state.unusable, following: str(error)})
            return state.with_strays(self.vehicle, 0)
        state = state.entered(self.vehicle, following, begun)
        return replace(state, loss=max(state.loss, loss))

    def usable(self, observation: Measurement) -> bool:
        """Return whether an observation has a usable value, assuming water outside the first window, as windows are built on demand."""
        place, first = _place(observation), self.build(self.first)
        if inside_box(self.first, *place):
            return first.usable(observation)
        columns = columns_of(observation)
        in_reach = columns["depth"] <= first.grid.levels[-1]
        known = np.isfinite(columns["velocity"]).all(axis=2) & in_reach
        return bool(known.any() and inside_box(self.bounds, *place))

    def innovation(self, state: WindowedState, event: Measurement) -> Array:
        """Return measured minus predicted in the vehicle's window; see ``Estimator``."""
        estimator, state_of_window = self._own(state)
        return estimator.innovation(state_of_window, event)

    def flow(self, state: WindowedState) -> FlowEstimate:
        """Return the current estimate in the vehicle's window."""
        estimator, state_of_window = self._own(state)
        return estimator.flow(state_of_window)

    def left_flows(self, state: WindowedState) -> Iterator[FlowEstimate]:
        """Yield the last estimate of each window left; earlier ones are built from the forecast again."""
        for region, last in state.left:
            yield self.build(region).flow(last)

    def without_left(self, state: WindowedState) -> WindowedState:
        """Return a state without windows that vehicles have left, so that its size does not grow along tracks."""
        return replace(state, left=()) if state.left else state

    def own_window(self, state: WindowedState) -> WindowedState:
        """Return a state with the vehicle's window alone."""
        region = state.where.get(self.vehicle)
        if region is None or len(state.states) == 1:
            return state
        states = {region: state.states[region]}
        return replace(state, states=states, where={self.vehicle: region})

    def notes(self) -> list[str]:
        """Return the settings of the first window's prior."""
        return self.build(self.first).notes()

    def remarks(self, state: WindowedState) -> list[str]:
        """Return notes on the number of windows, the loss between them, and failed windows."""
        lost = f"up to {100.0 * state.loss:.1f} cm/s RMS of the information was not handed over"
        vehicles = "vehicles" if len(state.where) > 1 else "vehicle"
        followed = f"{state.number} windows followed the {vehicles}; {lost}"
        refused = (
            f"no window could be made at {at}: {reason}" for at, reason in state.unusable.items()
        )
        return [*([followed] if state.number > 1 else []), *refused]


def _place(observation: Measurement) -> tuple[float, float]:
    """Return longitude and latitude of an observation [degrees]; of a path its end."""
    longitude, latitude = _places(observation)
    return float(longitude[-1]), float(latitude[-1])


def _places(observation: Measurement) -> tuple[Array, Array]:
    """Return the longitudes and latitudes of an observation [degrees], shape (m,)."""
    return np.atleast_1d(observation.longitude), np.atleast_1d(observation.latitude)
