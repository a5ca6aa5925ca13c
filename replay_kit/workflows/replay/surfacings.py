"""Predicted surfacings: the end of each dive is predicted from earlier dives, and scored with its fix; and the flight model's error.

A dive's velocity through the water is that of its flight model after the dive; the fix after the dive is not used in its prediction. For a
log without DACs dives are predicted from displacements (``displacements.py``).

DACs are corrected for the flight-model error before assimilation. A DAC is the distance of a surfacing from its dead-reckoned position over
the dive's duration. A relative error of the flight model is thus an error of the DAC: w (a + i b), with the velocity through the water w.
An error estimated from earlier dives (``FlightBias``) is subtracted, its uncertainty added to the observation error. A dive's own
DAC and profiles contribute from the next dive on.

Only profiles inverted from the dive's pings and DAC determine the flight model. Others are compared with uncorrected DACs to check the
instrument (``measurements/checks``): a rotated one would look like a flight-model error. A DAC with inverted profiles is not new to the
estimate: without a correction its error includes the remaining uncertainty of the flight model.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from replay_kit.core.arrays import Array, Indices, replace
from replay_kit.core.as_flown import AsFlown, FlightCorrection, FlownDive, flown_dive
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.core.observation import Fix, PathMean, Profiles, VehicleState, usable
from replay_kit.core.observation.table import Block, Columns
from replay_kit.core.surfacing import (
    SHARES,
    DiveForecast,
    DiveOutcome,
    ellipse_of,
    forecast_place,
    usual_seconds,
)
from replay_kit.estimator.next_dive.corrections import FlightBias, local_step
from replay_kit.estimator.next_dive.mixture import Mixture, Persistence
from replay_kit.estimator.next_dive.process import DiveMean, MeanCurrentProcess, ProcessState
from replay_kit.measurements.means import Spot, extended_path, path_from
from replay_kit.measurements.track.dives import detect_surfacing
from replay_kit.workflows.replay.displacements import (
    Between,
    Dive,
    ahead_of,
    dive_along,
    in_dive,
    over_ground,
    path_average,
    predicted_mean,
    spot_of,
)
from replay_kit.workflows.replay.events import Aside, Track
from replay_kit.workflows.replay.publishing import FlowAt
from replay_kit.workflows.replay.steps import Step

# The ensemble alone, and the estimate before the dive.
_BACKGROUNDS = 2
_UNKNOWN = np.full((_BACKGROUNDS, 2), np.nan)
_BY_MEANS = MeanCurrentProcess(n_backgrounds=_BACKGROUNDS)
_BY_FIXES = MeanCurrentProcess(n_backgrounds=1)
_NOWHERE = dict.fromkeys(Spot._fields, np.empty(0)) | {"time": np.empty(0, np.int64)}
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

    def after(self, profiles: Columns) -> "Gathered":
        """Return the sums of the last dive that has absolute profiles; others change nothing."""
        dives, absolute = profiles["dive"], np.isfinite(profiles["common_std"])
        used = usable(profiles["flags"]) & np.isfinite(profiles["velocity"]).all(axis=2)
        used &= ((dives != 0) & absolute)[:, None]
        if not used.any():
            return self
        dive = int(dives[used.any(axis=1)][-1])
        used &= (dives == dive)[:, None]
        cell = (np.maximum(profiles["depth"][used], 0.0) // _CELL).astype(np.int64)
        sums = self.sums if dive == self.dive else np.zeros((0, 3))
        more = max(int(cell.max()) + 1 - len(sums), 0)
        sums = np.vstack([sums, np.zeros((more, 3))])
        np.add.at(sums, cell, np.column_stack([np.ones(cell.size), profiles["velocity"][used]]))
        return Gathered(dive, sums)

    def along(self, mean: PathMean) -> Array | None:
        """Return the mean along the path of the dive's DAC, shape (2,), constant beyond the profiles; None without any."""
        known = np.flatnonzero(self.sums[:, 0])
        if self.dive != mean.dive or known.size == 0:
            return None
        velocity = self.sums[known, 1:] / self.sums[known, :1]
        depth = np.asarray((known + 0.5) * _CELL, np.float64)
        return path_average(mean.depth, mean.weight, depth, velocity)


