"""Measured values as rows of unit noise on the unknowns: one form for all kinds of measurement.

Values at one place see the column of water there: q = 2 K unknowns, the amplitudes of the K vertical functions towards east and north,
which are a sum D x of the estimate's unknowns. The values of a component are v = J a + noise of covariance N, with J the functions at the
values' depths. Whitened by W, W N W' = 1, and compressed by W J = Q R, Q orthonormal, they are the rows R a of unit noise; what is
orthogonal to Q is noise alone and measures how large the noise is. Values relative to a platform of unknown velocity are known up to a
constant: W loses its direction.

Values that are sums over several places, as a mean along a path, are their own column: q is their number, and J is one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import gradient, nearest_node
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.flow.process import Process
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import LinearMeasurement
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.prior.extras import Extras
from replay_kit.estimator.update.grouping import mean_time
from replay_kit.estimator.update.layouts import Layout, Sight, layout_key, layouts_of
from replay_kit.estimator.update.screening import (
    ScreenedGroup,
    local_values,
    relative_velocities,
)

# Between levels the representation error is linear; above and below them that of the nearest holds.
_LINEAR = DepthFunctions("hat", 0.0)
# Layouts that are remembered.
_REMEMBERED = 64
# A measurement, which of its values are used, and the node nearest to it.
_Used = tuple[LinearMeasurement, NDArray[np.bool_], int]


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """Measurements that see one column, n of them.

    Attributes:
        screened: The measurements after screening.
        time_ns: For which they count [ns, UTC].
        design: shape (q, k), D at that time.
        axes: shape (c, a), of each measured component along the column's components.
        layouts: Of each measurement, one object where they are alike.
        about: Of each measurement, shape (m, c) [m/s]: its values less what is known.
    """

    screened: ScreenedGroup
    time_ns: int
    design: Array
    axes: Array
    layouts: tuple[Layout, ...]
    about: tuple[Array, ...]

    def rows(self, i: int) -> Array:
        """Return the rows of a measurement on the column's unknowns, shape (c p, q), component after component."""
        blocks = self.axes[:, None, :, None] * self.layouts[i].r[:, None]
        return blocks.reshape(-1, self.axes.shape[1] * blocks.shape[3])

    def compressed(self, i: int) -> tuple[Array, float, int]:
        """Return a measurement's rows of unit noise, shape (c p,), the square that the compression leaves, and its degrees of freedom."""
        layout = self.layouts[i]
        whitened = layout.whiten @ self.about[i]
        y = layout.q.T @ whitened
        left = float(np.sum(whitened**2) - np.sum(y**2))
        return y.T.ravel(), max(left, 0.0), whitened.size - y.size

    def misfit(self, i: int, column: Array) -> Array:
        """Return measured minus predicted values of a measurement along the column's components, shape (..., m, a) [m/s].

        Args:
            i: Its position.
            column: shape (..., q), the column's unknowns.
        """
        by_component = column.reshape(*column.shape[:-1], self.axes.shape[1], -1)
        layout = self.layouts[i]
        off = self.about[i] - layout.functions @ (self.axes @ by_component).swapaxes(-1, -2)
        return np.asarray(layout.known(off) @ self.axes)

    def predicted_variance(self, i: int, covariance: Array) -> Array:
        """Return the variance of a measurement's values, shape (m, a) [m^2/s^2], for the covariance of the column, shape (q, q)."""
        functions, n = self.layouts[i].known(self.layouts[i].functions), self.axes.shape[1]
        blocks = covariance.reshape(n, -1, n, covariance.shape[0] // n)
        along = np.einsum("ca,akbl,cb->ckl", self.axes, blocks, self.axes)
        variance = np.einsum("mk,ckl,ml->mc", functions, along, functions)
        return np.asarray(np.maximum(variance, 0.0) @ self.axes**2)


# Not slotted: what all measurements need is made once.
@dataclass(frozen=True, eq=False)
class Observer:
    """What makes rows of measurements.

    Attributes:
        basis: Basis flows.
        process: The unknowns.
        representation: shape (Z, N) [m/s], error of what the modes do not hold, at the nodes.
        dropped: shape (Z, N) [m/s], prior standard deviation of what was dropped of what they do.
        potential: shape (M, Z), latent values of the part of the mean with divergence; None without one.
        stated_std: Error of all values [m/s] instead of their own; None for these.
        extras: Unknowns beside those of the process; None without any.
    """

    basis: Basis
    process: Process
    representation: Array
    dropped: Array
    potential: Array | None = None
    stated_std: float | None = None
    extras: Extras | None = None

    @property
    def size(self) -> int:
        """Number of all unknowns k."""
        return self.process.size + (0 if self.extras is None else self.extras.size)

    @property
    def tau(self) -> Array:
        """Decorrelation time of each unknown, shape (k,) [s]; inf for constants."""
        return (
            self.process.tau
            if self.extras is None
            else np.append(self.process.tau, self.extras.tau)
        )

    @cached_property
    def _latents(self) -> Array:
        """Latent values of the flow whose weights are zero, of the potential beside it, and of the modes: a place is looked up once."""
        potential = [] if self.potential is None else [self.potential]
        return np.hstack([self.basis.offset, *potential, self.basis.modes])

    def _parts(self, both: Array) -> tuple[Array, Array]:
        """Return the velocities of the flow whose weights are zero, (2, m, Z), and of the modes, (2, m, r), of those of ``_latents``."""
        n = self.basis.grid.levels.size
        offset, modes = both[..., :n], both[..., both.shape[2] - self.basis.n_modes :]
        if self.potential is not None:
            offset = offset + gradient(both[..., n : 2 * n])
        return offset, modes

    @cached_property
    def _layouts(self) -> dict[Any, Layout]:
        """The last layouts made: along a track they repeat."""
        return {}

    def error(self, scale: float, nodes: Any = slice(None)) -> Array:
        """Return the error of what the unknowns do not hold at some nodes, shape (Z, n) [m/s], under a factor on the prior variance."""
        dropped = np.sqrt(scale) * self.dropped[:, nodes]
        return np.asarray(np.hypot(self.representation[:, nodes], dropped))

    def columns(self, groups: Sequence[ScreenedGroup], scale: float = 1.0) -> list[Column]:
        """Return the columns that groups of measurements see, under a factor on the prior variance; each has a usable value."""
        at_place = [each for each in groups if each.usable_linear[0].at_one_place]
        found = iter(self._at_places(at_place, scale) if at_place else ())
        return [
            next(found) if each.usable_linear[0].at_one_place else self._along_path(each, scale)
            for each in groups
        ]

    def _at_places(self, groups: Sequence[ScreenedGroup], scale: float) -> list[Column]:
        basis, grid = self.basis, self.basis.grid
        middles = np.array([each.middle for each in groups])
        places = np.column_stack(to_local(grid.projection, *middles.T))
        times = np.array([mean_time(each.usable_linear) for each in groups], np.int64)
        offset, modes = self._parts(basis.horizontal.velocity(places, self._latents))
        mean, designs = self.process.project(modes.swapaxes(0, 1), times)
        known = offset.swapaxes(0, 1) + mean  # (n, 2, Z)
        nodes, out = nearest_node(grid, places), []
        each = [
            (linear, used, node)
            for group, node in zip(groups, nodes.tolist(), strict=True)
            for linear, used in zip(group.usable_linear, group.is_used, strict=True)
        ]
        layouts, (measurements, flags, _) = (
            iter(self._layouts_of(each, scale)),
            zip(*each, strict=True),
        )
        values = local_values(measurements, flags, grid.projection)
        for g, group in enumerate(groups):
            own = tuple(islice(layouts, len(group.usable_linear)))
            about, axes = list[Array](), np.eye(2)
            for layout, (value, axes) in zip(own, values, strict=False):
                about.append(value - layout.levels @ known[g].T @ axes.T)
            design = self._with_extras(designs[g], group, int(times[g]))
            out.append(Column(group, int(times[g]), design, axes, own, tuple(about)))
        return out

    def _with_extras(self, design: Array, group: ScreenedGroup, time_ns: int) -> Array:
        """Return the design of a column, shape (q, k), of that of the process, shape (2, K, k')."""
        if self.extras is not None:
            relative = relative_velocities(group.usable_linear, group.is_used, self.basis.grid)
            mean = None if relative is None else relative.mean(axis=0)
            more, (_, n, size) = self.extras.column(time_ns, mean), design.shape
            both = np.zeros((2, n + more.shape[1], size + more.shape[2]))
            both[:, :n, :size], both[:, n:, size:] = design, more
            design = both
        return design.reshape(-1, design.shape[2])

    def _layouts_of(self, some: Sequence[_Used], scale: float) -> list[Layout]:
        """Return the layouts of measurements, under a factor on the prior variance."""
        keys = [(layout_key(linear, used), node, scale) for linear, used, node in some]
        new = {key: one for key, one in zip(keys, some, strict=True) if key not in self._layouts}
        known = {key: self._layouts[key] for key in keys if key not in new}
        if new:
            known |= zip(new, self._made(list(new.values()), scale), strict=True)
        self._layouts.update(known)
        for key in list(self._layouts)[:-_REMEMBERED]:
            del self._layouts[key]
        return [known[key] for key in keys]

    def _made(self, some: Sequence[_Used], scale: float) -> list[Layout]:
        depth = np.concatenate([linear.depth for linear, _, _ in some])
        ends = np.cumsum([linear.depth.size for linear, _, _ in some])[:-1]
        hats = np.split(self.basis.depth_weights(depth), ends)
        between = np.split(depth_weights(_LINEAR, depth, self.basis.grid.levels), ends)
        errors, parts = self.error(scale, [node for _, _, node in some]).T, list[Sight]()
        for i, (linear, used, _) in enumerate(some):
            at = np.flatnonzero(used)
            levels = linear.at_values(hats[i])[at]
            functions = levels @ self.process.functions.T
            if self.extras is not None:
                more = linear.at_values(self.extras.functions(linear.depth))[at]
                functions = np.hstack([functions, more])
            covariance = self._covariance(linear, at, linear.at_values(between[i] @ errors[i])[at])
            parts.append(Sight(levels, functions, covariance, linear.reference == "relative"))
        return layouts_of(parts)

    def _along_path(self, group: ScreenedGroup, scale: float) -> Column:
        (linear,), (used,) = group.usable_linear, group.is_used
        basis, at, grid = self.basis, np.flatnonzero(used), self.basis.grid
        places = np.column_stack(to_local(grid.projection, linear.longitude, linear.latitude))
        levels = basis.depth_weights(linear.depth)
        shares = self.process.shares(_times(linear))
        weights = np.eye(len(places))[at] if linear.weights is None else linear.weights[at]
        # (T m, P Z) sums over the points of each value, by share of each forecast time
        by_time = (shares.T[:, None] * weights).reshape(-1, len(places))
        by_level = (by_time[:, :, None] * levels).swapaxes(1, 2)  # (T m, Z, P)
        flat = by_level.reshape(-1, len(places))
        offset, modes = self._parts(flat @ basis.horizontal.velocity(places, self._latents))
        n, n_levels = len(at), levels.shape[1]
        sums = modes.reshape(2, shares.shape[1], n, n_levels, -1)
        ((values, axes),) = local_values([linear], [used], grid.projection)
        own = np.einsum("ctnzz->cn", offset.reshape(2, shares.shape[1], n, n_levels, n_levels))
        known, design = zip(
            *(
                self.process.project_sums(
                    np.tensordot(axis, sums, 1), np.any(shares, axis=0).astype(np.float64)
                )
                for axis in axes
            ),
            strict=True,
        )
        extra = (
            depth_weights(_LINEAR, linear.depth, grid.levels)
            * self.error(scale, nearest_node(grid, places)).T
        )
        covariance = self._covariance(linear, at, weights @ extra.sum(axis=1))
        about = values - (axes @ own).T - np.array(known).T
        relative = linear.reference == "relative"
        (layout,) = layouts_of([Sight(np.empty((n, 0)), np.eye(n), covariance, relative)])
        rows = np.concatenate(design)
        if self.extras is not None:
            more = axes @ self.extras.sums(weights, linear.depth, _times(linear)).reshape(2, -1)
            rows = np.hstack([rows, more.reshape(len(rows), -1)])
        return Column(group, linear.time_ns, rows, np.eye(len(axes)), (layout,), (about,))

    def _covariance(self, linear: LinearMeasurement, at: NDArray[np.intp], extra: Array) -> Array:
        """Return the error covariance of some values, shape (m, m) [m^2/s^2], with what the unknowns do not hold, shape (m,) [m/s]."""
        if self.stated_std is not None and linear.at_one_place:
            return self.stated_std**2 * np.eye(len(at))
        covariance = linear.covariance(at)
        covariance[np.diag_indices_from(covariance)] += extra**2
        return covariance


def _times(linear: LinearMeasurement) -> NDArray[np.int64]:
    if linear.point_time_ns is not None:
        return linear.point_time_ns
    return np.full(linear.longitude.size, linear.time_ns, np.int64)
