"""Measurements along the track with the estimate at their time: bins of profiles, and mean currents of dives."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.results.innovations import Measured
from replay_kit.results.plans import thinned
from replay_kit.results.views.history import EstimateHistory
from replay_kit.results.views.track import Track

# Times and depths of a section without profiles.
_SECTION = 160, 40


@dataclass(frozen=True, slots=True, eq=False)
class BinsAlongTrack:
    """Used bins of profiles along a track; all arrays have one row per bin.

    Attributes:
        time_ns: [ns, UTC].
        distance: Distance along the track [m].
        depth: [m], positive down.
        estimated: shape (n, 2) [m/s], local east and north, after the update; NaN without one.
        residual: shape (n, 2) [m/s], measured minus estimated.
        replayed: shape (n, 2) [m/s], before smoothing; NaN without.
        standard_error: shape (n, 2) [m/s], of the last estimate; NaN without one.
        profiles: Number of profiles.
        left_out: Number of omitted profiles.
    """

    time_ns: NDArray[np.int64]
    distance: Array
    depth: Array
    estimated: Array
    residual: Array
    replayed: Array
    standard_error: Array
    profiles: int
    left_out: int


@dataclass(frozen=True, slots=True, eq=False)
class MeanCurrents:
    """Mean currents of dives and the estimate, one row per dive.

    Attributes:
        time_ns: End of the dive [ns, UTC].
        dive: Number of the dive.
        measured: shape (n, 2) [m/s], east and north; NaN if unknown.
        corrected: shape (n, 2) [m/s], for the flight-model error; NaN if not.
        estimated: shape (n, 2) [m/s], mean of the updated estimate along the dive.
        residual: shape (n, 2) [m/s], corrected, or else measured, minus estimated.
        standard_error: shape (n, 2) [m/s], of the innovation.
        errors: shape (n, 3) [m/s], of these three.
    """

    time_ns: NDArray[np.int64]
    dive: NDArray[np.int64]
    measured: Array
    corrected: Array
    estimated: Array
    residual: Array
    standard_error: Array
    errors: Array


def bins_along_track(
    measured: Measured,
    track: Track,
    history: EstimateHistory,
    estimate: FlowEstimate | None,
    most: int,
) -> BinsAlongTrack:
    """Return the used bins of the profiles of a result along its track.

    Args:
        measured: Measurements of the result.
        track: Track of the result.
        history: History of its estimate.
        estimate: The last estimate, for the standard error; None for none.
        most: Largest number of profiles.
    """
    observations, bins = measured.observations, measured.innovations
    of_profiles = observations["mean_current_kind"].isna()
    wanted = np.flatnonzero((observations["dof"] > 0) & of_profiles)
    kept = wanted[thinned(wanted.size, most)]
    used = bins[
        bins["observation"].isin(kept) & np.isfinite(bins["residual_east"].to_numpy(np.float64))
    ]
    time_ns = used.index.to_numpy().astype("datetime64[ns]").astype(np.int64)
    east, north, distance = track.at(time_ns)
    depth, residual = used["depth"].to_numpy(np.float64), _pairs(used, "residual")
    # where it is not stated what was measured, by the published unknowns
    estimated = _pairs(used, "measured") - residual
    if not np.isfinite(estimated).any():
        estimated = _estimated(history, time_ns, (east, north, depth))
    error = np.full((depth.size, 2), np.nan)
    if estimate is not None and estimate.n_modes and depth.size and np.isfinite(east).all():
        error = estimate.standard_error(east, north, depth)
    # measured minus the residual before smoothing
    replayed = estimated + residual - _pairs(used, "replayed_residual")
    return BinsAlongTrack(
        time_ns,
        distance,
        depth,
        estimated,
        residual,
        replayed,
        error,
        kept.size,
        measured.profiles - kept.size,
    )


def estimate_along_track(
    track: Track, history: EstimateHistory, estimate: FlowEstimate
) -> BinsAlongTrack:
    """Return the estimate along a track without profiles, down to the deepest position, as bins without measurements.

    A track outside the region of the estimate has no bins.

    Args:
        track: At least one position.
        history: History of the estimate.
        estimate: The last estimate.
    """
    deepest = np.fmin(np.nanmax(track.depth, initial=estimate.levels[0]), estimate.levels[-1])
    times = np.unique(
        np.linspace(track.time_ns[0], track.time_ns[-1], _SECTION[0]).astype(np.int64)
    )
    depths = deepest * (np.arange(_SECTION[1]) + 0.5) / _SECTION[1]
    time_ns, depth = np.repeat(times, depths.size), np.tile(depths, times.size)
    east, north, distance = track.at(time_ns)
    estimated = _estimated(history, time_ns, (east, north, depth))
    none = error = np.full(estimated.shape, np.nan)
    if estimate.n_modes:
        error = estimate.standard_error(east, north, depth)
        # the flow is 0 far outside its region and on land, which is no estimate
        estimated[np.isnan(error)] = np.nan
    known = bool(np.isfinite(estimated).any() or np.isfinite(error).any())
    rows = slice(None if known else 0)
    return BinsAlongTrack(
        time_ns[rows],
        distance[rows],
        depth[rows],
        estimated[rows],
        none[rows],
        none[rows],
        error[rows],
        times.size * known,
        left_out=0,
    )


def mean_currents(held: Measured) -> MeanCurrents:
    """Return the mean currents of the dives of a result with those of its estimate."""
    observations, bins = held.observations, held.innovations
    of_dive = observations["mean_current_kind"] == "dac"
    rows = np.flatnonzero(of_dive & (observations["dof"] > 0))
    values = bins.set_index("observation").loc[rows]
    dive = observations["dive"].to_numpy(np.int64)[rows]
    end = observations.index.to_numpy().astype("datetime64[ns]").astype(np.int64)[rows]
    residual, error = (_pairs(values, name) for name in ("residual", "innovation_std"))
    means = observations.iloc[rows]
    measured, corrected = (
        _pairs(means, f"mean_current_{name}") for name in ("measured", "corrected")
    )
    stated = [
        f"mean_current_{name}_standard_error" for name in ("measured", "corrected", "estimated")
    ]
    errors = means[stated].to_numpy(np.float64)
    used = np.where(np.isfinite(corrected), corrected, measured)
    return MeanCurrents(end, dive, measured, corrected, used - residual, residual, error, errors)


def _pairs(table: pd.DataFrame, name: str) -> Array:
    """Return the components of a column of a table, shape (n, 2)."""
    return np.asarray(table[[f"{name}_east", f"{name}_north"]].to_numpy(np.float64))


def _estimated(
    history: EstimateHistory, time_ns: NDArray[np.int64], places: tuple[Array, Array, Array]
) -> Array:
    """Return the estimate at its time at local east, north and depth [m], shape (n, 2) [m/s]; NaN before the first measurement."""
    out = np.full((time_ns.size, 2), np.nan)
    times, which = np.unique(time_ns, return_inverse=True)
    for k, flow in enumerate(history.after(times)):
        if flow is not None:
            here = np.flatnonzero(which == k)
            east, north, depth = (values[here] for values in places)
            out[here] = flow.velocity(east, north, depth)
    return out
