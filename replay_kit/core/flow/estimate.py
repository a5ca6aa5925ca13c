"""The current estimate: an immutable value for planners and analysts.

A flow is a sum over levels of a depth function times a sum of incompressible horizontal functions h,

    f(x, y, z) = sum_j d_j(z) h(x, y) latent[:, j],

so it is divergence-free in the horizontal. The divergent part of the ensemble mean is added as the gradient of a potential, which has the
same functions turned by 90 degrees. Its uncertainty, where it has one, is the covariance P of unknowns x with the weights w = m + x L of
modes (``process.py``), and the representation error: with D x the current at a point and s a factor on all variances,

    std^2 = s (D P D' + error^2).

At unmeasured levels it is at least the error of a regression on measured ones, with the prior covariance of levels C: a few tens of members
determine the vertical structure less surely than their patterns suggest.

    least^2 = s (C_zz - C_zm (C_mm + std_m^2)^-1 C_mz).

Estimates, truths and ensemble members have this one type.
"""

# keeps the signatures in help() short: the names of types, not what they stand for
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array, Indices, Mask
from replay_kit.core.errors import EstimatorError
from replay_kit.core.files.atomic import write_whole
from replay_kit.core.files.paths import as_path
from replay_kit.core.flow.functions import (
    DepthFunctions,
    HorizontalFunctions,
    checked_depth,
    depth_weights,
    over_places,
    with_potential,
)
from replay_kit.core.flow.local import LocalCurrent, Oscillation, SurfaceCurrent
from replay_kit.core.flow.process import Process, Unknowns
from replay_kit.core.geodesy import inside_grid, nearest_node, rotate_to_geographic, to_geographic
from replay_kit.core.grid import Grid
from replay_kit.core.words.text import time_text

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from replay_kit.core.flow.points import Velocities

