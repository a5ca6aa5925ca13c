"""The forecasts of surfacings: each dive's end is expected from the dives before it, and scored when its fix has come.

The dive's way through the water is taken as its flight model states it after the dive; the fix after the dive enters nothing before the
forecast of that dive is made. Of a log without mean currents dives are expected from their displacements (``displacements.py``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.as_flown import AsFlown, FlownDive, flown_dive
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.core.observation import PathMean, Profiles, usable
from replay_kit.core.surfacing import DiveForecast, DiveOutcome, usual_seconds
from replay_kit.estimator.next_dive.local import local_step
from replay_kit.estimator.next_dive.process import DiveMean, MeanCurrentProcess
from replay_kit.workflows.replay.events import Track
from replay_kit.workflows.replay.stages.estimation import Assimilation
from replay_kit.workflows.replay.surfacings.displacements import (
    FlowAt,
    GroundState,
    adrift,
    concluded,
    ground_step,
    next_ground_surfacing,
    over_ground,
)
from replay_kit.workflows.replay.surfacings.outcomes import Before

# The ensemble alone, and the estimate before the dive.
_BACKGROUNDS = 2
_UNKNOWN = np.full((_BACKGROUNDS, 2), np.nan)
_PROCESS = MeanCurrentProcess(n_backgrounds=_BACKGROUNDS)
# m; cells in which a dive's profiles are averaged
_CELL = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """The profiles of a dive by depth.

    Attributes:
        dive: Its number.
        sums: shape (cells, 3): number of bins, sums of east and north [m/s].
    """

    dive: int = 0
    sums: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def after(self, profiles: Profiles) -> "Gathered":
        """Return the same after absolute profiles of dives; others change nothing."""
        dives, absolute = profiles["dive"], np.isfinite(profiles["common_std"])
        used = usable(profiles["flags"]) & np.isfinite(profiles["velocity"]).all(axis=2)
        used &= ((dives != 0) & absolute)[:, None]
        gathered = self
        for dive in dict.fromkeys(dives[used.any(axis=1)].tolist()):
            own = used & (dives == dive)[:, None]
            sums = gathered.sums if dive == gathered.dive else np.zeros((0, 3))
            cell = (np.maximum(profiles["depth"][own], 0.0) // _CELL).astype(np.int64)
            more = max(int(cell.max()) + 1 - len(sums), 0)
            sums = np.vstack([sums, np.zeros((more, 3))])
            each = np.column_stack([np.ones(cell.size), profiles["velocity"][own]])
            np.add.at(sums, cell, each)
            gathered = Gathered(dive, sums)
        return gathered

    def along(self, mean: PathMean) -> Array | None:
        """Return their mean along the path of the dive's mean current, shape (2,), beyond them the nearest; None without any."""
        known = np.flatnonzero(self.sums[:, 0])
        if self.dive != mean.dive or known.size == 0:
            return None
        depth, velocity = (known + 0.5) * _CELL, self.sums[known, 1:] / self.sums[known, :1]
        return np.array(
            [mean.weight @ np.interp(mean.depth, depth, component) for component in velocity.T]
        )


@dataclass(frozen=True, slots=True, eq=False)
class ForecastState:
    """What the forecasts of surfacings remember.

    Attributes:
        before: What is known before the next dive.
        gathered: Profiles of the dive.
        last: The last dive's mean; None before the first.
        ground: Of a log that has stated no mean current yet.
        outcomes: Of the dives so far.
        local: Of the current beside the estimate; None before the first dive.
        dives: How the vehicle flew each dive that shows it.
    """

    before: Before = field(default_factory=lambda: Before(_PROCESS))
    gathered: Gathered = field(default_factory=Gathered)
    last: DiveMean | None = None
    ground: GroundState = field(default_factory=GroundState)
    outcomes: tuple[DiveOutcome, ...] = ()
    local: LocalCurrent | None = None
    dives: tuple[FlownDive, ...] = ()

    @property
    def states_means(self) -> bool:
        """Whether the log has stated the mean current of a dive."""
        return self.before.state is not None

    @property
    def as_flown(self) -> AsFlown | None:
        """The median of the dives; None without any."""
        return AsFlown.of(self.dives)