@dataclass(frozen=True, slots=True, eq=False)
class FlightState:
    """State of the flight-model correction.

    Attributes:
        bias: Flight-model error, from the dives so far.
        gathered: Profiles of the present dive.
        inverted: Profiles of each dive with a DAC along its path, by dive number, as in ``Gathered.along``.
    """

    bias: FlightBias = field(default_factory=FlightBias)
    gathered: Gathered = field(default_factory=Gathered)
    inverted: Mapping[int, Array | None] = field(default_factory=dict)

    def with_profiles(self, block: Block, rows: Indices) -> "FlightState":
        """Return the state after profiles of a block."""
        names = ("dive", "common_std", "depth", "velocity", "flags")
        if not rows.size:
            return self
        gathered = self.gathered.after({name: block.ping[name][rows] for name in names})
        return self if gathered is self.gathered else replace(self, gathered=gathered)

    def with_mean(self, mean: PathMean, corrects: bool) -> tuple["FlightState", PathMean]:
        """Return the state after a DAC, and the DAC, corrected if asked for and earlier dives determine a correction.

        A DAC without fixes or velocity through the water is unchanged.
        """
        if mean.fixes is None:
            return self, mean
        along, bias = self.gathered.along(mean), self.bias
        after = replace(self, inverted={**self.inverted, mean.dive: along})
        if not corrects:
            return after, mean
        # an instrument that is turned would look like a flight model that errs
        dive = dive_mean(mean, np.empty((0, 2)), along if mean.beside_profiles else None)
        after = replace(after, bias=bias.after(dive))
        if not (bias.is_believed or mean.beside_profiles):
            return after, mean
        (share, std), velocity = bias.share, None
        if bias.is_believed:
            error = complex(*share) * complex(*dive.way)
            velocity = mean.velocity[0] - error.real, mean.velocity[1] - error.imag
        else:
            std = np.hypot(share, std)
        # of a way in any direction: the mean of both parts' variances
        flight_std = float(np.hypot(*dive.way)) * math.sqrt(float(np.mean(std**2)))
        return after, replace(mean, corrected=velocity, flight_std=flight_std)

    def correction(self, sizes: Sequence[float]) -> FlightCorrection | None:
        """Return the correction at the end of a log; None if no DAC was corrected.

        Args:
            sizes: Magnitude of the correction of each DAC [m/s].
        """
        if not sizes:
            return None
        (along, across), (along_std, across_std) = (part.tolist() for part in self.bias.share)
        return FlightCorrection(
            tuple(sizes), along, across, along_std, across_std, self.bias.dives, self.bias.evidence
        )


