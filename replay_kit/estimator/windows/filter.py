"""An estimator of windows that follow vehicles."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Measurement
from replay_kit.core.region import Region, centre, inside
from replay_kit.estimator.estimator import ReducedBasisEstimator
from replay_kit.estimator.interface import Estimator, Stepped
from replay_kit.estimator.state import State
from replay_kit.estimator.update.grouping import Grouping, ProfileGroup
from replay_kit.estimator.windows.handover import hand_over
from replay_kit.estimator.windows.placing import Window, WindowedState, next_window

# Measurements in a row outside the window after which a window is made about them: one may have a wrong position.
_STRAYS = 3


@dataclass(frozen=True, slots=True, eq=False)
class WindowedEstimator(Estimator[WindowedState]):
    """Constant estimates of windows; each begins with the information of the one that its vehicle was in before, where they overlap.

    Vehicles near each other are in one window, and each measurement is given to all windows that hold it, as if each were alone. So
    nothing counts twice in any. What is asked of a state is answered from the vehicle's window. All windows have one local frame, and the
    same levels.

    Attributes:
        first: The vehicle's first window [degrees].
        margin: Distance from a vehicle to its window's sides that an estimate needs [m].
        bounds: The forecast's box [degrees].
        build: Returns the estimator of a window; the same window gives the same estimator, and the latest are kept.
        probability: That sound measurements exceed the gate; None accepts all with their stated errors.
        grouping: Which profiles are combined; None combines none.
        vehicle: Number of the vehicle whose measurements it is given.
    """

    first: Region
    margin: float
    bounds: Region
    build: Callable[[Region], ReducedBasisEstimator]
    probability: float | None = None
    grouping: Grouping | None = None
    vehicle: int = 0

    supports_path_means = True
    block_size = ReducedBasisEstimator.block_size

    @property
    def unknowns(self) -> int:
        """Number of unknowns of the first window."""
        return self._of(self.first).unknowns

    def _of(self, region: Region) -> ReducedBasisEstimator:
        return replace(self.build(region), probability=self.probability, grouping=self.grouping)

    def of_vehicle(self, number: int, first: Region) -> "WindowedEstimator":
        """Return the estimator of one of several vehicles, with its first window."""
        return replace(self, vehicle=number, first=first)

    def initial(self) -> WindowedState:
        """Return the state without a window: a vehicle's first one begins with its first measurement."""
        return WindowedState()

    def _window(self, state: WindowedState) -> Window:
        """Return the vehicle's window: before its first measurement the one that holds where it begins, or the prior of its first one."""
        return self._held(state) or Window(self.first, self._of(self.first).initial())

    def _own(self, state: WindowedState) -> tuple[ReducedBasisEstimator, State]:
        """Return the estimator of the vehicle's window, and its state."""
        own = self._window(state)
        return self._of(own.region), own.state

    def _held(self, state: WindowedState) -> Window | None:
        return state.of(self.vehicle) or state.holding(centre(self.first), self.bounds, 0.0)

    def window(self, state: WindowedState) -> Region:
        """Return the vehicle's window."""
        held = self._held(state)
        return self.first if held is None else held.region

    def assimilate(
        self, state: WindowedState, block: Sequence[Measurement | ProfileGroup]
    ) -> tuple[WindowedState, list[Stepped[WindowedState]]]:
        """Return the state after measurements, each in the window that it lies in, and the outcome of each."""
        found, waiting = list[Stepped[WindowedState]](), list[Measurement | ProfileGroup]()
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
        self, state: WindowedState, block: Sequence[Measurement | ProfileGroup]
    ) -> tuple[WindowedState, list[Stepped[WindowedState]]]:
        """Return the state after measurements and groups in the vehicle's window, and their outcomes."""
        if self.vehicle not in state.strays:
            others = tuple(self._beside(window, block) for window in state.windows)
            state = replace(state, windows=others)
        estimator, own = self._own(state)
        found, before = list[Stepped[WindowedState]](), state
        for event, _, inner, innovation, _ in estimator.assimilate(own, block)[1]:
            changed = tuple(
                replace(one, state=inner) if self.vehicle in one.vehicles else one
                for one in before.windows
            )
            after = replace(before, windows=changed)
            found.append(Stepped(event, before, after, innovation))
            before = after
        return before, found

    def _beside(self, window: Window, block: Sequence[Measurement | ProfileGroup]) -> Window:
        """Return a window of other vehicles after the measurements that it holds; the vehicle's own as it is."""
        held = [item for item in block if inside(window.region, *_places(item)).all()]
        if self.vehicle in window.vehicles or not held:
            return window
        return replace(window, state=self._of(window.region).assimilate(window.state, held)[0])

    def _stays(self, state: WindowedState, observation: Measurement | ProfileGroup) -> bool:
        """Return whether an observation certainly leaves the vehicle in its window."""
        region, place = self.window(state), _place(observation)
        return (
            self.vehicle not in state.strays
            and inside(region, *place).item()
            and next_window(region, self.margin, self.bounds, place) is None
        )

    def moved(self, state: WindowedState, measurement: Measurement | ProfileGroup) -> WindowedState:
        """Return the state with the vehicle in the window that a measurement needs."""
        place, own = _place(measurement), self._window(state)
        if self.vehicle not in own.vehicles:
            state = state.entered(self.vehicle, own)
        region = own.region
        strays = (
            0
            if inside(region, *place) or not inside(self.bounds, *place)
            else state.strays.get(self.vehicle, 0) + 1
        )
        following = (
            next_window(region, self.margin, self.bounds, place) if strays in (0, _STRAYS) else None
        )
        if following is not None:
            other = state.holding(place, self.bounds, 0.5 * self.margin)
            if other is not None:
                return state.entered(self.vehicle, other)
        if following is None or following in [refused for refused, _ in state.unusable]:
            return state.with_strays(self.vehicle, strays)
        try:
            begun, loss = hand_over(self._of(region), own.state, self._of(following))
        except ForecastError as error:
            state = replace(state, unusable=(*state.unusable, (following, str(error))))
            return state.with_strays(self.vehicle, 0)
        state = state.entered(self.vehicle, Window(following, begun))
        return replace(state, loss=max(state.loss, loss))

    def usable(self, observation: Measurement) -> bool:
        """Return whether an observation has a bin that ``step`` would use, if it lies in water: windows are made when they are needed."""
        place = _place(observation)
        if not inside(self.bounds, *place):
            return False
        linear = observation.linear
        if inside(self.first, *place) or not linear.at_one_place:
            return self._of(self.first).usable(linear) or not inside(self.first, *place)
        levels = self._of(self.first).grid.levels
        return bool(
            np.any(np.isfinite(linear.value).all(axis=1) & (linear.value_depth <= levels[-1]))
        )

    def innovation(self, state: WindowedState, event: Measurement | ProfileGroup) -> Array:
        """Return measured minus predicted in the vehicle's window; as of ``Estimator``."""
        estimator, own = self._own(state)
        return estimator.innovation(own, event)

    def flow(self, state: WindowedState) -> FlowEstimate:
        """Return the current estimate in the vehicle's window."""
        estimator, own = self._own(state)
        return estimator.flow(own)

    def left_flows(self, state: WindowedState) -> Iterator[FlowEstimate]:
        """Yield the last estimate of each window that was left; before the latest ones each is made from the forecast again."""
        for window in state.left:
            yield self._of(window.region).flow(window.state)

    def without_left(self, state: WindowedState) -> WindowedState:
        """Return a state that holds the windows of vehicles alone, so that its size does not grow with their ways."""
        return replace(state, left=()) if state.left else state

    def of_own(self, state: WindowedState) -> WindowedState:
        """Return a state of the vehicle's window alone; as it is where there is no other."""
        own = state.of(self.vehicle)
        if own is None or len(state.windows) == 1:
            return state
        return replace(state, windows=(own,))

    def notes(self) -> list[str]:
        """Return the settings of the first window's prior."""
        return self._of(self.first).notes()

    def remarks(self, state: WindowedState) -> list[str]:
        """Return how many windows there were, what was lost between them, and which could not be made."""
        lost = f"up to {100.0 * state.loss:.1f} cm/s RMS of what one had learnt was not handed over"
        several = len({number for one in state.windows for number in one.vehicles}) > 1
        followed = f"{state.number} windows followed the vehicle{'s' if several else ''}; {lost}"
        refused = (f"no window could be made at {at}: {reason}" for at, reason in state.unusable)
        return [*([followed] if state.number > 1 else []), *refused]


def _place(observation: Measurement | ProfileGroup) -> tuple[float, float]:
    """Return longitude and latitude of an observation [degrees]; of a path its end."""
    longitude, latitude = _places(observation)
    return float(longitude[-1]), float(latitude[-1])


def _places(observation: Measurement | ProfileGroup) -> tuple[Array, Array]:
    """Return the longitudes and latitudes of an observation [degrees], shape (m,)."""
    return np.atleast_1d(observation.longitude), np.atleast_1d(observation.latitude)
