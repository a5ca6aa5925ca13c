"""Superobservations: profiles that repeat each other, combined without loss before they meet the filter.

The bins of profile i under one place are v_i = J_i x + noise for each component, with x the unknowns of the column of water there: the
current at the levels, and what else a row holds. Whitened and compressed (``rows.py``) it is y_i = R_i x + noise of unit variance.
With an error variance w_i times the stated one all profiles together are equivalent to the rows

    R'R = sum R_i'R_i / w_i,    R y = sum R_i'y_i / w_i

which are as many as one profile's. So a group costs the filter one update. Only the place is shared, the mean of
the profiles': depths, errors and missing bins are each one's own.

Each profile is judged on its own: its gate, errors and dependence of residuals are those of ``gate.py`` and ``rows.py``, for many
profiles at once. The first is held against the estimate before the group, the second against that with the first, then two, four, eight ...
against that with all before them, so that an outlier is distinguished from the others as it would be alone, in the
column's few unknowns instead of the weights.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.config.estimation import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.estimator.update.biases import NAMES, scale_jacobian
from replay_kit.estimator.update.gate import Gates, Spectrum, gate_innovations
from replay_kit.estimator.update.noise import dependence_inflation, is_significant
from replay_kit.estimator.update.stack import Stack


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """The estimate of the unknowns of a column of water, or of the rows of one measurement.

    Attributes:
        means: shape (c q, 1 + b), component after component: their mean, and its change for instrument errors of one unit.
        cov: shape (c q, c q).
    """

    means: Array
    cov: Array

    def predicted(self, r: Array) -> Array:
        """Return predicted rows and their bias sensitivity, shape (s, c, q, 1 + b), for R of shape (s, q, q)."""
        q, columns = r.shape[-1], self.means.shape[1]
        return np.asarray(np.matmul(r[:, None], self.means.reshape(-1, q, columns)))

    def predicted_cov(self, r: Array) -> Array:
        """Return the covariance of rows, shape (s, c q, c q), for R of shape (s, q, q)."""
        q, size = r.shape[-1], len(self.cov)
        left = np.matmul(r[:, None], self.cov.reshape(-1, q, size))  # (s, c, q, c q)
        both = np.matmul(
            left.reshape(len(r), size, -1, q).swapaxes(1, 2), r[:, None].swapaxes(2, 3)
        )  # (s, c, c q, q)
        cov = both.swapaxes(1, 2).reshape(len(r), size, size)
        return np.asarray(0.5 * (cov + cov.swapaxes(1, 2)))

    def innovation(self, rows: "CombinedRows") -> Array:
        """Return values minus their prediction, and the same of instrument errors of one unit, shape (c q, 1 + b)."""
        off = rows.y - self.predicted(rows.r[None])[0]
        return np.asarray(off.reshape(len(self.cov), -1))

    def updated(self, rows: "CombinedRows") -> "ColumnUpdate":
        """Return the update by rows of unit noise."""
        size, q = len(self.cov), len(rows.r)
        cross = np.matmul(rows.r, self.cov.reshape(-1, q, size)).reshape(size, size)
        lower = np.linalg.cholesky(self.predicted_cov(rows.r[None])[0] + np.eye(size))
        both = scipy.linalg.solve_triangular(
            lower, np.hstack([cross, self.innovation(rows)]), lower=True
        )
        gain, whitened = both[:, :size], both[:, size:]
        after = Column(self.means + gain.T @ whitened, self.cov - gain.T @ gain)
        return ColumnUpdate(rows, lower, whitened, after)


@dataclass(frozen=True, slots=True, eq=False)
class ColumnUpdate:
    """The update of a column by rows of unit noise.

    Attributes:
        rows: The rows.
        lower: shape (c q, c q), L, the Cholesky factor of the covariance of the rows' innovation.
        whitened: shape (c q, 1 + b), L^-1 times that innovation, and that of instrument errors of one unit.
        after: The column after the rows.
    """

    rows: "CombinedRows"
    lower: Array
    whitened: Array
    after: Column

    @property
    def fit(self) -> tuple[float, float]:
        """Normalised square of the innovation, and half the log-determinant of its covariance."""
        own = self.whitened[:, 0]
        return float(own @ own), float(np.log(np.diag(self.lower)).sum())

    @property
    def signal_dof(self) -> float:
        """Degrees of freedom for signal: the trace of the rows' predicted covariance over that of their innovation."""
        inverse = np.linalg.inv(self.lower)
        return float(len(inverse) - np.sum(inverse**2))


