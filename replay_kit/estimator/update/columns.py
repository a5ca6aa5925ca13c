"""Measurements as rows of unit noise on the unknowns, one form for all kinds.

Values at one position observe the water column there: q = 2 K unknowns, the amplitudes of the K vertical functions towards east and north,
which are D x of the estimate's unknowns. The values of a component are v = J a + noise of covariance N, with J the functions at the values'
depths. Whitened by W, W N W' = 1, and compressed by W J = Q R, Q orthonormal, they are the rows R a of unit noise; the part orthogonal to Q
is noise alone and shows its size. Values relative to a platform of unknown velocity are known up to a constant, which W projects out.

Sums over several positions, such as a mean along a path, are their own column: q is their number, and J is one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dtrtri

from replay_kit.core.arrays import Array, Indices
from replay_kit.core.flow.functions import DepthFunctions, depth_weights, gradient
from replay_kit.core.flow.process import Process
from replay_kit.core.geodesy import nearest_node, to_local
from replay_kit.core.observation import error_covariance, mean_longitude, mean_time
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.prior.extras import Extras
from replay_kit.estimator.state import AS_STATED, Revised
from replay_kit.estimator.update.screening import Screened

# Between levels the representation error is linear; above and below them that of the nearest holds.
_LINEAR = DepthFunctions("hat", 0.0)
# Layouts that are remembered.
_REMEMBERED = 64


# Share of the largest singular value of W J below which one is rounding.
_ROUNDING = 1e-10
# Values beyond the functions of depth from which on the correlation of neighbours is looked at, its standard deviations by chance, and the
# most of it that counts.
_LEAST_LEFT, _CHANCE, _MOST_ALIKE = 16, 4.3, 0.995


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Observation of a column by the used values of a measurement, common to equal depths and errors.

    Attributes:
        levels: shape (m, Z), functions of the levels at the values' depths; (m, 0) for sums over several positions.
        functions: shape (m, K), J for one component.
        whiten: shape (w, m), W.
        q: shape (w, p), Q.
        r: shape (p, K), R.
        std: shape (m,) [m/s], error of each value with representation error.
        half_log_det: Half the log determinant of N.
        unwhiten: shape (m, w), for values known up to a constant; None for others.
        shared: Variance of the representation error over that of a level's mean without it, mean over levels.
    """

    levels: Array
    functions: Array
    whiten: Array
    q: Array
    r: Array
    std: Array
    half_log_det: float
    unwhiten: Array | None = None
    shared: float = 0.0

    def known(self, values: Array) -> Array:
        """Return the known part of values, shape (..., m, n): for relative ones without a constant."""
        return values if self.unwhiten is None else self.unwhiten @ (self.whiten @ values)

    @staticmethod
    def of(
        levels: Array, functions: Array, covariance: Array, is_relative: bool, shared: float = 0.0
    ) -> "Layout":
        """Return the layout of levels, functions, and N, shape (m, m) [m^2/s^2], without an infinite common error.

        Raises:
            numpy.linalg.LinAlgError: A covariance is not positive definite.
        """
        lower = np.asarray(np.linalg.cholesky(covariance))
        whiten, std, unwhiten = dtrtri(lower, lower=1)[0], np.sqrt(np.diag(covariance)), None
        half_log_det = float(np.log(np.diag(lower)).sum())
        if is_relative:
            ones = whiten.sum(axis=1)
            half_log_det += 0.5 * float(np.log(ones @ ones))
            complement = np.linalg.qr(ones[:, None], mode="complete")[0][:, 1:]
            whiten, unwhiten = complement.T @ whiten, lower @ complement
            std = np.sqrt(np.sum(unwhiten**2, axis=1))
        # functions may depend on each other, as levels' do on the constant: no row may be made of rounding
        q, size, along = np.linalg.svd(whiten @ functions, full_matrices=False)
        kept = size > _ROUNDING * size.max(initial=0.0)
        r = size[kept, None] * along[kept]
        return Layout(levels, functions, whiten, q[:, kept], r, std, half_log_det, unwhiten, shared)