@dataclass(frozen=True, slots=True, eq=False)
class ForecastState:
    """State of the predicted surfacings.

    Attributes:
        between: Positions since the last dive of a log without a DAC so far; None after one.
        model: State after the dives so far; None before the first, as it is large.
        persistence: Baseline prediction, as in the last dive.
        last: Last dive; None before the first.
        pending: Outcome of the last dive, until the next begins, as its DAC may be logged until then.
        outcomes: Outcomes of the dives so far.
        dives: Flight of each dive with known flight.
        local: State of the local correction; None before the first dive.
    """

    between: Between | None = field(default_factory=Between)
    model: ProcessState | None = None
    persistence: Persistence = field(default_factory=Persistence)
    last: Dive | None = None
    pending: DiveOutcome | None = None
    outcomes: tuple[DiveOutcome, ...] = ()
    dives: tuple[FlownDive, ...] = ()
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
    inverted: Mapping[int, Array | None],
) -> ForecastState:
    """Return the state after an event; its outcomes grow where a dive is ended by it.

    Args:
        state: State before it.
        step: Step of a position, an observation, or a DAC that is not assimilated.
        flow_at: Function of the estimate before the event at a time [ns, UTC].
        surface_depth: Depth above which the vehicle is at the surface [m].
        inverted: As in ``FlightState``.
    """
    event, between, backgrounds = step.event, state.between, _UNKNOWN
    mean = event.mean if isinstance(event, Aside) else event
    if isinstance(mean, PathMean):
        if mean is event:
            state, backgrounds = _beside_estimate(state, mean, step), _backgrounds(mean, step)
        return forecast_mean(state, mean, backgrounds, inverted.get(mean.dive))
    if between is None or not isinstance(event, VehicleState | Profiles):
        return state
    detection, end = detect_surfacing(between.detection, event, surface_depth)
    path, ahead, latest = between.path, between.ahead, between.latest
    begins = in_dive(detection) and (end is not None or not in_dive(between.detection))
    if end is not None:
        if path is not None and end.time_ns > path.start.time:
            # a dive's profiles may have waited for the fix after it
            first_ns = int(event["time"][0]) if isinstance(event, Profiles) else event.time_ns
            number = (detection if first_ns <= end.time_ns else between.detection).dive
            number = number or state.known.dives + 1
            state = _scored(state, dive_along(path, end, number, ahead, state.last))
        path = None
    if begins:
        state = forecast_end(state)
        if latest is not None:
            flow = flow_at(latest.time_ns)
            path, ahead = path_from(spot_of(latest)), ahead_of(latest, flow, state.last)
    if isinstance(event, Profiles):
        # its first bin tells the depth where positions have none
        depth = event["depth"][0][np.isfinite(event["depth"][0])]
        if path is not None and not path.reckoned and depth.size:
            path = extended_path(path, _NOWHERE, depth.min(keepdims=True))
    elif not event.dead_reckoned and not event.depth > surface_depth:
        latest = event
    elif path is not None:
        more = {name: np.array([part]) for name, part in spot_of(event)._asdict().items()}
        path = extended_path(path, more, _NOWHERE["depth"])
    return replace(state, between=Between(detection, latest, path, ahead))


def forecast_track(
    state: ForecastState, track: Track, surface_depth: float
) -> ForecastState | None:
    """Return the state after consecutive positions without effect on predictions; None if ``forecast_step`` must process each."""
    if (between := state.between) is None:
        return state
    below = track.columns["dead_reckoned"].any() or (track.columns["depth"] > surface_depth).any()
    if below or in_dive(between.detection):
        return None
    # fixes at the surface between dives
    latest = track[-1]
    detection = replace(between.detection, fix=latest)
    return replace(state, between=replace(between, detection=detection, latest=latest))


def forecast_mean(
    state: ForecastState,
    mean: PathMean,
    backgrounds: Array = _UNKNOWN,
    inverted: Array | None = None,
) -> ForecastState:
    """Return the state after a DAC, with the outcome of its dive; unchanged by a DAC without fixes.

    Args:
        state: State before it.
        mean: The DAC.
        backgrounds: shape (2, 2) [m/s], true east and north, DAC predicted by the prior and by the estimate before the dive; NaN where
            unknown.
        inverted: shape (2,) [m/s], the dive's own profiles along its path; None without any.
    """
    if mean.fixes is None:
        return state
    if not state.states_means:
        # dives without a mean current are known less well
        state = ForecastState(None, outcomes=state.outcomes, local=state.local)
    dive = dive_mean(mean, backgrounds, inverted)
    return forecast_end(_scored(state, Dive(dive, mean.fixes, mean.dive, flown=flown_of(mean))))