@dataclass(frozen=True, slots=True, eq=False)
class CombinedRows:
    """The rows of several profiles as one.

    Attributes:
        r: shape (q, q), R.
        y: shape (c, q, 1 + b): values, and the effect of instrument errors of one unit.
        residual: Squared norm of what the combination leaves of the values.
    """

    r: Array
    y: Array
    residual: float


def combined(r: Array, y: Array, weight: Array) -> CombinedRows:
    """Return rows as one: with the same information, and the same products with the values.

    Args:
        r: shape (s, q, q), or (1, q, q) where all are the same.
        y: shape (s, c, q, 1 + b).
        weight: shape (s,), one over each one's error variance.
    """
    q = r.shape[-1]
    if len(r) == 1:
        root = np.sqrt(weight.sum())
        of_all, whole = root * r[0], np.tensordot(weight, y, axes=1) / root
    else:
        roots = np.sqrt(weight)
        turn, of_all = np.linalg.qr((roots[:, None, None] * r).reshape(-1, q))
        columns = (roots[:, None, None, None] * y).transpose(0, 2, 1, 3).reshape(len(turn), -1)
        whole = (turn.T @ columns).reshape(q, y.shape[1], -1).swapaxes(0, 1)
        # profiles relative to their platform leave a row of rounding, along any direction
        whole = np.where(is_significant(of_all)[:, None], whole, 0.0)
    square = float(np.sum(weight[:, None, None] * y[..., 0] ** 2) - np.sum(whole[..., 0] ** 2))
    return CombinedRows(of_all, whole, max(square, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class GroupUpdate:
    """The evaluation of a group, profile by profile and as one.

    Attributes:
        stack: The profiles.
        gate: Of each of them.
        before: shape (n, m, 2) [m/s], measured minus what was predicted before each.
        scale_jacobian: Sum over the accepted ones; see ``biases.scale_jacobian``.
        step: The update of the column by these together; None without one.
    """

    stack: Stack
    gate: Gates
    before: Array
    scale_jacobian: float
    step: ColumnUpdate | None

    @property
    def nis(self) -> Array:
        """Normalised innovation squared of all measured values of each, with the stated errors, shape (n,)."""
        return self.gate.nis + self.stack.residual_square


class Judging(NamedTuple):
    """How profiles are judged.

    Attributes:
        gating: Gate; None accepts everything.
        correlated: Whether errors grow where residuals are correlated along a profile.
        is_consistent: Whether recent innovations agree with the estimate.
    """

    gating: GatingConfig | None
    correlated: bool
    is_consistent: bool


def evaluate_group(stack: Stack, column: Column, judging: Judging) -> GroupUpdate:
    """Return the evaluation of a group of profiles, given the estimate before them."""
    judged = _judged_alike if len(stack.layouts) == 1 else _judged_in_turn
    gates, predicted = judged(stack, column, judging)
    misfit, accepted = stack.misfit(predicted), np.flatnonzero(gates.accepted)
    if not accepted.size:
        return GroupUpdate(stack, gates, misfit, 0.0, None)
    known, jacobian = stack.bias_rows(misfit), 0.0
    if known is not None:
        jacobians = scale_jacobian(gates, gates.error_factor, stack.ones, stack.scale_error_std)
        jacobian = float(jacobians[accepted].sum())
    biases = np.zeros((*stack.y.shape, len(NAMES))) if known is None else known
    values = np.concatenate([stack.y[..., None], biases], axis=-1)
    whole = _together(stack.of("r"), values, gates)
    return GroupUpdate(stack, gates, misfit, jacobian, column.updated(whole))


def _together(r: Array, values: Array, gates: Gates) -> CombinedRows:
    """Return the accepted profiles as one, of rows R and values as of ``combined``."""
    accepted = gates.accepted
    weight = 1.0 / gates.error_factor[accepted]
    return combined(r if len(r) == 1 else r[accepted], values[accepted], weight)


def _judged_in_turn(stack: Stack, column: Column, judging: Judging) -> tuple[Gates, Array]:
    """Return the gate's decisions on profiles, and their rows as predicted before each, shape (n, c, q)."""
    column, gates, predicted = replace(column, means=column.means[:, :1]), [], []
    for rows in _stages(len(stack.observations)):
        part = stack.part(rows)
        r = part.of("r")
        mean = column.predicted(r)[..., 0]
        spectrum = Spectrum.of((part.y - mean).reshape(len(rows), -1), column.predicted_cov(r))
        gate = gate_profiles(part, mean, spectrum, judging)
        gates.append(gate)
        predicted.append(np.broadcast_to(mean, part.y.shape))
        if gate.accepted.any() and rows[-1] + 1 < len(stack.observations):
            column = column.updated(_together(r, part.y[..., None], gate)).after
    return Gates.joined(gates), np.concatenate(predicted)


def _judged_alike(stack: Stack, column: Column, judging: Judging) -> tuple[Gates, Array]:
    """Return the same of profiles of one layout, all at once.

    The covariance of their rows keeps its eigenvectors: after some, a variance v is v / (1 + W v), with W the sum of one over their error
    factors. A stage depends on those before it alone: all are judged as if all were accepted as stated, then as found, until that holds.
    """
    n, r = len(stack.observations), stack.of("r")
    first = column.predicted(r)[..., 0]
    variance, vectors, along = Spectrum.of(
        (stack.y - first).reshape(n, -1), column.predicted_cov(r)
    )
    stages, weight = list(_stages(n)), np.ones(n)
    before = np.concatenate([np.full(len(rows), rows[0]) for rows in stages])
    # each time one stage more is judged by what was found of those before it
    for _ in stages:
        weights, sums = (
            np.vstack([np.zeros_like(each[:1]), np.cumsum(each, axis=0)])[before]
            for each in (weight[:, None], weight[:, None] * along)
        )
        left = variance / (1.0 + weights * variance)
        moved = left * sums
        mean = first + (moved @ vectors[0].T).reshape(n, *first.shape[1:])
        gates = gate_profiles(stack, mean, Spectrum(left, vectors, along - moved), judging)
        found = np.where(gates.accepted, 1.0 / gates.error_factor, 0.0)
        if np.array_equal(found, weight):
            break
        weight = found
    return gates, mean


def gate_profiles(stack: Stack, mean: Array, spectrum: Spectrum, judging: Judging) -> Gates:
    """Return the gate's decisions on profiles, with errors that grow where their residuals are correlated.

    Args:
        stack: The profiles.
        mean: Their rows as predicted, shape (n, c, q).
        spectrum: Of what they differ by.
        judging: How they are judged.
    """
    n, dof = len(stack.observations), stack.of_each("dof")
    rows = len(stack.components) * stack.of_each("k")
    left = stack.residual_square, dof - rows
    gates = gate_innovations(spectrum, rows, left, judging.gating, judging.is_consistent)
    # one value has no neighbour
    if not judging.correlated or stack.used.shape[1] < 2:
        return gates
    scale = gates.error_factor[:, None]
    share = gates.variance / (gates.variance + scale) * gates.along
    after = mean + np.matmul(gates.vectors, share[..., None])[..., 0].reshape(
        n, len(stack.components), -1
    )
    residual = stack.whitened_misfit(after) / np.sqrt(scale)[..., None]
    further = dependence_inflation(residual, dof)
    return replace(gates, error_factor=np.where(gates.accepted, further, 1.0) * gates.error_factor)


def _stages(n: int) -> Iterator[NDArray[np.intp]]:
    """Yield the profiles that are judged together: the first, the second, then as many as there were before."""
    start = 0
    while start < n:
        stop = min(n, max(1, 2 * start))
        yield np.arange(start, stop)
        start = stop
