"""An estimator of windows that follow the vehicle."""

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.core.region import Region, inside
from replay_kit.estimator.interface import Estimator, Stepped
from replay_kit.estimator.static.filter import ReducedBasisEstimator
from replay_kit.estimator.static.state import FilterState
from replay_kit.estimator.update.grouping import Grouping, ProfileGroup
from replay_kit.estimator.windows.handover import hand_over
from replay_kit.estimator.windows.placing import next_window

# Measurements in a row outside the window after which a window is made about them: one may have a wrong position.
_STRAYS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """A window, and the estimate in it.

    Attributes:
        region: West, south, east, north [degrees].
        state: Of its estimator.
    """

    region: Region
    state: FilterState


@dataclass(frozen=True, slots=True, eq=False)
class WindowedState:
    """The estimate in the window that holds the vehicle, and the last ones of those it left, until they are forgotten.

    Attributes:
        current: The window that holds the vehicle.
        left: Windows that were left, in order; those forgotten are not among them.
        number: Of windows so far, the current one included.
        loss: Largest root mean square so far of the information on the next window that was not handed over [m/s].
        strays: Number of measurements in a row that lay outside the window.
        unusable: Windows that could not be made, each with the reason.
    """

    current: Window
    left: tuple[Window, ...] = ()
    number: int = 1
    loss: float = 0.0
    strays: int = 0
    unusable: tuple[tuple[Region, str], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class WindowedEstimator(Estimator[WindowedState]):
    """Static estimators of windows, one after the other; each begins with the information of the one before it where they overlap.

    All windows have one local frame, and the same levels.

    Attributes:
        first: The first window [degrees].
        margin: Distance from the vehicle to a window's sides that an estimate needs [m].
        bounds: The forecast's box [degrees].
        build: Returns the estimator of a window; the same window gives the same estimator, and the latest are kept.
        gating: Gate and covariance inflation; None accepts every profile with its stated errors.
        grouping: Which profiles are combined; None combines none.
    """

    first: Region
    margin: float
    bounds: Region
    build: Callable[[Region], ReducedBasisEstimator]
    gating: GatingConfig | None = None
    grouping: Grouping | None = None

    supports_path_means = True
    block_size = ReducedBasisEstimator.block_size

    @property
    def state_size(self) -> int:
        """Number of weights in all of the first window."""
        return self._of(self.first).state_size

    @property
    def basis_size(self) -> tuple[int | None, int | None]:
        """Number of modes for each level, and of elements of the basis, of the first window."""
        return self._of(self.first).basis_size

    def _of(self, region: Region) -> ReducedBasisEstimator:
        return replace(self.build(region), gating=self.gating, grouping=self.grouping)

    def initial(self) -> WindowedState:
        """Return the prior of the first window as a state."""
        return WindowedState(Window(self.first, self._of(self.first).initial()))

    def step(
        self, state: WindowedState, observation: Measurement
    ) -> tuple[WindowedState, Innovation]:
        """Return the state after an observation, in the window that it lies in, and its innovation."""
        return next(self.steps(state, [observation]))

    def steps(
        self, state: WindowedState, observations: Iterable[Measurement]
    ) -> Iterator[tuple[WindowedState, Innovation]]:
        """Yield the state after each observation, and its innovation."""
        for _, _, after, innovation, _ in self.group_steps(state, observations):
            yield after, innovation

    def group_steps(
        self, state: WindowedState, items: Iterable[Measurement | ProfileGroup]
    ) -> Iterator[Stepped[WindowedState]]:
        """Yield the outcome of measurements and groups of profiles, each in the window that it lies in."""
        block = list[Measurement | ProfileGroup]()
        for item in items:
            if block and (len(block) == self.block_size or not self._stays(state, item)):
                state = yield from self._in_window(state, block)
                block = []
            if not block:
                state = self._moved(state, item)
            block.append(item)
        yield from self._in_window(state, block)

    def _in_window(
        self, state: WindowedState, block: Sequence[Measurement | ProfileGroup]
    ) -> Generator[Stepped[WindowedState], None, WindowedState]:
        """Yield the outcome of measurements and groups in one window; return the last state."""
        for event, _, inner, innovation, _ in self._of(state.current.region).group_steps(
            state.current.state, block
        ):
            before, state = state, replace(state, current=replace(state.current, state=inner))
            yield Stepped(event, before, state, innovation)
        return state

    def _stays(self, state: WindowedState, observation: Measurement | ProfileGroup) -> bool:
        """Return whether an observation certainly leaves the window as it is."""
        region, place = state.current.region, _place(observation)
        return (
            not state.strays
            and inside(region, *place).item()
            and next_window(region, self.margin, self.bounds, place) is None
        )

    def _moved(
        self, state: WindowedState, observation: Measurement | ProfileGroup
    ) -> WindowedState:
        """Return the state in the window that an observation needs."""
        place, region = _place(observation), state.current.region
        strays = (
            0 if inside(region, *place) or not inside(self.bounds, *place) else state.strays + 1
        )
        following = (
            next_window(region, self.margin, self.bounds, place) if strays in (0, _STRAYS) else None
        )
        if following is None or following in [refused for refused, _ in state.unusable]:
            return state if strays == state.strays else replace(state, strays=strays)
        try:
            begun, loss = hand_over(self._of(region), state.current.state, self._of(following))
        except ForecastError as error:
            return replace(state, strays=0, unusable=(*state.unusable, (following, str(error))))
        left, most = (*state.left, state.current), max(state.loss, loss)
        return WindowedState(
            Window(following, begun), left, state.number + 1, most, 0, state.unusable
        )

    def usable(self, observation: Measurement) -> bool:
        """Return whether an observation has a bin that ``step`` would use, if it lies in water: windows are made when they are needed."""
        place = _place(observation)
        if not inside(self.bounds, *place):
            return False
        linear = observation.linear
        if inside(self.first, *place) or not linear.at_one_place:
            return self._of(self.first).usable(linear) or not inside(self.first, *place)
        levels = self._of(self.first).basis.grid.levels
        return bool(
            np.any(np.isfinite(linear.value).all(axis=1) & (linear.value_depth <= levels[-1]))
        )

    def innovation(self, state: WindowedState, observation: Measurement) -> Array:
        """Return measured minus predicted in the state's window, shape (n, 2) [m/s], local axes; NaN for bins that are not usable."""
        return self._of(state.current.region).innovation(state.current.state, observation)

    def group_innovation(self, state: WindowedState, group: ProfileGroup) -> Array:
        """Return the same of all bins of all profiles of a group, shape (n m, 2) [m/s]; 0 for bins that are not usable."""
        return self._of(state.current.region).group_innovation(state.current.state, group)

    def flow(self, state: WindowedState) -> FlowEstimate:
        """Return the current estimate in the state's window."""
        return self._of(state.current.region).flow(state.current.state)

    def left_flows(self, state: WindowedState) -> Iterator[FlowEstimate]:
        """Yield the last estimate of each window that was left; before the latest two each is made from the forecast again."""
        for window in state.left:
            yield self._of(window.region).flow(window.state)

    def without_left(self, state: WindowedState) -> WindowedState:
        """Return a state that holds the current window alone, so that its size does not grow with the way."""
        return replace(state, left=()) if state.left else state

    def notes(self) -> list[str]:
        """Return the settings of the first window's prior."""
        return self._of(self.first).notes()

    def bias_notes(self, state: WindowedState) -> list[str]:
        """Return the notes of the last window, and on the windows."""
        notes = self._of(state.current.region).bias_notes(state.current.state)
        if state.number > 1:
            lost = f"{100.0 * state.loss:.1f} cm/s RMS"
            notes.append(
                f"{state.number} windows followed the vehicle; up to {lost} of what one had learnt was not handed over"
            )
        return [
            *notes,
            *(
                f"no window could be made at {refused}: {reason}"
                for refused, reason in state.unusable
            ),
        ]

    def spread_record(self, state: WindowedState) -> dict[str, str]:
        """Return the amplitude of the prior's covariance in a state, and what it was fitted to."""
        return self._of(state.current.region).spread_record(state.current.state)


def _place(observation: Measurement | ProfileGroup) -> tuple[float, float]:
    """Return longitude and latitude of an observation [degrees]; of a path its end."""
    return float(np.atleast_1d(observation.longitude)[-1]), float(
        np.atleast_1d(observation.latitude)[-1]
    )
