"""Measured values as rows of unit noise on the unknowns: one form for all kinds of measurement.

Values at one place see the column of water there: q = 2 K unknowns, the amplitudes of the K vertical functions towards east and north,
which are a sum D x of the estimate's unknowns. The values of a component are v = J a + noise of covariance N, with J the functions at the
values' depths. Whitened by W, W N W' = 1, and compressed by W J = Q R, Q orthonormal, they are the rows R a of unit noise; what is
orthogonal to Q is noise alone and measures how large the noise is. Values relative to a platform of unknown velocity are known up to a
constant: W loses its direction.

Values that are sums over several places, as a mean along a path, are their own column: q is their number, and J is one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import gradient, nearest_node
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.flow.process import Process
from replay_kit.core.geodesy import to_local
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.prior.extras import Extras
from replay_kit.estimator.update.grouping import mean_longitude, mean_time
from replay_kit.estimator.update.layouts import Layout
from replay_kit.estimator.update.screening import Screened

# Between levels the representation error is linear; above and below them that of the nearest holds.
_LINEAR = DepthFunctions("hat", 0.0)
# Layouts that are remembered.
_REMEMBERED = 64


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """Measurements that see one column, n of them.

    Attributes:
        screened: The measurements.
        time_ns: For which they count [ns, UTC].
        design: shape (q, k), D at that time.
        axes: shape (c, a), of each measured component along the column's components.
        layouts: Of each measurement, one object where they are alike.
        values: Of each measurement, shape (m, c) [m/s].
        about: The same, less what is known.
    """

    screened: tuple[Screened, ...]
    time_ns: int
    design: Array
    axes: Array
    layouts: tuple[Layout, ...]
    values: tuple[Array, ...]
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
        return np.asarray(self.layouts[i].known(self._off(i, column)) @ self.axes)

    def measured(self, i: int, column: Array) -> Array:
        """Return what a measurement tells of the current: the estimate plus its misfit; arguments and shape as in ``misfit``."""
        value, layout = self.values[i], self.layouts[i]
        if layout.unwhiten is not None:
            off = self._off(i, column)
            value = value - off + layout.known(off)
        return np.asarray(value @ self.axes)

    def _off(self, i: int, column: Array) -> Array:
        """Return measured minus predicted values as they are, also where only their differences are known, shape (..., m, c) [m/s]."""
        by_component = column.reshape(*column.shape[:-1], self.axes.shape[1], -1)
        predicted = self.layouts[i].functions @ (self.axes @ by_component).swapaxes(-1, -2)
        return np.asarray(self.about[i] - predicted)

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
        dropped: shape (Z, N) [m/s], prior standard deviation of what was dropped of what the modes hold, at the nodes.
        stated_std: Error of all values [m/s] instead of their own; None for these.
        extras: Unknowns beside those of the process; None without any.
    """

    basis: Basis
    process: Process
    dropped: Array
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
        potential = [] if self.basis.potential is None else [self.basis.potential]
        return np.hstack([self.basis.offset, *potential, self.basis.modes])

    @cached_property
    def _layouts(self) -> dict[Any, Layout]:
        """The last layouts made: along a track they repeat."""
        return {}

    def error(self, scale: float, nodes: Any = slice(None)) -> Array:
        """Return the error of what the unknowns do not hold at nodes, shape (Z, n) or (Z,) [m/s], under a factor on the prior variance."""
        dropped = np.sqrt(scale) * self.dropped[:, nodes]
        return np.asarray(np.hypot(self.basis.representation[:, nodes], dropped))

    def columns(self, groups: Sequence[Sequence[Screened]], scale: float = 1.0) -> list[Column]:
        """Return the columns that groups of measurements see, under a factor on the prior variance; none for one without a usable value."""
        used = [own for group in groups if (own := tuple(each for each in group if each.is_used))]
        at_place = self._at_places([own for own in used if own[0].linear.at_one_place], scale)
        return [
            next(at_place) if own[0].linear.at_one_place else self._along_path(own, scale)
            for own in used
        ]

    def _at_places(self, groups: Sequence[tuple[Screened, ...]], scale: float) -> Iterator[Column]:
        if not groups:
            return
        basis, grid = self.basis, self.basis.grid
        middles = [np.array([each.linear.middle for each in group]) for group in groups]
        each = np.array([(mean_longitude(lon), lat.mean()) for lon, lat in (m.T for m in middles)])
        places = np.column_stack(to_local(grid.projection, *each.T))
        times = np.array([mean_time([one.linear for one in own]) for own in groups], np.int64)
        offset, modes = self._flows(basis.horizontal.velocity(places, self._latents))
        mean, designs = self.process.project(modes.swapaxes(0, 1), times)
        known, nodes = offset.swapaxes(0, 1) + mean, nearest_node(grid, places)  # (n, 2, Z)
        for g, group in enumerate(groups):
            layouts = tuple(self._layout(one, int(nodes[g]), scale) for one in group)
            values, axes = zip(*(one.local() for one in group), strict=True)
            about = tuple(
                value - layout.levels @ known[g].T @ axes[0].T
                for value, layout in zip(values, layouts, strict=True)
            )
            design, time_ns = designs[g], int(times[g])
            if self.extras is not None:
                stated = [v for one in group if (v := one.relative_velocity()) is not None]
                relative = np.mean(stated, axis=0) if stated else None
                design = _beside(design, self.extras.column(time_ns, relative))
            design = design.reshape(-1, self.size)
            yield Column(group, time_ns, design, axes[0], layouts, values, about)

    def _flows(self, both: Array) -> tuple[Array, Array]:
        """Return the flow whose weights are zero, shape (2, n, Z), and the modes, shape (2, n, r), of the velocities of ``_latents``."""
        n = self.basis.grid.levels.size
        offset, modes = both[..., :n], both[..., both.shape[2] - self.basis.n_modes :]
        if self.basis.potential is not None:
            offset = offset + gradient(both[..., n : 2 * n])
        return offset, modes

    def _layout(self, one: Screened, node: int, scale: float) -> Layout:
        """Return the layout of a measurement at one place near a node, under a factor on the prior variance."""
        linear, used, held = one.linear, one.used, self._layouts
        arrays = linear.depth, linear.weights, linear.error_std, linear.correlation, used
        parts = (None if each is None else each.tobytes() for each in arrays)
        key = (linear.common_std, linear.correlation_depth, node, scale, *parts)
        if key not in held:
            levels = linear.at_values(self.basis.depth_weights(linear.depth))[used]
            functions = levels @ self.process.functions.T
            if self.extras is not None:
                more = linear.at_values(self.extras.functions(linear.depth))[used]
                functions = np.hstack([functions, more])
            between = depth_weights(_LINEAR, linear.depth, self.basis.grid.levels)
            error = linear.at_values(between @ self.error(scale, node))[used]
            covariance = self._covariance(one, error)
            if len(held) >= _REMEMBERED:
                del held[next(iter(held))]
            held[key] = Layout.of(levels, functions, covariance, linear.reference == "relative")
        return held[key]

    def _along_path(self, own: tuple[Screened, ...], scale: float) -> Column:
        basis, grid, linear = self.basis, self.basis.grid, own[0].linear
        places = np.column_stack(to_local(grid.projection, linear.longitude, linear.latitude))
        levels, times = basis.depth_weights(linear.depth), linear.point_time_ns
        if times is None:
            times = np.full(len(places), linear.time_ns, np.int64)
        shares = self.process.shares(times)
        weights = (np.eye(len(places)) if linear.weights is None else linear.weights)[own[0].used]
        # (T m, P Z) sums over the points of each value, by share of each forecast time
        by_time = (shares.T[:, None] * weights).reshape(-1, len(places))
        by_level = (by_time[:, :, None] * levels).swapaxes(1, 2)  # (T m, Z, P)
        flat = by_level.reshape(-1, len(places))
        offset, modes = self._flows(flat @ basis.horizontal.velocity(places, self._latents))
        n, n_levels = len(weights), levels.shape[1]
        sums = modes.reshape(2, shares.shape[1], n, n_levels, -1)
        known = np.einsum("ctnzz->cn", offset.reshape(*sums.shape[:4], n_levels))
        (values, axes), used = own[0].local(), np.any(shares, axis=0).astype(np.float64)
        mean, rows = zip(
            *(self.process.project_sums(np.tensordot(axis, sums, 1), used) for axis in axes),
            strict=True,
        )
        between = depth_weights(_LINEAR, linear.depth, grid.levels)
        extra = np.sum(between * self.error(scale, nearest_node(grid, places)).T, axis=1)
        covariance = self._covariance(own[0], weights @ extra)
        relative = linear.reference == "relative"
        layout = Layout.of(np.empty((n, 0)), np.eye(n), covariance, relative)
        design = np.concatenate(rows)
        if self.extras is not None:
            more = np.tensordot(axes, self.extras.sums(weights, linear.depth, times), 1)
            design = np.hstack([design, more.reshape(len(design), -1)])
        about = values - (axes @ known).T - np.array(mean).T
        return Column(
            own, linear.time_ns, design, np.eye(len(axes)), (layout,), (values,), (about,)
        )

    def _covariance(self, one: Screened, extra: Array) -> Array:
        """Return the error covariance of the used values, shape (m, m) [m^2/s^2], with what the unknowns do not hold, shape (m,) [m/s]."""
        if self.stated_std is not None and one.linear.at_one_place:
            return self.stated_std**2 * np.eye(extra.size)
        return one.linear.covariance(np.flatnonzero(one.used)) + np.diag(extra**2)


def _beside(design: Array, more: Array) -> Array:
    """Return designs of other functions and unknowns one beside the other, of shapes (2, K, k): block-diagonal in both."""
    (_, n, size), (_, n_more, size_more) = design.shape, more.shape
    both = np.zeros((2, n + n_more, size + size_more))
    both[:, :n, :size], both[:, n:, size:] = design, more
    return both
