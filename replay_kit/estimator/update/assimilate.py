"""Update of the unknowns by measurements, in blocks.

The products of all columns of a block with the covariance are computed at once. Columns are then judged in order, each against the estimate
after earlier ones, and update the mean; the covariance is updated once, at the end:

    C = D P,    S = R C D' R' + 1 = A A',    G = A^-1 R C,    x <- x + G' A^-1 (y - R D x),    P <- P - G'G.

In between, only D x and D P D' are updated. Accepted measurements of a column are combined without loss, with w_i one over the error
factor of each:

    R'R = sum w_i R_i'R_i,    R'y = sum w_i R_i'y_i.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.blas import dtrsm

from replay_kit.core.arrays import Array, replace
from replay_kit.estimator.state import FOLDED, State
from replay_kit.estimator.update.columns import Column
from replay_kit.estimator.update.judge import Judgements, Seen, judged
from replay_kit.estimator.update.screening import Screened

# Share of the largest eigenvalue below which a combination of rows is rounding.
_ROUNDING = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class Update:
    """Update by the measurements of one column.

    Attributes:
        column: Column.
        before, covariance: Mean, shape (q,), and covariance, shape (q, q), of its unknowns before.
        judgements: Gate decisions on its measurements.
        mean_after, covariance_after: The same after accepted ones.
        signal: Degrees of freedom for signal.
        log_likelihood: Log density of accepted values under the prediction, without the constant of 2 pi, else NaN.
        rows, lower: R of all accepted, shape (m, q), and A, shape (m, m).
        gain: shape (m, k), rows of G.
        whitened: shape (m,), A^-1 (y - R D x).
        square: Sum of squares of y.
        seen, after: As in ``State``, and the state, after them.
    """

    column: Column
    before: Array
    covariance: Array
    judgements: Judgements
    mean_after: Array
    covariance_after: Array
    signal: float = 0.0
    log_likelihood: float = np.nan
    rows: Array = field(default_factory=lambda: np.empty((0, 0)))
    lower: Array = field(default_factory=lambda: np.empty((0, 0)))
    gain: Array = field(default_factory=lambda: np.empty((0, 0)))
    whitened: Array = field(default_factory=lambda: np.empty(0))
    square: float = 0.0
    seen: Mapping[int, float] = field(default_factory=dict)
    after: State | None = None


def assimilate(
    state: State, columns: Sequence[Column], probability: float | None
) -> tuple[State, list[Update]]:
    """Return the state after measurements, and the update by each column.

    Args:
        state: State at the time of the columns.
        columns: Columns in order.
        probability: See ``judge.judged_layout``.
    """
    if not columns:
        return state, []
    designs = np.concatenate([column.design for column in columns])
    crosses = state.products(designs)
    block = _Block(designs @ state.x, crosses @ designs.T, state.seen)
    starts = np.cumsum([0, *(len(column.design) for column in columns)])
    updates = [
        block.updated(column, slice(start, start + len(column.design)), probability)
        for column, start in zip(columns, starts[:-1].tolist(), strict=True)
    ]
    gains, whitened = block.gains(crosses), np.concatenate(block.whitened)
    ends = np.cumsum([len(each) for each in block.whitened])
    # the states in between share P and G
    whole, before = np.concatenate([state.gains, gains]), len(state.gains)
    now, start, done = state, 0, list[Update]()
    for update, end in zip(updates, ends.tolist(), strict=True):
        now = replace(
            now,
            x=now.x + whitened[start:end] @ gains[start:end],
            gains=whole[: before + end],
            profiles=now.profiles + int(update.judgements.accepted.sum()),
            rows=now.rows + len(update.rows),
            square=now.square + update.square,
            seen=update.seen or now.seen,
        )
        done.append(replace(update, gain=gains[start:end], after=now))
        start = end
    return now.folded(FOLDED), done


class _Block:
    """Joint unknowns of the columns of a block during the update.

    Attributes:
        mean: shape (Q,), mean after the columns so far.
        covariance: shape (Q, Q), covariance.
        seen: As in ``State``.
        whitened: Whitened innovations of the columns so far.
    """

    def __init__(self, mean: Array, covariance: Array, seen: Mapping[int, float]) -> None:
        self.mean, self.covariance, self.seen = mean, 0.5 * (covariance + covariance.T), seen
        self.whitened = list[Array]()
        self._parts = list[tuple[slice, Array, Array, Array]]()

    def updated(self, column: Column, at: slice, probability: float | None) -> Update:
        """Return the update by a column, without its gain, and record it.

        Args:
            column: Column.
            at: Slice of its unknowns.
            probability: See ``judge.judged_layout``.
        """
        before, covariance = self.mean[at].copy(), self.covariance[at, at].copy()
        seen = [Seen(column.rows(part), *column.compressed(part), part.at) for part in column.parts]
        judgements = judged(seen, len(column.at), before, covariance, probability)
        weights = np.where(judgements.accepted, 1.0 / judgements.error_factor, 0.0)
        if not weights.any():
            self.whitened.append(np.empty(0))
            return Update(column, before, covariance, judgements, before, covariance)
        # All measurements near a node share its representation error, however many: with r the ratio of its variance to that of one, n
        # together tell as much as n / (1 + n r) without it. With S the sum of the ratios so far, and S + s that with those of a column,
        # w_i is multiplied by (1 + r_i) / ((1 + S) (1 + S + s)), which is 1 for the first. The gate takes each as if it were alone.
        if column.node is not None:
            before_it, shared = self.seen.get(column.node, 0.0), column.shared
            after_it = before_it + float(weights @ shared)
            weights = weights * (1.0 + shared) / ((1.0 + before_it) * (1.0 + after_it))
            self.seen = {**self.seen, column.node: after_it}
        rows, y, residual = combined_column(seen, weights)
        m, left = len(rows), slice(at.start, None)
        lower = np.asarray(np.linalg.cholesky(rows @ covariance @ rows.T + np.eye(m)), np.float64)
        # of the unknowns of columns judged before nothing is asked any more
        both = np.zeros((m, len(self.mean) + 1 + m))
        both[:, left.start : -1 - m] = rows @ self.covariance[at, left]
        both[:, -1 - m] = y - rows @ before
        both[:, -m:] = np.eye(m)
        solved = lower_solved(lower, both)
        gain, whitened, inverse = solved[:, : -1 - m], solved[:, -1 - m], solved[:, -m:]
        self.mean[left] += whitened @ gain[:, left]
        self.covariance[left, left] -= gain[:, left].T @ gain[:, left]
        self.whitened.append(whitened)
        self._parts.append((at, rows, lower, gain))
        fit = -0.5 * (float(whitened @ whitened) + residual) - float(np.log(np.diag(lower)).sum())
        return Update(
            column,
            before,
            covariance,
            judgements,
            self.mean[at].copy(),
            self.covariance[at, at].copy(),
            signal=float(m - np.sum(inverse**2)),
            log_likelihood=fit - _log_noise(column, judgements, weights),
            rows=rows,
            lower=lower,
            whitened=whitened,
            square=float(y @ y),
            seen=self.seen,
        )

    def gains(self, crosses: Array) -> Array:
        """Return the rows of G from all columns, shape (m, k), given the covariance of their unknowns with all, shape (Q, k).

        With g_j the gain of column j on the block's unknowns, R_j C_j = sum over earlier i of R_j g_i' G_i, and A_j G_j: triangular.
        """
        ends = np.cumsum([0, *(len(lower) for _, _, lower, _ in self._parts)]).tolist()
        system, right = np.zeros((ends[-1], ends[-1])), np.zeros((ends[-1], crosses.shape[1]))
        earlier = np.zeros((ends[-1], len(self.mean)))
        for (at, rows, lower, gain), start, end in zip(self._parts, ends, ends[1:], strict=False):
            system[start:end, :start] = rows @ earlier[:start, at].T
            system[start:end, start:end] = lower
            right[start:end], earlier[start:end] = rows @ crosses[at], gain
        return lower_solved(system, right)


def lower_solved(lower: Array, right: Array) -> Array:
    """Return the solution X, shape (m, n), of L X = B, with L lower triangular, shape (m, m)."""
    # transposed, arrays in C order are in the order of the Fortran routine: nothing is copied but the result
    return np.asarray(dtrsm(1.0, lower.T, right.T, side=1).T) if len(lower) else right


def combined_column(seen: Sequence[Seen], weights: Array) -> tuple[Array, Array, float]:
    """Return combined measurements of a column: rows of unit noise, values, and the residual square.

    Args:
        seen: Measurements by layout.
        weights: shape (n,), one over the factor on each error variance; 0 if rejected.
    """
    given = [(column, weights[column.at]) for column in seen if weights[column.at].any()]
    (column, share), *others = given
    if not others and np.count_nonzero(share) == 1:
        i = int(share.argmax())
        root = np.sqrt(share[i])
        return root * column.rows, root * column.y[i], float(share[i] * column.square[i])
    size = column.rows.shape[1]
    information, score, total, left = np.zeros((size, size)), np.zeros(size), 0.0, 0.0
    for column, share in given:
        information += share.sum() * (column.rows.T @ column.rows)
        score += column.rows.T @ (share @ column.y)
        total += float(share @ np.sum(column.y**2, axis=1))
        left += float(share @ column.square)
    values, vectors = np.linalg.eigh(information)
    kept = values > _ROUNDING * values[-1]
    roots, vectors = np.sqrt(values[kept]), vectors[:, kept]
    y_all = vectors.T @ score / roots
    return roots[:, None] * vectors.T, y_all, float(total - y_all @ y_all) + left


def _log_noise(column: Column, judgements: Judgements, weights: Array) -> float:
    """Return half the log determinant of the error covariance of accepted measurements, each with its weight."""
    accepted, dof = judgements.accepted, judgements.rows + judgements.left
    stated = sum(
        int(accepted[part.at].sum()) * len(column.axes) * part.layout.half_log_det
        for part in column.parts
    )
    return float(stated - 0.5 * dof[accepted] @ np.log(weights[accepted]))


def scale_jacobian(update: Update) -> float:
    """Return the derivative of the log-densities' Jacobian with respect to a scale error, at zero, to subtract from its score.

    With correct errors the regressor contains on average one unit of the innovation per component, less the fraction of the platform
    velocity's error. The result is scaled by the innovation's normalised square, as errors are often overstated.
    """
    column, total = update.column, 0.0
    for part in column.parts:
        rows, (y, *_) = column.rows(part), column.compressed(part)
        of_rows, layout = rows @ update.covariance @ rows.T, part.layout
        of_one = np.kron(
            np.eye(len(column.axes)), (layout.q.T @ layout.whiten.sum(axis=1))[:, None]
        )
        for i, values in zip(part.at.tolist(), y, strict=True):
            common = _scale_error_std(column.screened, int(column.at[i]))
            if common is None or not update.judgements.accepted[i]:
                continue
            covariance = of_rows + update.judgements.error_factor[i] * np.eye(len(rows))
            off = values - rows @ update.before
            solved = np.linalg.solve(covariance, np.column_stack([off, of_one]))
            shared = common**2 * float(np.sum(of_one * solved[:, 1:]))
            total += (2.0 - shared) * float(off @ solved[:, 0]) / len(rows)
    return total


def _scale_error_std(group: Screened, i: int) -> float | None:
    """Return the error of the platform's velocity [m/s] in a profile affected by a scale error; None for others."""
    common = float(group.columns["common_std"][i])
    stated = not np.isnan(group.columns["platform"][i, 0]) and np.isfinite(common)
    return common if stated else None
