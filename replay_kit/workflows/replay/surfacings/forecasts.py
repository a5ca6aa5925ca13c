"""Predicted surfacings: the end of each dive is predicted from earlier dives, and scored with its fix.

A dive's velocity through the water is that of its flight model after the dive; the fix after the dive is not used in its prediction. For a
log without DACs dives are predicted from displacements (``displacements.py``).
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.as_flown import AsFlown, FlownDive, flown_dive
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.core.observation import Fix, PathMean, Profiles, VehicleState, usable
from replay_kit.core.surfacing import (
    SHARES,
    DiveForecast,
    DiveOutcome,
    ellipse_of,
    forecast_place,
    usual_seconds,
)
from replay_kit.estimator.next_dive.local import local_step
from replay_kit.estimator.next_dive.mixture import Mixture, Persistence
from replay_kit.estimator.next_dive.process import DiveMean, MeanCurrentProcess, ProcessState
from replay_kit.workflows.replay.events import Aside, Track
from replay_kit.workflows.replay.stages.estimation import Step
from replay_kit.workflows.replay.surfacings.displacements import (
    Between,
    Dive,
    adrift,
    ahead_of,
    dived,
    first_ns,
    moved,
    over_ground,
    path_average,
    predicted,
    surfaced,
    watched,
)

# The ensemble alone, and the estimate before the dive.
_BACKGROUNDS = 2
_UNKNOWN = np.full((_BACKGROUNDS, 2), np.nan)
_BY_MEANS = MeanCurrentProcess(n_backgrounds=_BACKGROUNDS)
_BY_FIXES = MeanCurrentProcess(n_backgrounds=1)
# m; cells in which a dive's profiles are averaged
_CELL = 10.0
#: Returns the estimate for a time [ns, UTC].
FlowAt = Callable[[int], FlowEstimate]


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
        depth, velocity = (
            np.asarray(each, np.float64)
            for each in ((known + 0.5) * _CELL, self.sums[known, 1:] / self.sums[known, :1])
        )
        return path_average(mean.depth, mean.weight, depth, velocity)


@dataclass(frozen=True, slots=True, eq=False)
class ForecastState:
    """State of the predicted surfacings.

    Attributes:
        between: Positions since the last dive, for a log without a DAC so far; None after one.
        model: State of the model after the dives so far; None before the first, as it is large.
        persistence: Baseline prediction, as in the last dive.
        last: Last dive; None before the first.
        pending: Outcome of the last dive between fixes, until the next one begins, as its DAC may be logged until then.
        outcomes: Outcomes of the dives so far.
        dives: Flight of each dive with known flight.
        gathered: Profiles of the dive.
        local: State of the local correction; None before the first dive.
    """

    between: Between | None = field(default_factory=Between)
    model: ProcessState | None = None
    persistence: Persistence = field(default_factory=Persistence)
    last: Dive | None = None
    pending: DiveOutcome | None = None
    outcomes: tuple[DiveOutcome, ...] = ()
    dives: tuple[FlownDive, ...] = ()
    gathered: Gathered = field(default_factory=Gathered)
    local: LocalCurrent | None = None

    @property
    def states_means(self) -> bool:
        """Whether the log has stated a DAC."""
        return self.between is None

    @property
    def as_flown(self) -> AsFlown | None:
        """Median flight parameters of the dives; None without any."""
        return AsFlown.of(self.dives)

    @property
    def process(self) -> MeanCurrentProcess:
        """Model of dives."""
        return _BY_MEANS if self.between is None else _BY_FIXES

    @property
    def known(self) -> ProcessState:
        """State of the model; its initial state before the first dive."""
        return self.process.initial() if self.model is None else self.model


def forecast_step(
    state: ForecastState,
    step: Step,
    flow_at: FlowAt,
    surface_depth: float,
) -> ForecastState:
    """Return the state after an event; its outcomes grow where a dive is ended by it.

    Args:
        state: State before it.
        step: Step of a position, an observation, or a DAC that is not assimilated.
        flow_at: Function of the estimate before the event at a time [ns, UTC].
        surface_depth: Depth above which the vehicle is at the surface [m].
    """
    event = step.event
    if isinstance(event, Aside):
        return forecast_mean(state, event.mean)
    if isinstance(event, PathMean):
        state = _beside_estimate(state, event, step)
        return forecast_mean(state, event, _backgrounds(event, step))
    if state.between is not None and isinstance(event, VehicleState | Profiles):
        state = _between_fixes(state, state.between, event, flow_at, surface_depth)
    if isinstance(event, Profiles) and (more := state.gathered.after(event)) is not state.gathered:
        state = replace(state, gathered=more)
    return state


def forecast_track(
    state: ForecastState, track: Track, surface_depth: float
) -> ForecastState | None:
    """Return the state after consecutive positions without effect on predictions; None if ``forecast_step`` must process each."""
    if state.between is None:
        return state
    between = adrift(state.between, track, surface_depth)
    return None if between is None else replace(state, between=between)


def forecast_end(state: ForecastState) -> ForecastState:
    """Return the state at the end of a log, with the outcome of a last dive without a DAC."""
    return _told(_concluded(state))


def _between_fixes(
    state: ForecastState,
    between: Between,
    event: VehicleState | Profiles,
    flow_at: FlowAt,
    surface_depth: float,
) -> ForecastState:
    """Return the state after a position or profile; the last dive has its outcome when the next one begins."""
    if between.surfaced is not None and first_ns(event) > between.surfaced[1].time_ns:
        # all observations of its end have arrived
        state = _concluded(state)
    between, begins = watched(state.between or between, event, surface_depth)
    if begins:
        state = _told(_concluded(replace(state, between=between)))
        between = state.between or between
        if (fix := between.latest) is not None:
            between = dived(between, flow_at(fix.time_ns), state.last)
    return replace(state, between=moved(between, event, surface_depth))


def _concluded(state: ForecastState) -> ForecastState:
    """Return the state after the last dive between fixes, if ended, with its outcome and the updated model."""
    if state.between is None or state.between.surfaced is None:
        return state
    dive = surfaced(state.between, state.last)
    dive = replace(dive, number=dive.number or state.known.dives + 1)
    between = replace(state.between, surfaced=None, ahead=None)
    return replace(_scored(state, dive), between=between)


def _scored(state: ForecastState, dive: Dive) -> ForecastState:
    """Return the state after a dive, with its predicted end and the score as pending outcome."""
    mean, last = dive.mean, state.persistence.velocity
    expected = state.process.forecast(state.known, mean)
    off = np.nan if last is None else float(np.hypot(*(mean.velocity - last)))
    outcome = DiveOutcome(
        forecast=_placed(state, expected, dive),
        fix=Fix(*dive.fixes[1]),
        log_score=expected.log_density(mean.velocity),
        persistence_log_score=state.persistence.log_density(mean.velocity),
        persistence_distance=off * mean.seconds,
    )
    return replace(
        state,
        model=state.process.step(state.known, mean),
        persistence=state.persistence.after(mean.velocity),
        last=dive,
        pending=outcome,
    )


def _told(state: ForecastState) -> ForecastState:
    """Return the state with the pending outcome among the others."""
    if state.pending is None:
        return state
    flown = () if state.last is None or state.last.flown is None else (state.last.flown,)
    outcomes, dives = (*state.outcomes, state.pending), (*state.dives, *flown)
    return replace(state, pending=None, outcomes=outcomes, dives=dives)


def _placed(state: ForecastState, expected: Mixture, dive: Dive) -> DiveForecast:
    """Return the predicted end of a dive after its first fix."""
    start, seconds = dive.fixes[0], dive.mean.seconds
    longitude, latitude = forecast_place(start, seconds, dive.mean.way + expected.mean)
    cov = seconds**2 * expected.cov
    inner, outer = (
        ellipse_of(longitude, latitude, cov, radius) for radius in expected.radii(SHARES)
    )
    return DiveForecast(
        dive=dive.number,
        earlier=state.known.dives,
        start=start,
        time_ns=start.time_ns + round(seconds * 1e9),
        longitude=longitude,
        latitude=latitude,
        inner=inner,
        outer=outer,
        persistence_radius=state.persistence.radius(SHARES[1]) * seconds,
        basis=dive.basis,
    )


def forecast_mean(
    state: ForecastState, mean: PathMean, backgrounds: Array = _UNKNOWN
) -> ForecastState:
    """Return the state after a DAC, with the outcome of its dive; unchanged by a DAC without fixes.

    Args:
        state: State before it.
        mean: The DAC.
        backgrounds: shape (2, 2) [m/s], true east and north, DAC predicted by the prior and by the estimate before the dive; NaN where
            unknown.
    """
    if mean.fixes is None:
        return state
    if not state.states_means:
        # dives without a mean current are known less well
        fresh = ForecastState(None)
        state = replace(fresh, outcomes=state.outcomes, gathered=state.gathered, local=state.local)
    dive = dive_mean(state.gathered, mean, backgrounds)
    return _told(_scored(state, Dive(dive, mean.fixes, mean.dive, flown=flown_of(mean))))


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
    if (last := state.last) is None:
        return None
    if state.between is None:
        fix, basis, backgrounds = last.fixes[1], last.basis, _UNKNOWN
        seconds = longer * usual_seconds(state.outcomes)
    else:
        if flow is None or (at := state.between.latest) is None:
            return None
        fix = Fix(at.time_ns, at.longitude, at.latitude)
        depths, weight = last.path
        ahead = ahead_of(at, flow, last)
        current, basis = predicted(ahead, last, longer * depths, weight)
        seconds, backgrounds = longer * last.mean.seconds, current[None]
    coming = replace(
        last.mean,
        time_ns=fix.time_ns + int(0.5e9 * seconds),
        seconds=seconds,
        backgrounds=backgrounds,
        inverted=None,
    )
    dive = Dive(coming, (fix, fix), last.number + 1, basis)
    return _placed(state, state.process.forecast(state.known, coming), dive)


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


def flown_of(mean: PathMean) -> FlownDive | None:
    """Return the flight of a DAC's dive; None for an unknown velocity through the water."""
    if mean.fixes is None:
        return None
    start, end = mean.fixes
    seconds, moved = over_ground(start, end)
    way = moved - np.array(mean.velocity)
    about = mean.deepest, start.time_ns, mean.radius, mean.declination
    return flown_dive(seconds, way, mean.depth, *about)


