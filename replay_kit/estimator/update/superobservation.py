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

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.config.gating import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.estimator.update.biases import NAMES, scale_jacobian
from replay_kit.estimator.update.gate import GateResult, Gates, gate_innovations
from replay_kit.estimator.update.profile_stack import ProfileStack
from replay_kit.estimator.update.rows import dependence_inflation


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """The estimate of the unknowns of a column of water.

    Attributes:
        means: shape (2 q, 1 + b), component after component: their mean, and its change for instrument errors of one unit.
        cov: shape (2 q, 2 q).
    """

    means: Array
    cov: Array

    @property
    def width(self) -> int:
        """Number q of unknowns of a component."""
        return len(self.means) // 2

    def predicted(self, r: Array) -> Array:
        """Return predicted rows and their bias sensitivity, shape (s, 2, q, 1 + b), for R of shape (s, q, q)."""
        return np.asarray(np.matmul(r[:, None], self.means.reshape(2, self.width, -1)))

    def predicted_cov(self, r: Array) -> Array:
        """Return the covariance of rows, shape (s, 2 q, 2 q), for R of shape (s, q, q)."""
        q = self.width
        left = np.matmul(r[:, None], self.cov.reshape(2, q, 2 * q))  # (s, 2, q, 2 q)
        both = np.matmul(
            left.reshape(len(r), 2 * q, 2, q).swapaxes(1, 2), r[:, None].swapaxes(2, 3)
        )  # (s, 2, 2 q, q)
        cov = both.swapaxes(1, 2).reshape(len(r), 2 * q, 2 * q)
        return np.asarray(0.5 * (cov + cov.swapaxes(1, 2)))

    def updated(self, r: Array, innovation: Array) -> "Column":
        """Return the column after rows of unit noise.

        Args:
            r: shape (q, q), R.
            innovation: shape (2 q, 1 + b).
        """
        q = self.width
        cross = np.matmul(r, self.cov.reshape(2, q, 2 * q)).reshape(2 * q, 2 * q)
        cov = self.predicted_cov(r[None])[0]
        lower = np.linalg.cholesky(cov + np.eye(2 * q))
        both = scipy.linalg.solve_triangular(lower, np.hstack([cross, innovation]), lower=True)
        gain = both[:, : 2 * q]
        return Column(self.means + gain.T @ both[:, 2 * q :], self.cov - gain.T @ gain)


@dataclass(frozen=True, slots=True, eq=False)
class CombinedRows:
    """The rows of several profiles as one.

    Attributes:
        r: shape (q, q), R.
        y: shape (2, q, 1 + b): values, and the effect of instrument errors of one unit.
        residual: Squared norm of what the combination leaves of the values.
    """

    r: Array
    y: Array
    residual: float


