"""Track of the vehicle, and measurements along it with the estimate at their time: bins of profiles, mean currents of dives."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Times
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.results.innovations import Measured, thinned
from replay_kit.results.views.current import EstimateHistory

# Times and depths of a section without profiles.
_SECTION = 160, 40


class Track(NamedTuple):
    """Positions of the vehicle through time; all arrays have the shape (n,).

    Attributes:
        time_ns: [ns, UTC], increasing.
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down; NaN when unknown.
        east: [m], local frame.
        north: [m], local frame.
        distance: Distance along the track [m].
        dead_reckoned: Whether a position was dead-reckoned.
    """

    time_ns: Times
    longitude: Array
    latitude: Array
    depth: Array
    east: Array
    north: Array
    distance: Array
    dead_reckoned: NDArray[np.bool_]

    def at(self, time_ns: Times) -> tuple[Array, Array, Array]:
        """Return east, north and distance along the track [m], interpolated at times; NaN without positions."""
        if self.time_ns.size == 0:
            nothing = np.full(np.shape(time_ns), np.nan)
            return nothing, nothing, nothing
        # of differences, as nanoseconds since 1970 exceed what a float64 holds
        asked, seconds = ((each - self.time_ns[0]) / 1e9 for each in (time_ns, self.time_ns))
        held = self.east, self.north, self.distance
        east, north, distance = (np.interp(asked, seconds, values) for values in held)
        return east, north, distance


def track_of(fixes: pd.DataFrame, projection: Projection) -> Track:
    """Return the track of the fixes of a result.

    Args:
        fixes: ``Result.fixes``.
        projection: The local frame.
    """
    table = fixes.sort_index(kind="stable")
    longitude, latitude, depth = (
        table[name].to_numpy(np.float64) for name in ("longitude", "latitude", "depth")
    )
    east, north = to_local(projection, longitude, latitude)
    reckoned, far = table["dead_reckoned"].to_numpy(bool), distance_along(east, north)
    return Track(times_in(table), longitude, latitude, depth, east, north, far, reckoned)


def times_in(table: pd.DataFrame) -> Times:
    """Return the times of a table of a result [ns, UTC]."""
    return np.asarray(table.index.to_numpy("datetime64[ns]").astype(np.int64))


def distance_along(east: Array, north: Array) -> Array:
    """Return the distance along a track since its first position [m]."""
    steps = np.hypot(np.diff(east), np.diff(north))
    return np.concatenate([np.zeros(min(1, east.size)), np.cumsum(steps)])


class BinsAlongTrack(NamedTuple):
    """Used bins of profiles along a track, one row each.

    Attributes:
        time_ns: [ns, UTC].
        distance: Distance along the track [m].
        depth: [m], positive down.
        values: Components along local east and north, shape (n, 2) [m/s], NaN if unknown: ``measured``; ``replayed``, the estimate before
            smoothing, and ``before``, measured minus it; ``estimated``, after the update, and ``residual``, measured minus it; ``error``,
            the standard error of the last estimate.
        profiles: Number of profiles.
        left_out: Number of omitted profiles.
    """

    time_ns: Times
    distance: Array
    depth: Array
    values: Mapping[str, Array]
    profiles: int
    left_out: int


def bins_along_track(
    measured: Measured, track: Track, history: EstimateHistory, most: int
) -> BinsAlongTrack:
    """Return the used bins of the profiles of a result along its track.

    Args:
        measured: Measurements of the result.
        track: Track of the result.
        history: History of its estimate.
        most: Largest number of profiles.
    """
    observations, bins, estimate = measured.observations, measured.innovations, history.estimate
    of_profiles = observations["mean_current_kind"].isna()
    wanted = np.flatnonzero((observations["dof"] > 0) & of_profiles)
    kept = wanted[thinned(wanted.size, most)]
    used = bins[bins["observation"].isin(kept) & bins["residual_east"].notna()]
    time_ns, depth = times_in(used), used["depth"].to_numpy(np.float64)
    east, north, distance = track.at(time_ns)
    residual, off = (vector_column(used, name) for name in ("residual", "replayed_residual"))
    # where it is not stated what was measured, by the published unknowns
    estimated = vector_column(used, "measured") - residual
    if not np.isfinite(estimated).any():
        estimated = _estimated(history, time_ns, (east, north, depth))
    error = np.full(residual.shape, np.nan)
    if estimate is not None and estimate.n_modes and depth.size and np.isfinite(east).all():
        error = estimate.standard_error(east, north, depth)
    values = _values(estimated, residual, off, error)
    return BinsAlongTrack(
        time_ns, distance, depth, values, kept.size, measured.profiles - kept.size
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
    columns, rows = _SECTION
    deepest = np.fmin(np.nanmax(track.depth, initial=estimate.levels[0]), estimate.levels[-1])
    times = np.unique(np.linspace(track.time_ns[0], track.time_ns[-1], columns).astype(np.int64))
    time_ns = np.repeat(times, rows)
    depth = np.tile(deepest * (np.arange(rows) + 0.5) / rows, times.size)
    east, north, distance = track.at(time_ns)
    estimated = _estimated(history, time_ns, (east, north, depth))
    none = error = np.full(estimated.shape, np.nan)
    if estimate.n_modes:
        error = estimate.standard_error(east, north, depth)
        # the flow is 0 far outside its region and on land, which is no estimate
        estimated[np.isnan(error)] = np.nan
    known = bool(np.isfinite(estimated).any() or np.isfinite(error).any())
    part = slice(None if known else 0)
    values = _values(*(each[part] for each in (estimated, none, none, error)))
    return BinsAlongTrack(time_ns[part], distance[part], depth[part], values, times.size * known, 0)


def _values(estimated: Array, residual: Array, off: Array, error: Array) -> dict[str, Array]:
    """Return the quantities of bins; ``off`` is measured minus the estimate before smoothing."""
    measured = estimated + residual
    found = {"measured": measured, "replayed": measured - off, "estimated": estimated}
    return found | {"before": measured - (measured - off), "residual": residual, "error": error}


def mean_currents(held: Measured) -> pd.DataFrame:
    """Return the rows of ``Result.observations`` that are DACs used, with the standard deviations of their innovations."""
    rows, bins = held.observations, held.innovations.set_index("observation")
    number = np.flatnonzero((rows["mean_current_kind"] == "dac") & (rows["dof"] > 0))
    std = {f"innovation_std_{end}": bins[f"innovation_std_{end}"] for end in ("east", "north")}
    return rows.iloc[number].assign(**{k: v.loc[number].to_numpy() for k, v in std.items()})


def vector_column(table: pd.DataFrame, name: str) -> Array:
    """Return the components of a column of a table, shape (n, 2)."""
    return np.asarray(table[[f"{name}_east", f"{name}_north"]].to_numpy(np.float64))


def _estimated(
    history: EstimateHistory, time_ns: Times, places: tuple[Array, Array, Array]
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
