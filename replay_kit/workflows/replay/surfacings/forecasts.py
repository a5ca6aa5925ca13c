"""Predicted surfacings: the end of each dive is predicted from earlier dives, and scored with its fix.

A dive's velocity through the water is that of its flight model after the dive; the fix after the dive is not used in its prediction. For a
log without DACs dives are predicted from displacements (``displacements.py``).
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
    """Profiles of a dive by depth.

    Attributes:
        dive: Number of the dive.
        sums: shape (cells, 3): number of bins, sums of east and north [m/s].
    """

    dive: int = 0
    sums: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def after(self, profiles: Profiles) -> "Gathered":
        """Return the sums with absolute profiles of dives; others change nothing."""
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
        """Return the mean along the path of the dive's DAC, shape (2,), constant beyond the profiles; None without any."""
        known = np.flatnonzero(self.sums[:, 0])
        if self.dive != mean.dive or known.size == 0:
            return None
        depth, velocity = (known + 0.5) * _CELL, self.sums[known, 1:] / self.sums[known, :1]
        return np.array(
            [mean.weight @ np.interp(mean.depth, depth, component) for component in velocity.T]
        )


@dataclass(frozen=True, slots=True, eq=False)
class ForecastState:
    """State of the predicted surfacings.

    Attributes:
        before: Knowledge before the next dive.
        gathered: Profiles of the dive.
        last: DAC of the last dive; None before the first.
        ground: State for a log without a DAC so far.
        outcomes: Outcomes of the dives so far.
        local: State of the local correction; None before the first dive.
        dives: Flight of each dive with known flight.
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
        """Whether the log has stated a DAC."""
        return self.before.state is not None

    @property
    def as_flown(self) -> AsFlown | None:
        """Median flight parameters of the dives; None without any."""
        return AsFlown.of(self.dives)


def forecast_step(
    state: ForecastState,
    event: Any,
    assimilation: Assimilation | None,
    flow_at: FlowAt,
    surface_depth: float,
) -> tuple[ForecastState, tuple[DiveOutcome, ...]]:
    """Return the state after an event, and the outcome of a dive ended by it.

    Args:
        state: State before it.
        event: Position or observation.
        assimilation: Assimilation of the observation.
        flow_at: Function of the estimate before the event at a time [ns, UTC].
        surface_depth: Depth above which the vehicle is at the surface [m].
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
    """Return the state after consecutive positions without effect on predictions; None if ``forecast_step`` must process each."""
    if state.states_means:
        return state
    ground = adrift(state.ground, track, surface_depth)
    return None if ground is None else replace(state, ground=ground)


def forecast_end(state: ForecastState) -> tuple[ForecastState, tuple[DiveOutcome, ...]]:
    """Return the state at the end of a log, and the outcome of a last dive without a DAC."""
    ground = concluded(state.ground)
    return _with_ground(state, ground, () if ground.concluded is None else (ground.concluded,))


def _with_ground(
    state: ForecastState, ground: GroundState, ended: tuple[DiveOutcome, ...]
) -> tuple[ForecastState, tuple[DiveOutcome, ...]]:
    """Return the state after a step of the predictions from displacements, and the outcome of a finished dive."""
    if not ended:
        return (state if ground is state.ground else replace(state, ground=ground)), ()
    state = replace(state, ground=ground, outcomes=(*state.outcomes, *ended))
    return (state if ground.last is None else _with_dive(state, ground.last.flown)), ended


def _with_dive(state: ForecastState, dive: FlownDive | None) -> ForecastState:
    """Return the state with the flight of a dive; unchanged for None."""
    return state if dive is None else replace(state, dives=(*state.dives, dive))


def forecast_mean(
    state: ForecastState, mean: PathMean, backgrounds: Array | None = None
) -> tuple[ForecastState, tuple[DiveOutcome, ...]]:
    """Return the state after a DAC, and the outcome of its dive; unchanged by a surface drift or a DAC without fixes.

    Args:
        state: State before it.
        mean: The DAC.
        backgrounds: shape (2, 2) [m/s], true east and north, DAC predicted by the prior and by the estimate before the dive; NaN where
            unknown, None if both are.
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
    """Return the predicted next surfacing after a dive like the last one from the last fix; None before the first dive.

    Args:
        state: State after all dives.
        flow: Estimate, for a log without DACs; None without one.
        depth: Commanded depth of the next dive [m], with the vertical speed of the last one; None for the last one's depth.
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
    """Return the dive of a DAC with fixes, with the dive's own profiles and its predictions by ensemble and estimate."""
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
    """Return the flight of a DAC's dive; None for a surface drift or an unknown velocity through the water.

    Args:
        mean: The DAC.
        dive: Its dive in the form of the model, if known.
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
    """Return the predictions of a DAC, shape (k, 2) [m/s], true east and north; NaN where unknown.

    Args:
        mean: The DAC.
        used: shape (2,) [m/s], its assimilated value along the local axes.
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
    """Return the state with the local correction updated by a DAC; unchanged without an estimate."""
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
    """Return the DAC predicted by the prior and by the estimate before the dive, shape (2, 2); NaN where unknown."""
    found = assimilation.innovation
    if found.used_current is None:
        return _UNKNOWN
    return backgrounds_of(
        mean, found.used_current, [found.prior_innovation, assimilation.dive_innovation]
    )
