"""The update of the unknowns by measurements, in blocks.

The products of all columns of a block with the covariance are computed at once: P is read once for all. Columns are then judged in order,
each against the estimate after those before it, and change the mean; the covariance is changed once, at the end:

    C = D P,    S = R C D' R' + 1 = A A',    G = A^-1 R C,    x <- x + G' A^-1 (y - R D x),    P <- P - G'G.

A block of one is the same. Measurements of a column are judged each against the estimate before them; those accepted are combined without
loss before they meet the unknowns, with w_i one over each one's error factor:

    R'R = sum w_i R_i'R_i,    R'y = sum w_i R_i'y_i.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.observation import LinearMeasurement
from replay_kit.estimator.state import FOLDED, State
from replay_kit.estimator.update.columns import Column
from replay_kit.estimator.update.judge import Judgement, judged

# Share of the largest eigenvalue below which a combination of rows is rounding.
_ROUNDING = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class Update:
    """What measurements of one column did.

    Attributes:
        column: The column.
        before: shape (q,), mean of its unknowns before them.
        covariance: shape (q, q), of these.
        judgements: One a measurement.
        mean_after: shape (q,), mean after those accepted.
        covariance_after: shape (q, q).
        signal: Degrees of freedom for signal.
        log_likelihood: Of the values accepted, under the estimate before them, without the constant of 2 pi; NaN where none is.
        rows: shape (m, q), R of all accepted together; empty where none is.
        lower: shape (m, m), A.
        gain: shape (m, k), what they add to G.
        whitened: shape (m,), A^-1 (y - R D x).
        square: Of the values y of these rows.
        after: The state after them.
    """

    column: Column
    before: Array
    covariance: Array
    judgements: tuple[Judgement, ...]
    mean_after: Array
    covariance_after: Array
    signal: float = 0.0
    log_likelihood: float = np.nan
    rows: Array = field(default_factory=lambda: np.empty((0, 0)))
    lower: Array = field(default_factory=lambda: np.empty((0, 0)))
    gain: Array = field(default_factory=lambda: np.empty((0, 0)))
    whitened: Array = field(default_factory=lambda: np.empty(0))
    square: float = 0.0
    after: State | None = None


def assimilate(
    state: State, columns: Sequence[Column], probability: float | None
) -> tuple[State, list[Update]]:
    """Return the state after measurements, and what each column's did.

    Args:
        state: At the time of the columns.
        columns: In order.
        probability: As of ``judged``.
    """
    if not columns:
        return state, []
    designs = [column.design for column in columns]
    ends = np.cumsum([len(design) for design in designs])
    crosses = np.split(state.products(np.concatenate(designs)), ends[:-1])
    gains, steps, now = [state.gains[:0]], list[tuple[Update, State]](), state
    for column, cross in zip(columns, crosses, strict=True):
        so_far = np.concatenate(gains)
        cross = cross - (column.design @ so_far.T) @ so_far
        update, gain, step = _updated(column, (column.design @ now.x, cross), probability)
        now = replace(
            now,
            x=now.x + step,
            profiles=now.profiles + sum(each.accepted for each in update.judgements),
            rows=now.rows + len(update.rows),
            square=now.square + update.square,
        )
        gains.append(gain)
        steps.append((update, now))
    whole = np.concatenate([state.gains, *gains])
    ends = len(state.gains) + np.cumsum([len(gain) for gain in gains])[1:]
    # the states in between share P and G
    updates = [
        replace(update, after=replace(after, gains=whole[:end]))
        for (update, after), end in zip(steps, ends, strict=True)
    ]
    return replace(now, gains=whole).folded(FOLDED), updates


def _updated(
    column: Column, estimate: tuple[Array, Array], probability: float | None
) -> tuple[Update, Array, Array]:
    """Return what measurements of a column do, the rows that they add to G, and their change of the mean.

    Args:
        column: The column.
        estimate: Before them: shape (q,), mean of the column's unknowns; shape (q, k), their covariance with all unknowns.
        probability: As of ``judged``.
    """
    before, cross = estimate
    covariance = cross @ column.design.T
    covariance = 0.5 * (covariance + covariance.T)
    evaluated = list(_evaluated(column, before, covariance, probability))
    judgements = tuple(judgement for judgement, _, _ in evaluated)
    accepted = [each for each in evaluated if each[0].accepted]
    nothing = Update(column, before, covariance, judgements, before, covariance)
    if not accepted:
        return nothing, cross[:0], np.zeros(cross.shape[1])
    rows, y, residual = combined(accepted)
    innovation = rows @ covariance @ rows.T + np.eye(len(rows))
    lower = np.asarray(np.linalg.cholesky(innovation), np.float64)
    both = np.column_stack([rows @ cross, y - rows @ before, np.eye(len(rows))])
    solved = solve_triangular(lower, both, lower=True, check_finite=False)
    gain, whitened, inverse = np.split(solved, [cross.shape[1], cross.shape[1] + 1], axis=1)
    step = (gain.T @ whitened)[:, 0]
    of_column = gain @ column.design.T
    fit = -0.5 * (float(np.sum(whitened**2)) + residual) - float(np.log(np.diag(lower)).sum())
    update = replace(
        nothing,
        mean_after=before + column.design @ step,
        covariance_after=covariance - of_column.T @ of_column,
        signal=float(len(lower) - np.sum(inverse**2)),
        log_likelihood=fit - _log_noise(column, judgements),
        rows=rows,
        lower=lower,
        gain=gain,
        whitened=whitened[:, 0],
        square=float(y @ y),
    )
    return update, gain, step


def _evaluated(
    column: Column, before: Array, covariance: Array, probability: float | None
) -> Iterator[tuple[Judgement, Array, tuple[Array, float]]]:
    """Yield the decision on each measurement of a column, its rows, and their values with what the compression left."""
    known: dict[int, tuple[Array, Array]] = {}
    for i, layout in enumerate(column.layouts):
        if id(layout) not in known:
            rows = column.rows(i)
            known[id(layout)] = rows, rows @ covariance @ rows.T
        rows, of_rows = known[id(layout)]
        y, square, left = column.compressed(i)
        yield judged(y - rows @ before, of_rows, (square, left), probability), rows, (y, square)


def combined(
    accepted: Sequence[tuple[Judgement, Array, tuple[Array, float]]],
) -> tuple[Array, Array, float]:
    """Return measurements of a column as rows of unit noise, their values, and the square that these leave of all values."""
    weights = [1.0 / judgement.error_factor for judgement, _, _ in accepted]
    if len(accepted) == 1:
        _, rows, (y, square) = accepted[0]
        return np.sqrt(weights[0]) * rows, np.sqrt(weights[0]) * y, weights[0] * square
    all_rows = np.concatenate(
        [np.sqrt(w) * rows for w, (_, rows, _) in zip(weights, accepted, strict=True)]
    )
    all_y = np.concatenate(
        [np.sqrt(w) * y for w, (_, _, (y, _)) in zip(weights, accepted, strict=True)]
    )
    information, score = all_rows.T @ all_rows, all_rows.T @ all_y
    values, vectors = np.linalg.eigh(information)
    kept = values > _ROUNDING * values[-1]
    roots, vectors = np.sqrt(values[kept]), vectors[:, kept]
    y_all = vectors.T @ score / roots
    left = sum(w * square for w, (_, _, (_, square)) in zip(weights, accepted, strict=True))
    return roots[:, None] * vectors.T, y_all, float(all_y @ all_y - y_all @ y_all) + left


def _log_noise(column: Column, judgements: Sequence[Judgement]) -> float:
    """Return half the logarithm of the determinant of the errors of the measurements accepted."""
    return math.fsum(
        len(column.axes) * layout.half_log_det
        + 0.5 * (judgement.rows + judgement.left) * np.log(judgement.error_factor)
        for layout, judgement in zip(column.layouts, judgements, strict=True)
        if judgement.accepted
    )


def scale_jacobian(update: Update) -> float:
    """Return the derivative of the log-densities' Jacobian with respect to a scale error, at zero: to be subtracted from its score.

    With sound error statements the regressor contains, on average, one unit of the innovation for each component, less the share of the
    platform velocity's error, which is in the innovation alone. The result is scaled by the innovation's own normalised square, because
    errors are often overstated.
    """
    column, total = update.column, 0.0
    for i, judgement in enumerate(update.judgements):
        profile, layout = column.screened.usable_linear[i], column.layouts[i]
        common = _scale_error_std(profile)
        if common is None or not judgement.accepted:
            continue
        rows, (y, _, _) = column.rows(i), column.compressed(i)
        covariance = rows @ update.covariance @ rows.T + judgement.error_factor * np.eye(len(rows))
        off = y - rows @ update.before
        of_one = np.kron(
            np.eye(len(column.axes)), (layout.q.T @ layout.whiten.sum(axis=1))[:, None]
        )
        solved = np.linalg.solve(covariance, np.column_stack([off, of_one]))
        shared = common**2 * float(np.sum(of_one * solved[:, 1:]))
        total += (2.0 - shared) * float(off @ solved[:, 0]) / len(rows)
    return total


def _scale_error_std(profile: LinearMeasurement) -> float | None:
    """Return the error of the platform's velocity [m/s] in a profile that a scale error changes; None for one that it does not."""
    stated = profile.platform_velocity is not None and profile.reference == "absolute"
    return profile.common_std if stated else None
