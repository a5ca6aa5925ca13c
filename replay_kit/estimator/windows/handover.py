"""Information of one window as measurements for the next.

Both windows estimate the current in their overlap, each in its own basis. Let v be up to a thousand combinations of velocities there: the
directions in which the first basis varies, times its depth functions. With the first window's prior and posterior of v, N(m0, C0) and N(m1,
C1), the information of its measurements is a likelihood, independent of the prior. Along the eigenvectors a of C0 - C1 relative to C0, with
eigenvalues l in 0..1, it is that of a measurement

    a v = a m0 + a (m1 - m0) / l   with error variance (1 - l) / l,

as N(0, 1) and that measurement give the variance 1 - l and the mean a (m1 - m0). Directions with l = 0 carry no information and are
dropped. The second window assimilates these as measurements of its own unknowns; its prior extends them outside the overlap. Nothing counts
twice, as the first window's prior is not handed over.

Parts that the second basis or the combinations cannot represent are added to the errors and returned as the loss.
"""

from dataclasses import replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.functions import with_potential
from replay_kit.core.flow.process import Process
from replay_kit.core.geodesy import inside_grid, nearest_node
from replay_kit.core.grid import Grid
from replay_kit.estimator.estimator import ReducedBasisEstimator
from replay_kit.estimator.state import State, conditioned
from replay_kit.estimator.update.assimilate import lower_solved
from replay_kit.estimator.update.columns import Observer

# Points of an overlap at most: every second or third row and column of a window's own.
_POINTS = 600
# Share of the variance at the overlap's points that the combinations may leave out in the horizontal.
_LEFT_OUT = 1e-3
# Combinations at most: the work goes with the cube of their number, some seconds for so many.
_MOST = 1000
# Variances below this share of the largest are rounding; directions in which less than this share was learnt are left out.
_ROUNDING, _LEAST_LEARNT = 1e-8, 0.01


def hand_over(
    before: ReducedBasisEstimator, state: State, after: ReducedBasisEstimator
) -> tuple[State, float]:
    """Return the next window's first state, with the information of the previous one in their overlap.

    Args:
        before: Estimator of the previous window.
        state: Its last state.
        after: Estimator of the next window, in the same local frame and with the same levels.

    Returns:
        State, and RMS of the information lost [m/s], per component.
    """
    begun = _initial_state(state, before, after)
    points = overlap(before.grid, after.grid)
    if not len(points):
        return begun, 0.0
    (old, modes, offset), (new, next_modes, next_offset) = (
        _at(each.observer, points) for each in (before, after)
    )
    vertical, across = old.functions, _combinations(old, modes)
    design = _design(old, vertical, across.T @ modes)
    cross = state.products(design)
    directions, share = _learnt_directions(design @ design.T, cross @ design.T)
    if not share.size:
        return begun, 0.0
    change = modes @ (old.weights(state.x, 0) - old.mean_at(0)).T  # (2P, Z)
    held = across @ (across.T @ change @ vertical.T) @ vertical
    # of which the next basis has its least-squares fit
    lost = change - next_modes @ np.linalg.lstsq(next_modes, held, rcond=1e-6)[0]
    # what is lost is as smooth as the combinations, not white from point to point: all of it lies in as many unknowns as there are of them
    missed = np.sum(lost**2, axis=0) / across.shape[1]
    unheld = after.observer.error(begun.scale, nearest_node(after.grid, points, wet=True)) ** 2
    error = np.repeat(vertical**2 @ (unheld.mean(axis=1) + missed), across.shape[1])
    lower = np.linalg.cholesky(np.diag((1.0 - share) / share) + (directions * error) @ directions.T)
    # what is known at zero unknowns differs too
    known = (vertical @ (offset - next_offset).T @ across).ravel()
    values = directions @ (design @ state.x) / share + directions @ known
    rows = directions @ _design(new, vertical, across.T @ next_modes)
    whitened = lower_solved(lower, np.column_stack([rows, values]))
    after_rows = conditioned(begun, whitened[:, :-1], whitened[:, -1])
    return replace(after_rows, profiles=state.profiles), float(np.sqrt(np.mean(lost**2)))