_LINEAR = DepthFunctions("hat", 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class FlowEstimate:
    """Horizontal flow in a box, with its uncertainty where known.

    Outside the levels the flow of the nearest level continues; outside the grid's horizontal extent it fades to zero. Below the last level
    and outside the extent standard errors are NaN, and so are the velocities of a dataset (``to_xarray``). Points on land have a value too;
    ``grid.wet`` is the land mask.

    Attributes:
        grid: Grid, local frame and land mask; its wet top points are the nodes.
        horizontal: The horizontal functions; M of them.
        depth_functions: Functions of depth that combine the levels.
        latent: shape (M, Z), latent values of the flow.
        modes: shape (M, r), latent values of the modes; r = 0 without uncertainty.
        time_ns: Valid time [ns, UTC]; None when unknown.
        unknowns: Estimate of the unknowns; None for a truth or a member.
        potential: shape (M, Z), latent values of the divergent part; None without one.
        local: Local correction near the vehicle, not included in velocities; None if unknown.
        surface: Surface correction from radars; None without radars.
        about: Further global attributes of its datasets, such as citations and creator.
        span_ns: First and last time of its positions and measurements [ns, UTC]; None when unknown.
    """

    grid: Grid
    horizontal: HorizontalFunctions
    depth_functions: DepthFunctions
    latent: Array
    modes: Array
    time_ns: int | None
    unknowns: Unknowns | None = None
    potential: Array | None = None
    local: LocalCurrent | None = None
    surface: SurfaceCurrent | None = None
    about: Mapping[str, str] = field(default_factory=dict)
    span_ns: tuple[int, int] | None = None

    def __repr__(self) -> str:
        """Return time, region and size as text."""
        holds = (
            "no model of time"
            if self.unknowns is None
            else "constant in time"
            if self.process is None
            else "at(time) gives it for another time"
        )
        if self.unknowns is not None and self.span_ns is not None:
            holds += f", data {' to '.join(map(time_text, self.span_ns))}"
        uncertainty = f"{self.n_modes} modes a level" if self.n_modes else "no uncertainty"
        return f"FlowEstimate for {time_text(self.time_ns)} ({holds}), {uncertainty}\n  {self.grid}"

    def at(self, time_ns: int) -> FlowEstimate:
        """Return the estimate for a time [ns, UTC]; the uncertainty of a changing current grows with time.

        A time before the last observation gives the estimate at that observation. A constant estimate is returned unchanged, with a
        UserWarning outside the span of its data, as its error does not grow.

        Raises:
            EstimatorError: The flow has no model of time, as a truth or a member.
        """
        from replay_kit.core.flow.points import warn_outside

        self.require_model_of_time()
        warn_outside([self], np.array(time_ns), 3)
        if self.process is None:
            return self
        return self.moved(max(time_ns, self.last_observation_ns or time_ns))

    def moved(self, time_ns: int) -> FlowEstimate:
        """Return the flow at a forecast time [ns, UTC]; unknowns of a later time are unchanged."""
        assert self.unknowns is not None
        unknowns = self.unknowns.at(time_ns)
        latent = unknowns.latent(self.modes, time_ns)
        surface = None if self.surface is None else self.surface.at(time_ns)
        return replace(self, latent=latent, time_ns=time_ns, unknowns=unknowns, surface=surface)

    def require_model_of_time(self) -> None:
        """Raise EstimatorError if the flow has no model of time."""
        if self.unknowns is None:
            raise EstimatorError(
                "the flow has no model of time (a truth, a member, a sample, or of an earlier version); "
                "ask the estimate of a replay for another time"
            )

    @property
    def process(self) -> Process | None:
        """Process of the estimate; None if it is constant or has no model of time."""
        if self.unknowns is None:
            return None
        process = self.unknowns.process
        return None if process.is_constant and self.oscillation is None else process

    @property
    def oscillation(self) -> Oscillation | None:
        """Oscillations added to the flow; None without any."""
        return None if self.unknowns is None else self.unknowns.oscillation

    @property
    def last_observation_ns(self) -> int | None:
        """Time before which the estimate does not change [ns, UTC]; None without one."""
        return None if self.process is None or self.unknowns is None else self.unknowns.time_ns

    @property
    def nodes(self) -> Array:
        """Nodes of the grid, shape (N, 2) [m]."""
        return self.grid.nodes

    @property
    def levels(self) -> Array:
        """Levels, shape (Z,) [m]."""
        return self.grid.levels

    @property
    def n_modes(self) -> int:
        """Number of modes of the uncertainty; 0 when the flow has none."""
        return 0 if self.unknowns is None else int(self.modes.shape[1])

    def velocity(
        self, east: ArrayLike, north: ArrayLike, depth: ArrayLike, true_axes: bool = False
    ) -> Array:
        """Return the velocity [m/s] at points of the local frame.

        Args:
            east: [m], any shape; the three broadcast together.
            north: [m].
            depth: [m], positive down.
            true_axes: Whether the components are towards true east and true north, instead of the local frame's.

        Returns:
            Array of the broadcast shape with one more axis of length 2.
        """

        def here(places: Array, at: Indices, depths: Array) -> Array:
            local = with_potential(self.horizontal, places, self.latent, self.potential)
            by_level = self._true(places, local, true_axes)[:, at]
            weights = depth_weights(self.depth_functions, depths, self.levels)
            found = np.einsum("cpz,pz->pc", by_level, weights)
            if self.surface is not None:
                shown = self.surface.between(places[at], depths)
                found += self._true(places[at], shown.T[..., None], true_axes)[..., 0].T
            return np.asarray(found)

        return over_places(here, east, north, depth)

    def standard_error(
        self, east: ArrayLike, north: ArrayLike, depth: ArrayLike, true_axes: bool = False
    ) -> Array:
        """Return the standard deviation [m/s] of each velocity component; arguments and shapes as in ``velocity``.

        NaN outside the grid's outline and below the last level.

        Raises:
            EstimatorError: The flow has no uncertainty.
        """
        variance = self.variance(east, north, depth, true_axes)
        return np.sqrt(np.where(self._is_inside(east, north, depth)[..., None], variance, np.nan))

    def variance(
        self, east: ArrayLike, north: ArrayLike, depth: ArrayLike, true_axes: bool = False
    ) -> Array:
        """Return the square of ``standard_error`` [m^2/s^2], finite also outside the grid's outline and below the last level."""
        self._uncertain()

        def here(places: Array, at: Indices, depths: Array) -> Array:
            rows = self._rows(places, true_axes)
            covariance = rows @ rows.swapaxes(2, 3)
            functions = self._in_functions(depths)
            levels = depth_weights(_LINEAR, depths, self.levels)
            of_flow = np.einsum(
                "pk,cpkl,pl->pc", functions, covariance[:, at], functions, optimize=True
            )
            beside = np.einsum(
                "pz,cpz->pc", levels, self._additional_error(places, covariance)[:, at]
            )
            found = np.maximum(of_flow + beside**2, 0.0)
            shown = self.surface
            return np.asarray(found if shown is None else shown.variance(found, places[at], depths))

        return over_places(here, east, north, depth)

    def velocity_covariance(
        self, east: ArrayLike, north: ArrayLike, depth: ArrayLike, true_axes: bool = False
    ) -> Array:
        """Return the covariance between the velocities at a few points, shape (2P, 2P) [m^2/s^2], all east then all north.

        The representation error is independent between points. NaN outside the grid's outline and below the last level.

        Args:
            east: [m], P values; the three broadcast together.
            north: [m].
            depth: [m], positive down.
            true_axes: See ``velocity``.

        Raises:
            EstimatorError: The flow has no uncertainty.
        """
        self._uncertain("velocity_covariance")
        at = np.broadcast_arrays(east, north, checked_depth(depth))
        points, depths = np.column_stack([axis.ravel() for axis in at[:2]]), at[2].ravel()
        rows = np.einsum("pk,cpkq->qcp", self._in_functions(depths), self._rows(points, true_axes))
        rows[..., ~self._is_inside(points[:, 0], points[:, 1], depths)] = np.nan
        rows = rows.reshape(len(rows), -1)
        return np.asarray(rows.T @ rows)

    def sample(self, n: int, seed: int) -> tuple[FlowEstimate, ...]:
        """Return n random flows from the estimate's Gaussian, without uncertainty; equal seeds give equal flows.

        Raises:
            EstimatorError: The flow has no uncertainty.
        """
        return tuple(flow for (flow,) in self.sample_through([self.time_ns or 0], n, seed))

    def sample_through(
        self, times_ns: Sequence[int], n: int, seed: int
    ) -> tuple[tuple[FlowEstimate, ...], ...]:
        """Return n random currents through time: for each the flows at the times, without uncertainty.

        Unknowns are drawn at the first time and propagated with noise. The currents have the estimate's mean and covariance at every time
        and the process's correlation between times.

        Args:
            times_ns: Times in order [ns, UTC]; unknowns are not propagated before the last observation.
            n: Number of currents.
            seed: Seed of the random numbers.

        Raises:
            EstimatorError: The flow has no uncertainty.
        """
        known = self._uncertain("sample")
        times = [max(time, known.time_ns or time) for time in times_ns]
        mean_flow, dated = self.mean_flow(), self.time_ns is not None
        drawn = [
            [replace(mean_flow, latent=one, time_ns=time_ns if dated else None) for one in latent]
            for time_ns, latent in zip(times, known.draws(self.modes, times, n, seed), strict=True)
        ]
        return tuple(zip(*drawn, strict=True))

    def mean_flow(self) -> FlowEstimate:
        """Return the mean of the modes alone, without uncertainty, model of time and corrections."""
        return replace(self, modes=self.modes[:, :0], unknowns=None, local=None, surface=None)

    @cached_property
    def _factor(self) -> Array:
        """L' F at the flow's time: weights of independent unit unknowns in the vertical functions, shape (r, K, k)."""
        known = self._uncertain()
        loading = known.process.loading(self.time_ns or 0)
        return np.tensordot(np.ascontiguousarray(loading.T), known.root, 1)

    def _rows(self, places: Array, true_axes: bool) -> Array:
        """Return the effect of independent unit unknowns on the amplitudes of the vertical functions, shape (2, P, K, k) [m/s]."""
        modes = self._true(places, self.horizontal.velocity(places, self.modes), true_axes)
        return np.tensordot(modes, self._factor, 1)

    def _in_functions(self, depths: Array) -> Array:
        """Return the vertical functions at depths [m], shape (n, K)."""
        weights = depth_weights(self.depth_functions, depths, self.levels)
        return np.asarray(weights @ self._uncertain().process.functions.T)

    def _additional_error(self, places: Array, covariance: Array) -> Array:
        """Return the error in addition to that of the unknowns at levels and points, shape (2, P, Z) [m/s].

        Args:
            places: shape (P, 2) [m].
            covariance: Covariance of the vertical functions' amplitudes, shape (2, P, K, K) [m^2/s^2].
        """
        unknowns = self._uncertain()
        # of what the unknowns do not hold, that of the nearest node
        variance_of_node = (
            unknowns.scale * unknowns.error[:, nearest_node(self.grid, places, wet=True)] ** 2
        )
        beside = np.stack([variance_of_node.T] * 2)
        seen = unknowns.measured
        if seen is not None and not seen.all():
            functions = unknowns.process.functions
            variance = (
                np.einsum("kz,cpkl,lz->cpz", functions, covariance, functions, optimize=True)
                + beside
            )
            between = unknowns.scale * self._between_levels
            stated = between[np.ix_(seen, seen)] + variance[..., seen, None] * np.eye(seen.sum())
            rows = between[np.ix_(seen, ~seen)]
            explained = np.sum(rows * np.linalg.solve(stated, rows), axis=-2)
            least = np.diag(between)[~seen] - explained
            beside[..., ~seen] += np.maximum(least - variance[..., ~seen], 0.0)
        return np.asarray(np.sqrt(beside))

    @cached_property
    def _between_levels(self) -> Array:
        """Prior covariance of a component between levels at the flow's time, mean over the nodes, shape (Z, Z)."""
        process = self._uncertain().process
        modes = self.horizontal.velocity(self.nodes, self.modes).reshape(-1, self.n_modes)
        gram, loading = modes.T @ modes / len(modes), process.loading(self.time_ns or 0)
        of_functions = np.einsum("kar,rs,kbs->ab", loading, gram, loading, optimize=True)
        return np.asarray(process.functions.T @ of_functions @ process.functions)

    def _true(self, places: Array, rows: Array, true_axes: bool) -> Array:
        """Return components, shape (2, P, n), at points, shape (P, 2), on true axes if requested."""
        if not true_axes:
            return rows
        lon, lat = to_geographic(self.grid.projection, *places.T)
        turned = rotate_to_geographic(self.grid.projection, lon[:, None], lat[:, None], *rows)
        return np.stack(turned)

    def _is_inside(self, east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> Mask:
        """Return whether points lie inside the grid's outline and above the last level."""
        return np.asarray(
            inside_grid(self.grid, east, north) & (np.asarray(depth) <= self.levels[-1])
        )

    def _uncertain(self, what: str = "standard_error") -> Unknowns:
        if self.unknowns is None or not self.n_modes:
            raise EstimatorError(
                f"{what} needs an estimate with a covariance, but this flow (a truth, a member or a sample) has none"
            )
        return self.unknowns

    def velocity_at(
        self, longitude: ArrayLike, latitude: ArrayLike, depth: ArrayLike, time: Any = None
    ) -> Velocities:
        """Return velocity and standard error at points [m/s], true east and north; NaN on land and outside the grid.

        Args:
            longitude: [degrees east], any shape; the four broadcast together.
            latitude: [degrees north].
            depth: [m], positive down.
            time: ISO 8601 text, datetime64 or integer nanoseconds (UTC), as in ``at``; None for the estimate's own time. A constant
                estimate answers for its own time, ``Velocities.estimate_time``, and warns of times outside the span of its data.

        Raises:
            EstimatorError: The flow has no model of time, a time precedes its last observation, a latitude is outside [-90, 90], or a depth
                is negative or not finite.
            ConfigError: The time cannot be parsed.
        """
        from replay_kit.core.flow.points import best_velocity_at

        return best_velocity_at([self], longitude, latitude, depth, time)

    def along(self, track: Any) -> Velocities:
        """Return velocity and standard error along a track, such as ``result.fixes``.

        Args:
            track: pandas table, xarray dataset or mapping with ``longitude``, ``latitude``, ``depth`` and optionally ``time``, of one
                shape. Before the last observation the estimate at that observation is used; a constant estimate, with a warning as in
                ``velocity_at``, and a flow without a model of time hold for their own time: see ``Velocities.estimate_time``. Depths down
                to 1 m above the surface count as 0.

        Raises:
            EstimatorError: A column is missing, a latitude is outside [-90, 90], or a depth is above the surface or not finite.
            ConfigError: A time cannot be parsed.
        """
        from replay_kit.core.flow.points import velocity_along, warn_outside

        found = velocity_along(self, track)
        warn_outside([self], found.time, 3)
        return found

    def to_xarray(
        self,
        longitude: ArrayLike | None = None,
        latitude: ArrayLike | None = None,
        depth: ArrayLike | None = None,
        time: Any = None,
    ) -> xr.Dataset:
        """Return velocity and standard error on a grid as a CF dataset, NaN where dry, for ``.sel`` and plots.

        Given axes and regular grids have one-dimensional coordinates. A curvilinear grid has two-dimensional longitude and latitude on
        ``y`` and ``x``, for which ``.sel`` needs axes.

        Args:
            longitude: shape (I,) [degrees east]; None, with the next two, for the flow's own grid and levels.
            latitude: shape (J,) [degrees north].
            depth: shape (D,) [m], positive down.
            time: As in ``velocity_at``; a list makes ``time`` a dimension, with the valid time ``estimate_time``. None for the estimate's
                own.

        Raises:
            EstimatorError: Only some of the three axes are given, one is not one-dimensional, a depth is negative or not finite, or the
                flow has no model of time.
        """
        from replay_kit.core.flow.dataset import to_dataset

        return to_dataset(self, longitude, latitude, depth, time)

    def to_pandas(self, **axes: ArrayLike) -> pd.DataFrame:
        """Return ``to_xarray(**axes)`` as a table with a row per wet point and time."""
        return self.to_xarray(**axes).to_dataframe().dropna(subset=["u"]).reset_index()

    def save(self, path: str | Path) -> None:
        """Write the flow to NetCDF without loss, completely or not at all; ``replay_kit.open_estimate`` reads it back.

        Raises:
            ConfigError: The file cannot be written.
        """
        from replay_kit.core.flow.file import save_bytes

        write_whole(as_path(path, "estimate"), save_bytes(self))
