"""Rows of measured and of sought numbers on the unknowns of an estimate's errors, their covariances, and what measurements leave.

A profile is reduced to two rows, the mean current over its depths. The covariance left of sought numbers y after measurements z with
errors of variance R is (Kalman 1960; Lorenc 1986, Q. J. R. Meteorol. Soc. 112)

    P_post = cov(y, y) - cov(y, z) (cov(z, z) + R)^-1 cov(z, y),

which needs no measured value. Where the current changes, cov(z(t), z(s)) of unknowns with memory rho is

    rho_t rho_s h_t P h_s' + (rho_|t - s| - rho_t rho_s) h_t S h_s',

with P their covariance now and S the one they return to.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth_means import DepthMeans


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Linear functions of the unknowns, each at its time.

    Attributes:
        now: shape (..., q, k), times a root of the unknowns' covariance now, decayed to their time.
        parts: Of each part that relaxes: its decorrelation time [s] and rows of shape (..., q, k'), times a root of what it returns to.
        after: shape (..., q) [s], since the estimate's time.
    """

    now: Array
    parts: tuple[tuple[float, Array], ...]
    after: Array

    def combined(self, weights: Array) -> "Combined":
        """Return linear combinations of the rows, weights of shape (m, q)."""
        return Combined(self, weights)

    def reshaped(self, *shape: int) -> "Rows":
        """Return the rows in another shape (..., q)."""
        parts = tuple((scale, rows.reshape(*shape, rows.shape[-1])) for scale, rows in self.parts)
        return Rows(self.now.reshape(*shape, self.now.shape[-1]), parts, self.after.reshape(shape))


@dataclass(frozen=True, slots=True, eq=False)
class Combined:
    """Numbers that are sought: combinations of rows.

    Attributes:
        rows: One batch of rows, shape (q,).
        weights: shape (m, q).
    """

    rows: Rows
    weights: Array

    def cross(self, measured: Rows) -> Array:
        """Return the covariance of the numbers with rows of shape (..., q'): shape (..., m, q')."""
        if not measured.parts:
            return (self.weights @ self.rows.now) @ measured.now.swapaxes(-1, -2)
        return self.weights @ covariance(self.rows, measured)

    def variance(self) -> Array:
        """Return the covariance of the numbers, shape (m, m)."""
        return self.weights @ covariance(self.rows, self.rows) @ self.weights.T


def rows_at(known: DepthMeans, points: Array, after: Array, which: int = 0) -> Rows:
    """Return the rows of the mean current at places and times, east and north of each place in turn: shape (..., 2 n).

    Args:
        known: The errors of the estimate.
        points: shape (..., n, 2) [m].
        after: shape (n,) or that of the points [s], since the estimate's time.
        which: Of the means over depth.
    """
    n, batch, n_modes = points.shape[-2], points.shape[:-2], known.flow.n_modes
    modes = known.modes(points.reshape(-1, 2)).reshape(-1, n_modes)
    times = np.repeat(np.broadcast_to(after, (*batch, n)).ravel(), 2)
    if not known.changes:
        # the unknowns are the modes of each mean
        now = modes @ known.root.reshape(-1, n_modes, known.root.shape[1])[which]
        return Rows(now, (), times).reshaped(*batch, 2 * n)
    now = np.empty((len(modes), known.root.shape[1]))
    parts = [(part.scale, np.empty((len(modes), part.root.shape[1]))) for part in known.relaxing]
    for time in np.unique(times):
        at = np.flatnonzero(times == time)
        time_ns = known.time_ns + round(float(time) * 1e9)
        # of the few unknowns first: there are more rows than modes
        loading = known.loading(time_ns)[:, which].T
        now[at] = modes[at] @ ((loading * known.memory(time_ns)) @ known.root)
        for part, (_, rows) in zip(known.relaxing, parts, strict=True):
            rows[at] = modes[at] @ (loading[:, part.which] @ part.root)
    return Rows(now, tuple(parts), times).reshaped(*batch, 2 * n)