def _initial_state(
    state: State, before: ReducedBasisEstimator, after: ReducedBasisEstimator
) -> State:
    """Return the next window's state before the hand-over, under the prior of the same members as revised by the log."""
    first = after.initial()
    begun = replace(first, time_ns=state.time_ns, last=state.last, measured=state.measured)
    if before.evidence is None or after.evidence is None:
        return begun
    p, part, centre = begun.p.copy(order="F"), after.evidence.parts.scaled, state.centre
    p[part, part] *= state.scale
    if centre is not None:
        # in the unit of a member's anomaly, which goes with the share of the sample covariance
        centre = centre * (after.evidence.parts.anomaly / before.evidence.parts.anomaly)
    doubt = None if state.doubt is None else begun.doubt
    return replace(begun, p=p, revised=state.revised, centre=centre, doubt=doubt)


def overlap(one: Grid, other: Grid) -> Array:
    """Return points in the overlap of two windows, shape (P, 2) [m]: nodes of the first, thinned to some hundreds."""
    wet = one.wet[0] & inside_grid(other, one.east, one.north)
    every = max(1, int(np.ceil(np.sqrt(wet.sum() / _POINTS))))
    thin = np.zeros_like(wet)
    thin[::every, ::every] = True
    chosen = wet & thin
    return np.column_stack([one.east[chosen], one.north[chosen]])


def _at(observer: Observer, points: Array) -> tuple[Process, Array, Array]:
    """Return the process, and velocities at points: of the modes, shape (2P, r), and for zero unknowns, shape (2P, Z)."""
    basis, process = observer.basis, observer.process
    modes = basis.horizontal.velocity(points, basis.modes).reshape(2 * len(points), -1)
    offset = with_potential(basis.horizontal, points, basis.offset, basis.potential)
    return process, modes, offset.reshape(len(modes), -1) + modes @ process.mean_at(0).T


def _design(process: Process, vertical: Array, modes: Array) -> Array:
    """Return the effect of a unit of each unknown on combinations of velocities in depth functions, shape (q c, k).

    Args:
        process: Process of the unknowns.
        vertical: shape (q, Z), depth functions.
        modes: shape (c, r), effect of each mode on each combination.
    """
    between = vertical @ process.functions.T
    rows = np.einsum("qf,kfr,cr->qck", between, process.loading(0), modes, optimize=True)
    return np.asarray(rows.reshape(-1, process.size))


def _combinations(process: Process, modes: Array) -> Array:
    """Return orthonormal combinations of the velocities at points, shape (2P, k)."""
    std = np.sqrt(np.square(process.loading(0)).sum(axis=(0, 1)))
    across, strength, _ = np.linalg.svd(modes * std, full_matrices=False)
    most = max(_MOST // len(process.functions), 1)
    rest = 1.0 - np.cumsum(strength**2) / np.sum(strength**2)
    most = max(_MOST // len(process.functions), 1)
    return np.asarray(across[:, : min(int(np.argmax(rest <= _LEFT_OUT)) + 1, most)])


def _learnt_directions(before: Array, after: Array) -> tuple[Array, Array]:
    """Return informative directions a, shape (m, n), with a C0 a' = 1 and a C1 a' = 1 - l, and l, shape (m,).

    Args:
        before: shape (n, n), C0.
        after: shape (n, n), C1.
    """
    values, vectors = np.linalg.eigh(0.5 * (before + before.T))
    real = values > _ROUNDING * values[-1]
    whiten = (vectors[:, real] / np.sqrt(values[real])).T
    left, turn = np.linalg.eigh(whiten @ (0.5 * (after + after.T)) @ whiten.T)
    share = 1.0 - np.maximum(left, _ROUNDING)
    chosen = share > _LEAST_LEARNT
    return turn[:, chosen].T @ whiten, share[chosen]