def forecast_end(state: ForecastState) -> ForecastState:
    """Return the state with the pending outcome among the others, as at the end of a log with a last dive without a DAC."""
    if state.pending is None:
        return state
    flown = () if state.last is None or state.last.flown is None else (state.last.flown,)
    outcomes, dives = (*state.outcomes, state.pending), (*state.dives, *flown)
    return replace(state, pending=None, outcomes=outcomes, dives=dives)


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


def _placed(state: ForecastState, expected: Mixture, dive: Dive) -> DiveForecast:
    """Return the predicted end of a dive after its first fix."""
    start, seconds = dive.fixes[0], dive.mean.seconds
    longitude, latitude = forecast_place(start, seconds, dive.mean.way + expected.mean)
    cov, radii = seconds**2 * expected.cov, expected.radii(SHARES)
    inner, outer = (ellipse_of(longitude, latitude, cov, radius) for radius in radii)
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
    fix, basis, backgrounds, seconds = last.fixes[1], last.basis, _UNKNOWN, last.mean.seconds
    if state.between is None:
        seconds = usual_seconds(state.outcomes)
    elif flow is None or (at := state.between.latest) is None:
        return None
    else:
        fix, (depths, weight) = Fix(at.time_ns, at.longitude, at.latitude), last.path
        current, basis = predicted_mean(ahead_of(at, flow, last), last, longer * depths, weight)
        backgrounds = current[None]
    seconds *= longer
    coming = replace(
        last.mean,
        time_ns=fix.time_ns + int(0.5e9 * seconds),
        seconds=seconds,
        backgrounds=backgrounds,
        inverted=None,
    )
    dive = Dive(coming, (fix, fix), last.number + 1, basis)
    return _placed(state, state.process.forecast(state.known, coming), dive)


def dive_mean(mean: PathMean, backgrounds: Array, inverted: Array | None = None) -> DiveMean:
    """Return the dive of a DAC with fixes, with its predictions by ensemble and estimate and its own profiles along its path."""
    assert mean.fixes is not None
    start, end = mean.fixes
    (seconds, moved), velocity = over_ground(start, end), np.array(mean.velocity)
    return DiveMean(
        time_ns=(start.time_ns + end.time_ns) // 2,
        seconds=seconds,
        way=moved - velocity,
        velocity=velocity,
        inverted=inverted,
        backgrounds=backgrounds,
    )


def flown_of(mean: PathMean) -> FlownDive | None:
    """Return the flight of a DAC's dive; None for an unknown velocity through the water."""
    if mean.fixes is None:
        return None
    dive, start_ns = dive_mean(mean, _UNKNOWN), mean.fixes[0].time_ns
    about = mean.deepest, start_ns, mean.radius, mean.declination
    return flown_dive(dive.seconds, dive.way, mean.depth, *about)


def _beside_estimate(state: ForecastState, mean: PathMean, step: Step) -> ForecastState:
    """Return the state with the local correction updated by a DAC; unchanged where the estimate does not predict it."""
    innovation, std = step.dive_innovation, step.dive_std
    if std is None or innovation.shape != (1, 2) or not np.isfinite([*innovation, *std]).all():
        return state
    middle_ns = (int(mean.path_time_ns[0]) + mean.time_ns) // 2
    return replace(state, local=local_step(state.local, middle_ns, innovation[0], std[0]))


def _backgrounds(mean: PathMean, step: Step) -> Array:
    """Return the DAC predicted by the prior and by the estimate before the dive, as in ``forecast_mean``."""
    used = None if (found := step.innovation) is None else found.used_current
    if found is None or used is None or not np.any(used):
        return _UNKNOWN
    # the mean on both axes turns local ones to true ones
    turn = complex(*mean.used) / complex(*used)
    each = (found.prior_innovation, step.dive_innovation)
    predicted = np.stack([used - (one[0] if one.shape == (1, 2) else np.nan) for one in each])
    turned = (predicted[:, 0] + 1j * predicted[:, 1]) * turn
    return np.column_stack([turned.real, turned.imag])