def combined(r: Array, y: Array, weight: Array) -> CombinedRows:
    """Return rows as one: with the same information, and the same products with the values.

    Args:
        r: shape (s, q, q), or (1, q, q) where all are the same.
        y: shape (s, 2, q, 1 + b).
        weight: shape (s,), one over each one's error variance.
    """
    q = r.shape[-1]
    if len(r) == 1:
        root = np.sqrt(weight.sum())
        whole = np.tensordot(weight, y, axes=1) / root
        square = float(np.sum(weight[:, None, None] * y[..., 0] ** 2) - np.sum(whole[..., 0] ** 2))
        return CombinedRows(root * r[0], whole, max(square, 0.0))
    roots = np.sqrt(weight)
    turn, of_all = np.linalg.qr((roots[:, None, None] * r).reshape(-1, q))
    columns = (roots[:, None, None, None] * y).transpose(0, 2, 1, 3).reshape(len(turn), -1)
    whole = (turn.T @ columns).reshape(q, 2, -1).swapaxes(0, 1)
    square = float(
        np.sum(columns.reshape(len(turn), 2, -1)[..., 0] ** 2) - np.sum(whole[..., 0] ** 2)
    )
    return CombinedRows(of_all, whole, max(square, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class GroupUpdate:
    """The evaluation of a group, profile by profile and as one.

    Attributes:
        stack: The profiles.
        gate: Of each of them.
        before: shape (n, m, 2) [m/s], measured minus what was predicted before each.
        rows: Of the accepted ones together; None without one.
        scale_jacobian: Sum over them; see ``biases.scale_jacobian``.
        first: Of the first profile; it alone is reported to the consistency monitor, as the others share the estimate's error.
    """

    stack: ProfileStack
    gate: Gates
    before: Array
    rows: CombinedRows | None
    scale_jacobian: float
    first: GateResult

    @property
    def nis(self) -> Array:
        """Normalised innovation squared of all measured values of each, with the stated errors, shape (n,)."""
        return self.gate.nis + self.stack.residual_square


def evaluate_group(
    stack: ProfileStack,
    column: Column,
    gating: GatingConfig | None,
    correlated: bool,
    is_consistent: bool,
) -> GroupUpdate:
    """Return the evaluation of a group.

    Args:
        stack: Its profiles.
        column: The estimate before them.
        gating: Gate; None accepts everything.
        correlated: Whether errors grow where residuals are correlated along a profile.
        is_consistent: Whether recent innovations agree with the estimate.
    """
    gates, misfits, parts, jacobian = [], [], [], 0.0
    for rows in _stages(len(stack.observations)):
        part = stack.part(rows)
        predicted = column.predicted(part.of("r"))
        gate = gate_profiles(
            part,
            predicted[..., 0],
            column.predicted_cov(part.of("r")),
            gating,
            correlated,
            is_consistent,
        )
        misfit = part.misfit(np.broadcast_to(predicted[..., 0], part.y.shape))
        gates.append(gate)
        misfits.append(misfit)
        accepted = np.flatnonzero(gate.accepted)
        if not accepted.size:
            continue
        known = part.bias_rows(misfit)
        biases = np.zeros((*part.y.shape, len(NAMES))) if known is None else known
        values = np.concatenate([part.y[..., None], biases], axis=-1)[accepted]
        r = part.of("r")
        whole = combined(r if len(r) == 1 else r[accepted], values, 1.0 / gate.inflation[accepted])
        column = column.updated(whole.r, _innovation(whole, column))
        parts.append(whole)
        if known is not None:
            jacobians = scale_jacobian(gate, gate.inflation, part.ones, part.scale_error_std)
            jacobian += float(jacobians[accepted].sum())
    whole_rows = None
    if parts:
        whole_rows = combined(
            np.stack([part.r for part in parts]),
            np.stack([part.y for part in parts]),
            np.ones(len(parts)),
        )
        whole_rows = (
            replace(whole_rows, residual=whole_rows.residual + sum(part.residual for part in parts))
            if len(parts) > 1
            else parts[0]
        )
    gate = Gates.joined(gates)
    return GroupUpdate(
        stack, gate, np.concatenate(misfits), whole_rows, jacobian, gates[0].result(0)
    )


def gate_profiles(
    stack: ProfileStack,
    mean: Array,
    cov: Array,
    gating: GatingConfig | None,
    correlated: bool,
    is_consistent: bool,
) -> Gates:
    """Return the gate's decisions on profiles, with errors that grow where their residuals are correlated.

    Args:
        stack: The profiles.
        mean: shape (n or 1, 2, q), predicted rows.
        cov: shape (n or 1, 2 q, 2 q), their covariance.
        gating: See ``evaluate_group``, as for the others.
        correlated: Whether errors grow.
        is_consistent: Whether recent innovations agree with the estimate.
    """
    n, dof = len(stack.observations), stack.of("dof")
    rows = 2 * stack.of("k")
    gates = gate_innovations(
        (stack.y - mean).reshape(n, -1),
        cov,
        np.broadcast_to(rows, n),
        (stack.residual_square, np.broadcast_to(dof - rows, n)),
        gating,
        is_consistent,
    )
    if not correlated:
        return gates
    scale = gates.inflation[:, None]
    share = gates.variance / (gates.variance + scale) * gates.along
    after = mean + np.matmul(gates.vectors, share[..., None])[..., 0].reshape(n, 2, -1)
    residual = stack.whitened_misfit(after) / np.sqrt(scale)[..., None]
    further = dependence_inflation(residual, np.broadcast_to(dof, n))
    return replace(gates, inflation=np.where(gates.accepted, further, 1.0) * gates.inflation)


def _innovation(rows: CombinedRows, column: Column) -> Array:
    """Return values minus their prediction, and the same of instrument errors of one unit, shape (2 q, 1 + b)."""
    return np.asarray((rows.y - column.predicted(rows.r[None])[0]).reshape(2 * column.width, -1))


def _stages(n: int) -> Iterator[NDArray[np.intp]]:
    """Yield the profiles that are judged together: the first, the second, then as many as there were before."""
    start = 0
    while start < n:
        stop = min(n, max(1, 2 * start))
        yield np.arange(start, stop)
        start = stop