def forecast_step(
    state: ForecastState,
    event: Any,
    assimilation: Assimilation | None,
    flow_at: FlowAt,
    surface_depth: float,
) -> tuple[ForecastState, tuple[DiveOutcome, ...]]:
    """Return the state after an event, and the outcome of the dive that it ends.

    Args:
        state: Before it.
        event: A position or a measurement.
        assimilation: Of the measurement.
        flow_at: The estimate before the event, for a time [ns, UTC].
        surface_depth: [m], shallower than this the vehicle is at the surface.
    """
    ended: tuple[DiveOutcome, ...] = ()
    if not state.states_means:
        ground = ground_step(state.ground, event, flow_at, surface_depth)
        state, ended = _with_ground(state, *ground)
    if isinstance(event, PathMean):
        state = _beside_estimate(state, event, assimilation)
        known = None if assimilation is None else _backgrounds(event, assimilation)
        return forecast_mean(state, event, known)
    if isinstance(event, Profiles) and (more := state.gathered.after(event)) is not state.gathered:
        state = replace(state, gathered=more)
    return state, ended


def forecast_track(
    state: ForecastState, track: Track, surface_depth: float
) -> ForecastState | None:
    """Return the state after positions in a row that no forecast is made or judged by; None where ``forecast_step`` must look at each."""
    if state.states_means:
        return state
    ground = adrift(state.ground, track, surface_depth)
    return None if ground is None else replace(state, ground=ground)


def forecast_end(state: ForecastState) -> tuple[ForecastState, tuple[DiveOutcome, ...]]:
    """Return the state at the end of a log, and the outcome of its last dive that no mean current stated."""
    ground = concluded(state.ground)
    return _with_ground(state, ground, () if ground.concluded is None else (ground.concluded,))


def _with_ground(
    state: ForecastState, ground: GroundState, ended: tuple[DiveOutcome, ...]
) -> tuple[ForecastState, tuple[DiveOutcome, ...]]:
    """Return the state after a step of the forecasts from displacements, and the outcome of the dive that has ended."""
    if not ended:
        return (state if ground is state.ground else replace(state, ground=ground)), ()
    state = replace(state, ground=ground, outcomes=(*state.outcomes, *ended))
    return (state if ground.last is None else _with_dive(state, ground.last.flown)), ended


def _with_dive(state: ForecastState, dive: FlownDive | None) -> ForecastState:
    """Return the state after a dive was flown; None shows nothing."""
    return state if dive is None else replace(state, dives=(*state.dives, dive))


def forecast_mean(
    state: ForecastState, mean: PathMean, backgrounds: Array | None = None
) -> tuple[ForecastState, tuple[DiveOutcome, ...]]:
    """Return the state after a mean current, and the outcome of its dive; a drift at the surface, or one without fixes, changes nothing.

    Args:
        state: Before it.
        mean: The mean current.
        backgrounds: shape (2, 2) [m/s], true east and north, what the prior forecast and the estimate before the dive say of it; NaN
            where they say nothing, None where neither does.
    """
    if mean.kind != "dac" or mean.fixes is None:
        return state, ()
    dive = dive_mean(state.gathered, mean, _UNKNOWN if backgrounds is None else backgrounds)
    before, outcome = state.before.after(dive, mean.fixes, mean.dive)
    # dives without a mean current are known less well
    known = state if state.states_means else replace(state, dives=())
    after = replace(
        _with_dive(known, flown_of(mean, dive)),
        before=before,
        last=dive,
        ground=GroundState(),
        outcomes=(*state.outcomes, outcome),
    )
    return after, (outcome,)