class Part(NamedTuple):
    """n measurements of a column with equal layout.

    Attributes:
        layout: Layout.
        at: shape (n,), indices among the column's measurements.
        used: shape (m',), indices of used values.
        about: shape (n, m', c) [m/s], values minus the flow for zero unknowns.
    """

    layout: Layout
    at: Indices
    used: Indices
    about: Array


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """n measurements of one column, m values each.

    Attributes:
        screened: Measurements, including unused ones.
        at: shape (n,), indices of those used.
        time_ns: Time at which they count [ns, UTC].
        design: shape (q, k), D at that time.
        axes: shape (c, a), measured components along the column's components.
        parts: Measurements by layout.
        node: Node near its position, or the middle of the path of a mean; None of several sums along a path.
    """

    screened: Screened
    at: Indices
    time_ns: int
    design: Array
    axes: Array
    parts: tuple[Part, ...]
    node: int | None = None

    @property
    def shared(self) -> Array:
        """``shared`` of each measurement, shape (n,)."""
        out = np.empty(len(self.at))
        for part in self.parts:
            out[part.at] = part.layout.shared
        return out

    def rows(self, part: Part) -> Array:
        """Return the rows of a measurement on the column's unknowns, shape (c p, q), by component."""
        blocks = self.axes[:, None, :, None] * part.layout.r[:, None]
        return blocks.reshape(-1, self.axes.shape[1] * blocks.shape[3])

    @staticmethod
    def compressed(part: Part) -> tuple[Array, Array, int, Array]:
        """Return rows of unit noise, shape (n, c p), residual squares of the compression, their degrees of freedom, ``_persistence``."""
        whitened, q = part.layout.whiten @ part.about, part.layout.q
        held = q.T @ whitened
        y = held.swapaxes(1, 2).reshape(len(whitened), -1)
        left, number = np.sum(whitened**2, axis=(1, 2)) - np.sum(y**2, axis=1), whitened[0].size
        number -= y.shape[1]
        factors = np.ones(len(y))
        if number >= _LEAST_LEFT:
            factors = _persistence(whitened - q @ held, number)
        return y, np.maximum(left, 0.0), number, factors

    def misfit(self, column: Array) -> Array:
        """Return measured minus predicted values along the column's components, shape (..., n, m, a) [m/s]; NaN where not used.

        Args:
            column: shape (..., q), unknowns of the column.
        """
        known = [
            part.layout.known(self._differences(part, column)) @ self.axes for part in self.parts
        ]
        return self._to_all_values(known, column.shape[:-1])

    def measured(self, column: Array) -> Array:
        """Return the measured current: estimate plus innovation; argument and shape as in ``misfit``."""
        values, each = self.screened.local(self.at)[0], list[Array]()
        for part in self.parts:
            value = values[part.at][:, part.used]
            if part.layout.unwhiten is not None:
                off = self._differences(part, column)
                value = value - off + part.layout.known(off)
            each.append(value @ self.axes)
        return self._to_all_values(each)

    def _differences(self, part: Part, column: Array) -> Array:
        """Return measured minus predicted values, including an unknown constant of relative ones, shape (..., n, m', c) [m/s]."""
        by_component = column.reshape(*column.shape[:-1], self.axes.shape[1], -1)
        predicted = (self.axes @ by_component).swapaxes(-1, -2)[..., None, :, :]
        return np.asarray(part.about - part.layout.functions @ predicted)

    def predicted_variance(self, covariance: Array) -> Array:
        """Return the variance of values, shape (n, m, a) [m^2/s^2], given that of the column, shape (q, q); NaN where not used."""
        n = self.axes.shape[1]
        blocks = covariance.reshape(n, -1, n, covariance.shape[0] // n)
        along = np.einsum("ca,akbl,cb->ckl", self.axes, blocks, self.axes)
        each = list[Array]()
        for layout, *_ in self.parts:
            functions = layout.known(layout.functions)
            variance = np.sum((functions @ along) * functions, axis=2).T
            each.append(np.maximum(variance, 0.0) @ self.axes**2)
        return self._to_all_values(each)

    def stated_variance(self) -> Array:
        """Return the error variance of values, shape (n, m, a) [m^2/s^2]; NaN where not used."""
        noise = np.sum(self.axes**2, axis=0)
        return self._to_all_values([np.outer(layout.std**2, noise) for layout, *_ in self.parts])

    def _to_all_values(self, each: Sequence[Array], first: tuple[int, ...] = ()) -> Array:
        """Return values of the parts, shape (..., m', a) or (..., n, m', a), in the order of all values."""
        # one component of sums along a path stands for both
        out = np.full((*first, len(self.at), self.screened.flags.shape[1], 2), np.nan)
        for part, values in zip(self.parts, each, strict=True):
            out[..., part.at[:, None], part.used, :] = values
        return out


def _persistence(left: Array, number: int) -> Array:
    """Return the factor on error variances of errors that persist from bin to bin, though stated as independent, shape (n,).

    With r the correlation of neighbours, a slow variation has (1 + r) / (1 - r) times the variance (AR(1)); 1 where r may be chance.

    Args:
        left: shape (n, w, c), what the functions of depth leave of whitened values.
        number: Its degrees of freedom.
    """
    products = np.sum(left[:, 1:] * left[:, :-1], axis=(1, 2))
    r = products / np.maximum(np.sum(left**2, axis=(1, 2)), 1e-300)
    slow = (1.0 + r) / (1.0 - np.minimum(r, _MOST_ALIKE))
    return np.where(r > _CHANCE / np.sqrt(number), slow, 1.0)


# Not slotted: what all measurements need is made once.
@dataclass(frozen=True, eq=False)
class Observer:
    """Observation operator: rows of unit noise from measurements.

    Attributes:
        basis: Basis flows.
        process: Process of the unknowns.
        dropped: shape (Z, N) [m/s], prior standard deviation of dropped directions of the modes, at the nodes.
        stated_std: Common error of all values [m/s]; None for their own.
        extras: Further unknowns; None without any.
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
        """Latent values of the flow for zero weights, the potential and the modes, joined for one evaluation per position."""
        potential = [] if self.basis.potential is None else [self.basis.potential]
        return np.hstack([self.basis.offset, *potential, self.basis.modes])

    @cached_property
    def _layouts(self) -> dict[Any, Layout]:
        """Cache of layouts, which repeat along a track."""
        return {}

    def error(self, scale: float, nodes: Any = slice(None)) -> Array:
        """Return the representation error at nodes, shape (Z, n) or (Z,) [m/s], under a factor on the prior variance."""
        dropped = np.sqrt(scale) * self.dropped[:, nodes]
        return np.asarray(np.hypot(self.basis.representation[:, nodes], dropped))

    def columns(self, groups: Sequence[Screened], revised: Revised = AS_STATED) -> list[Column]:
        """Return the columns observed by groups of measurements with revised errors; none for unusable groups."""
        used = [group for group in groups if group.is_used]
        at_place = self._at_places([group for group in used if group.at_one_place], revised)
        return [
            next(at_place) if group.at_one_place else self._along_path(group, revised)
            for group in used
        ]

    def _at_places(self, groups: Sequence[Screened], revised: Revised) -> Iterator[Column]:
        if not groups:
            return
        basis, grid, ats = self.basis, self.basis.grid, [group.at for group in groups]
        rows = [(group.columns, at) for group, at in zip(groups, ats, strict=True)]
        longitude = [mean_longitude(columns["longitude"][at]) for columns, at in rows]
        latitude = [columns["latitude"][at].mean() for columns, at in rows]
        places = np.column_stack(to_local(grid.projection, np.array(longitude), np.array(latitude)))
        times = np.array([mean_time(columns["time"][at]) for columns, at in rows], np.int64)
        offset, modes = self._flows(basis.horizontal.velocity(places, self._latents))
        mean, designs = self.process.project(modes.swapaxes(0, 1), times)
        known = offset.swapaxes(0, 1) + mean  # (n, 2, Z)
        nodes = nearest_node(grid, places, wet=True)
        for g, (group, at) in enumerate(zip(groups, ats, strict=True)):
            values, axes = group.local(at)
            parts = list[Part]()
            for layout, members in self._layouts_of(group, at, int(nodes[g]), revised):
                used = np.flatnonzero(group.used[at[members[0]]])
                about = values[members][:, used] - layout.levels @ known[g].T @ axes.T
                parts.append(Part(layout, members, used, about))
            design, time_ns = designs[g], int(times[g])
            if self.extras is not None:
                more = self.extras.column(time_ns, group.relative_velocity())
                design = _block_diagonal(design, more)
            design = design.reshape(-1, self.size)
            yield Column(group, at, time_ns, design, axes, tuple(parts), int(nodes[g]))

    def _flows(self, both: Array) -> tuple[Array, Array]:
        """Return the flow for zero weights, shape (2, n, Z), and the modes, shape (2, n, r), from velocities of ``_latents``."""
        n = self.basis.grid.levels.size
        offset, modes = both[..., :n], both[..., both.shape[2] - self.basis.n_modes :]
        if self.basis.potential is not None:
            offset = offset + gradient(both[..., n : 2 * n])
        return offset, modes

    def _layouts_of(
        self, group: Screened, at: Indices, node: int, revised: Revised
    ) -> Iterator[tuple[Layout, Indices]]:
        """Yield the layouts of measurements at one position near a node, each with its measurements; arguments as in ``columns``."""
        names = "depth", "error_std", "common_std", "correlation_depth"
        what = [group.columns[name][at].reshape(len(at), -1) for name in names]
        rows = np.hstack([*what, group.used[at]])
        alike = dict[bytes, list[int]]()
        if (rows[1:] == rows[0]).all():
            alike[rows[0].tobytes()] = list(range(len(at)))
        else:
            for i, row in enumerate(rows):
                alike.setdefault(row.tobytes(), []).append(i)
        linear, held = group.linear, self._layouts
        sums = () if linear is None else (linear.depth, linear.weights, linear.correlation)
        more = tuple(None if each is None else each.tobytes() for each in sums)
        for key_of_values, profiles in alike.items():
            key = (key_of_values, node, revised, *more)
            if key not in held:
                if len(held) >= _REMEMBERED:
                    del held[next(iter(held))]
                held[key] = self._layout(group, int(at[profiles[0]]), node, revised)
            yield held[key], np.array(profiles)

    def _layout(self, group: Screened, i: int, node: int, revised: Revised) -> Layout:
        """Return the layout of the i-th measurement of a group at one position near a node."""
        linear, used, depth = group.linear, group.used[i], group.columns["depth"][i]
        if linear is not None:
            depth = linear.depth

        def at_values(at_points: Array) -> Array:
            return np.asarray((at_points if linear is None else linear.at_values(at_points))[used])

        levels = at_values(self.basis.depth_weights(depth))
        functions = levels @ self.process.functions.T
        if self.extras is not None:
            functions = np.hstack([functions, at_values(self.extras.functions(depth))])
        between = depth_weights(_LINEAR, depth, self.basis.grid.levels)
        measured = self._covariance(group, i, revised)
        error = at_values(between) * (
            self.error(revised.scale, node) if self.stated_std is None else 0.0
        )
        is_relative = not np.isfinite(group.columns["common_std"][i])
        covariance = measured + np.diag(error.sum(axis=1) ** 2)
        shared = np.sum(error * (np.linalg.pinv(measured, hermitian=True) @ error), axis=0)
        near = shared > 0.0
        mean = float(shared[near].mean()) if near.any() else 0.0
        return Layout.of(levels, functions, covariance, bool(is_relative), mean)

    def _along_path(self, group: Screened, revised: Revised) -> Column:
        basis, grid, linear = self.basis, self.basis.grid, group.linear
        assert linear is not None
        used = group.used[0]
        places = np.column_stack(to_local(grid.projection, linear.longitude, linear.latitude))
        levels, times = basis.depth_weights(linear.depth), linear.point_time_ns
        if times is None:
            times = np.full(len(places), linear.time_ns, np.int64)
        shares = self.process.shares(times)
        weights = (np.eye(len(places)) if linear.weights is None else linear.weights)[used]
        # (T m, P Z) sums over the points of each value, by share of each forecast time
        by_time = (shares.T[:, None] * weights).reshape(-1, len(places))
        by_level = (by_time[:, :, None] * levels).swapaxes(1, 2)  # (T m, Z, P)
        flat = by_level.reshape(-1, len(places))
        offset, modes = self._flows(flat @ basis.horizontal.velocity(places, self._latents))
        n, n_levels = len(weights), levels.shape[1]
        sums = modes.reshape(2, shares.shape[1], n, n_levels, -1)
        known = np.einsum("ctnzz->cn", offset.reshape(*sums.shape[:4], n_levels))
        (values, axes) = group.local(group.at)
        times_used = np.any(shares, axis=0).astype(np.float64)
        mean, rows = zip(
            *(self.process.project_sums(np.tensordot(axis, sums, 1), times_used) for axis in axes),
            strict=True,
        )
        between = depth_weights(_LINEAR, linear.depth, grid.levels)
        extra = np.sum(
            between * self.error(revised.scale, nearest_node(grid, places, wet=True)).T, axis=1
        )
        measured, error = self._covariance(group, 0, revised), weights @ extra
        relative = linear.reference == "relative"
        shared, node = 0.0, None
        if n == 1:
            # of one mean: a path's representation error is that near its middle
            node = int(nearest_node(grid, weights @ places / weights.sum(), wet=True)[0])
            shared = float(error[0] ** 2 / measured[0, 0])
        layout = Layout.of(
            np.empty((n, 0)), np.eye(n), measured + np.diag(error**2), relative, shared
        )
        design = np.concatenate(rows)
        if self.extras is not None:
            more = np.tensordot(axes, self.extras.sums(weights, linear.depth, times), 1)
            design = np.hstack([design, more.reshape(len(design), -1)])
        about = values[:, used] - (axes @ known).T - np.array(mean).T
        part = Part(layout, np.zeros(1, np.intp), np.flatnonzero(used), about)
        return Column(group, group.at, linear.time_ns, design, np.eye(len(axes)), (part,), node)

    def _covariance(self, group: Screened, i: int, revised: Revised) -> Array:
        """Return the error covariance of the used values of one, shape (m, m) [m^2/s^2], without representation errors."""
        used, linear, columns = np.flatnonzero(group.used[i]), group.linear, group.columns
        if self.stated_std is not None and group.at_one_place:
            return self.stated_std**2 * np.eye(used.size)
        if linear is not None:
            return linear.covariance(used) + revised.further**2
        error_std, depth = (columns[name][i, used] for name in ("error_std", "depth"))
        correlation, common = (
            float(columns[name][i]) for name in ("correlation_depth", "common_std")
        )
        further = error_covariance(0.0 * error_std + revised.further, depth, revised.depth, 0.0)
        return error_covariance(error_std, depth, correlation, common) + further


def _block_diagonal(design: Array, more: Array) -> Array:
    """Return the block-diagonal design of two sets of functions and unknowns, of shapes (2, K, k)."""
    (_, n, size), (_, n_more, size_more) = design.shape, more.shape
    both = np.zeros((2, n + n_more, size + size_more))
    both[:, :n, :size], both[:, n:, size:] = design, more
    return both