def unknowns_at(known: DepthMeans, after: float) -> Rows:
    """Return the unknowns themselves at a time [s] since the estimate's as rows, shape (n,)."""
    time_ns = known.time_ns + round(after * 1e9)
    parts = []
    for part in known.relaxing:
        rows = np.zeros((len(known.root), part.root.shape[1]))
        rows[part.which] = part.root
        parts.append((part.scale, rows))
    return Rows(
        known.memory(time_ns)[:, None] * known.root, tuple(parts), np.full(len(known.root), after)
    )


def covariance(first: Rows, second: Rows) -> Array:
    """Return the covariance of two sets of rows, shape (..., q, q')."""
    total = first.now @ second.now.swapaxes(-1, -2)
    for (scale, one), (_, other) in zip(first.parts, second.parts, strict=True):
        t, s = first.after[..., :, None], second.after[..., None, :]
        gained = np.exp(-np.abs(t - s) / scale) - np.exp(
            -(np.maximum(t, 0.0) + np.maximum(s, 0.0)) / scale
        )
        total = total + gained * (one @ other.swapaxes(-1, -2))
    return np.asarray(total)


def stacked(first: Rows, second: Rows) -> Rows:
    """Return the rows of two sets as one: the second set, shape (..., q'), behind the first's, shape (..., q)."""

    def both(one: Array, other: Array) -> Array:
        batch = np.broadcast_shapes(one.shape[:-2], other.shape[:-2])
        parts = [np.broadcast_to(part, (*batch, *part.shape[-2:])) for part in (one, other)]
        return np.concatenate(parts, axis=-2)

    parts = tuple(
        (scale, both(one, other))
        for (scale, one), (_, other) in zip(first.parts, second.parts, strict=True)
    )
    return replace(
        first,
        now=both(first.now, second.now),
        parts=parts,
        after=both(first.after[..., None], second.after[..., None])[..., 0],
    )


def lower_root(measured: Rows, variance: float) -> Array:
    """Return the lower triangular root of cov(z, z) + R, shape (..., q, q)."""
    prior = covariance(measured, measured) + variance * np.eye(measured.now.shape[-2])
    return np.asarray(np.linalg.cholesky(prior))


def posterior(sought: Combined, measured: Rows, variance: float) -> Array:
    """Return the covariance of the sought numbers after measurements, shape (m, m).

    Args:
        sought: m numbers.
        measured: Rows of shape (q,).
        variance: Of the error of each [m^2/s^2].
    """
    lower, cross = lower_root(measured, variance), sought.cross(measured).swapaxes(-1, -2)
    inside = solve_triangular(lower, cross, lower=True)
    return np.asarray(sought.variance() - inside.T @ inside)


def gains(measured: Rows, innovation: Array, variance: float) -> Array:
    """Return (cov(z, z) + R)^-1 of innovations, shape (..., q): what ``learnt`` makes of it are the unknowns."""
    prior = covariance(measured, measured) + variance * np.eye(measured.now.shape[-2])
    return np.asarray(np.linalg.solve(prior, innovation[..., None])[..., 0])


def learnt(known: DepthMeans, measured: Rows, weighed: Array, after: float) -> Array:
    """Return the mean of the unknowns given measurements at a time [s] since the estimate's, shape (..., n).

    Args:
        known: The errors of the estimate.
        measured: Rows of shape (..., q).
        weighed: shape (..., q), of ``gains``.
        after: When.
    """
    own = unknowns_at(known, after)
    total = np.einsum("...q,...qk->...k", weighed, measured.now) @ own.now.T
    for (scale, rows), (_, roots) in zip(measured.parts, own.parts, strict=True):
        gained = np.exp(-np.abs(after - measured.after) / scale) - np.exp(
            -(max(after, 0.0) + measured.after) / scale
        )
        total = total + np.einsum("...q,...qk->...k", weighed * gained, rows) @ roots.T
    return np.asarray(total)


def together(rows: Sequence[Rows]) -> Rows:
    """Return rows of several sets, shape (q,) each, as one."""
    found = rows[0]
    for more in rows[1:]:
        found = stacked(found, more)
    return found