def next_surfacing(
    state: ForecastState, flow: FlowEstimate | None = None, depth: float | None = None
) -> DiveForecast | None:
    """Return where the vehicle surfaces next if it flies as in the last dive, from the last fix on; None before the first dive.

    Args:
        state: After all dives.
        flow: The estimate, for a log without mean currents; None without.
        depth: That the coming dive is told to go to [m], with the last one's vertical speed; None for as deep as the last one.
    """
    longer = 1.0 if depth is None or not state.dives else depth / state.dives[-1].depth
    if not state.states_means and flow is not None:
        return next_ground_surfacing(state.ground, flow, longer)
    if state.last is None:
        return None
    last, fix = state.last, state.outcomes[-1].fix
    seconds = longer * usual_seconds(state.outcomes)
    coming = replace(
        last,
        time_ns=fix.time_ns + int(0.5e9 * seconds),
        seconds=seconds,
        backgrounds=_UNKNOWN,
        inverted=None,
    )
    return state.before.forecast(coming, fix, state.outcomes[-1].forecast.dive + 1)


def dive_mean(gathered: Gathered, mean: PathMean, backgrounds: Array) -> DiveMean:
    """Return what a mean current with fixes says, with the dive's own profiles and with what the ensemble and the estimate say of it."""
    assert mean.fixes is not None
    start, end = mean.fixes
    (seconds, moved), velocity = over_ground(start, end), np.array(mean.velocity)
    return DiveMean(
        time_ns=(start.time_ns + end.time_ns) // 2,
        seconds=seconds,
        way=moved - velocity,
        velocity=velocity,
        inverted=gathered.along(mean),
        backgrounds=backgrounds,
    )


def flown_of(mean: PathMean, dive: DiveMean | None = None) -> FlownDive | None:
    """Return how the dive of a mean current was flown; None for a drift at the surface, or where its way through the water is not known.

    Args:
        mean: The mean current.
        dive: What it says, where that is known.
    """
    if mean.kind != "dac" or mean.fixes is None:
        return None
    dive = dive or dive_mean(Gathered(), mean, _UNKNOWN)
    return flown_dive(
        dive.seconds,
        dive.way,
        mean.depth,
        mean.deepest,
        mean.fixes[0].time_ns,
        mean.radius,
        mean.declination,
    )


def backgrounds_of(mean: PathMean, used: Array, innovations: Sequence[Array]) -> Array:
    """Return what others say of a mean current, shape (k, 2) [m/s], true east and north; NaN where they say nothing.

    Args:
        mean: The mean current.
        used: shape (2,) [m/s], what is used of it, along the local axes.
        innovations: Each of shape (1, 2) [m/s], along the local axes: ``used`` minus predicted.
    """
    if not np.any(used):
        return np.full((len(innovations), 2), np.nan)
    # the mean on both axes turns local ones to true ones
    turn = complex(*mean.used) / complex(*used)
    predicted = np.stack(
        [used - (each[0] if each.shape == (1, 2) else np.nan) for each in innovations]
    )
    turned = (predicted[:, 0] + 1j * predicted[:, 1]) * turn
    return np.column_stack([turned.real, turned.imag])


def _beside_estimate(
    state: ForecastState, mean: PathMean, assimilation: Assimilation | None
) -> ForecastState:
    """Return the state after what a dive's mean current says of the current beside the estimate; nothing where no estimate is."""
    if (
        assimilation is None
        or assimilation.dive_std is None
        or assimilation.dive_innovation.shape != (1, 2)
    ):
        return state
    (innovation,), (std,) = assimilation.dive_innovation, assimilation.dive_std
    if not (np.isfinite(innovation).all() and np.isfinite(std).all()):
        return state
    middle_ns = (int(mean.path_time_ns[0]) + mean.time_ns) // 2
    return replace(state, local=local_step(state.local, middle_ns, innovation, std))


def _backgrounds(mean: PathMean, assimilation: Assimilation) -> Array:
    """Return the mean current by the prior forecast and by the estimate before the dive, shape (2, 2); NaN where they are not known."""
    found = assimilation.innovation
    if found.used_current is None:
        return _UNKNOWN
    return backgrounds_of(
        mean, found.used_current, [found.prior_innovation, assimilation.dive_innovation]
    )