def _beside_estimate(state: ForecastState, mean: PathMean, step: Step) -> ForecastState:
    """Return the state with the local correction updated by a DAC; unchanged where the estimate does not predict it."""
    innovation, std = step.dive_innovation, step.dive_std
    known = std is not None and innovation.shape == (1, 2)
    if std is None or not known or not np.isfinite([*innovation, *std]).all():
        return state
    middle_ns = (int(mean.path_time_ns[0]) + mean.time_ns) // 2
    return replace(state, local=local_step(state.local, middle_ns, innovation[0], std[0]))


def _backgrounds(mean: PathMean, step: Step) -> Array:
    """Return the DAC predicted by the prior and by the estimate before the dive, as in ``forecast_mean``."""
    used = None if (found := step.innovation) is None else found.used_current
    if found is None or used is None or not np.any(used):
        return _UNKNOWN
    # the mean on both axes turns local ones to true ones
    turn, each = complex(*mean.used) / complex(*used), list[Array]()
    for innovation in (found.prior_innovation, step.dive_innovation):
        each.append(used - (innovation[0] if innovation.shape == (1, 2) else np.nan))
    predicted = np.stack(each)
    turned = (predicted[:, 0] + 1j * predicted[:, 1]) * turn
    return np.column_stack([turned.real, turned.imag])
