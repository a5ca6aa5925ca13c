"""The information of one window, as measurements for the next.

Both windows know the current where they overlap, each in its own basis. There v are up to a thousand combinations of the velocities at
points of the overlap: the directions in which the first basis varies there, times functions of depth. With the first window's prior and
posterior of v, N(m0, C0) and N(m1, C1), all the information of its measurements on v is a likelihood, whatever the prior was. Along the
eigenvectors a of C0 - C1 relative to C0, with eigenvalues l in 0..1, it is that of a measurement

    a v = a m0 + a (m1 - m0) / l   with error variance (1 - l) / l,

as N(0, 1) and that measurement give the variance 1 - l and the mean a (m1 - m0). Directions with l = 0 taught nothing, and are left
out. The second window takes these as measurements of its own weights: outside the overlap its own prior carries them on. Nothing is
counted twice: the first window's prior is not handed over, for the second has its own of the same members.

What the second basis cannot represent, and what the combinations leave out, is added to the errors, and returned as the loss.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import inside_grid
from replay_kit.core.grid import Grid
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.prior.conditioned import conditioned
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.static.filter import ReducedBasisEstimator
from replay_kit.estimator.static.state import FilterState
from replay_kit.estimator.update.observation_space import initial
from replay_kit.estimator.update.posterior import Posterior

# Points of an overlap at most: every second or third row and column of a window's own.
_POINTS = 600
# Share of the variance at the overlap's points that the combinations may leave out, in the horizontal and in depth.
_LEFT_OUT = 1e-3
# Combinations at most: the work goes with the cube of their number, some seconds for so many.
_MOST = 1000
# Variances below this share of the largest are rounding; directions in which less than this share was learnt are left out.
_ROUNDING, _LEAST_LEARNT = 1e-8, 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """What a window learnt of the velocities at some points, as measurements y = A u + noise of unit variance.

    Attributes:
        directions: shape (m, q, k), A in combinations of the points for each function of depth.
        across: shape (2P, k), the combinations; all east components before all north.
        vertical: shape (q, Z), the functions of depth.
        values: shape (m, 1 + b), y; and its change for instrument errors of one unit.
        loss: Root mean square of what was learnt and is not in them [m/s], each component.
    """

    directions: Array
    across: Array
    vertical: Array
    values: Array
    loss: float

    def of(self, velocity: Array) -> Array:
        """Return A u, shape (m,), of velocities at the points, shape (2P, Z)."""
        return np.asarray(
            np.einsum("mqk,kq->m", self.directions, self.across.T @ velocity @ self.vertical.T)
        )

    def design(self, modes: Array) -> Array:
        """Return A of weights, shape (m, Z, r), of modes with these velocities at the points, shape (2P, r)."""
        of_modes = self.directions @ (self.across.T @ modes)  # (m, q, r)
        return np.asarray(np.einsum("mqr,qz->mzr", of_modes, self.vertical))


def hand_over(
    before: ReducedBasisEstimator, state: FilterState, after: ReducedBasisEstimator
) -> tuple[FilterState, float]:
    """Return the next window's first state, with the information of the one before where they overlap, and the loss [m/s].

    The amplitudes of the prior's covariance and of the ensemble mean, where they are fitted to the log, are kept as they are from then on.

    Args:
        before: Estimator of the window before.
        state: Its last state.
        after: Estimator of the next window, in the same local frame and with the same levels.
    """
    old, new = before.prior, after.prior
    spread = None if state.spread is None else replace(state.spread, apart=(), past=None)
    if spread is not None:
        old, new = spread.scale(old), spread.scale(new)
    amplitude = None if state.mean_amplitude is None else state.mean_amplitude.ended()
    if amplitude is not None:
        old, new = before.prior_with(amplitude), after.prior_with(amplitude)
    no_bias = np.zeros((len(state.posterior.prior_bias_sensitivity), *after.prior_weights.shape))
    begun = replace(state, posterior=initial(new, no_bias), spread=spread, mean_amplitude=amplitude)
    points = overlap(before.basis.grid, after.basis.grid)
    said = None
    if len(points):
        next_modes, next_offset = velocities_at(after.basis, points)
        said = learnt(
            old,
            state.posterior,
            *velocities_at(before.basis, points),
            next_modes,
            after.representation_std,
        )
    if said is None:
        # the log has no information on the mean's amplitude elsewhere
        elsewhere = new if amplitude is None else after.prior
        return replace(
            begun, posterior=initial(elsewhere, no_bias), mean_amplitude=after.mean_amplitude
        ), 0.0
    innovation = said.values.copy()
    innovation[:, 0] -= said.of(next_offset + next_modes @ after.by_level(new.mean).T)
    prior, sensitivity = conditioned(new, said.design(next_modes), innovation)
    return replace(begun, posterior=initial(prior, sensitivity)), said.loss


def overlap(one: Grid, other: Grid) -> Array:
    """Return points at which two windows both know the current, shape (P, 2) [m]: nodes of the first, thinned to some hundreds."""
    wet = one.wet[0] & inside_grid(other, one.east, one.north)
    every = max(1, int(np.ceil(np.sqrt(wet.sum() / _POINTS))))
    thin = np.zeros_like(wet)
    thin[::every, ::every] = True
    chosen = wet & thin
    return np.column_stack([one.east[chosen], one.north[chosen]])


def velocities_at(basis: Basis, points: Array) -> tuple[Array, Array]:
    """Return the velocities at points of the modes, shape (2P, r), and of the flow without weights, shape (2P, Z)."""
    modes, offset = (
        basis.horizontal.velocity(points, latent) for latent in (basis.modes, basis.offset)
    )
    return modes.reshape(2 * len(points), -1), offset.reshape(2 * len(points), -1)


def learnt(
    prior: Prior,
    posterior: Posterior,
    modes: Array,
    offset: Array,
    next_modes: Array,
    representation_std: Array,
) -> Learnt | None:
    """Return the information of a window at points; None without any.

    Args:
        prior: Of the window's weights, before any measurement.
        posterior: Of the same weights, now.
        modes: shape (2P, r), velocities of the window's modes at the points.
        offset: shape (2P, Z), velocities there of the flow without weights.
        next_modes: shape (2P, r'), of the next window's modes.
        representation_std: shape (Z,) [m/s], what the next window's basis does not represent.
    """
    n_levels = posterior.n_levels
    change = modes @ (posterior.mean - prior.mean).reshape(n_levels, -1).T  # (2P, Z)
    across, vertical = _combinations(prior, modes)
    kept = _projected(next_modes, across @ (across.T @ change @ vertical.T) @ vertical)
    lost = change - kept
    design = np.einsum("qz,kr->qkzr", vertical, across.T @ modes).reshape(
        -1, n_levels, modes.shape[1]
    )
    flat = design.reshape(len(design), -1)
    before, after = (
        flat @ prior.matvec(design).reshape(flat.shape).T,
        posterior.covariance_of(design),
    )
    directions, share = _learnt_directions(before, after)
    if not share.size:
        return None
    # what is lost is as smooth as the combinations, not white from point to point: all of it lies in as many unknowns as there are of them
    missed = np.sum(lost**2, axis=0) / across.shape[1]
    error = np.repeat(vertical**2 @ (representation_std**2 + missed), across.shape[1])
    lower = np.linalg.cholesky(np.diag((1.0 - share) / share) + (directions * error) @ directions.T)
    shifts = np.column_stack(
        [posterior.mean - prior.mean, posterior.bias_sensitivity().reshape(-1, flat.shape[1]).T]
    )
    measured = np.column_stack([directions, directions @ (flat @ shifts) / share[:, None]])
    whitened = np.asarray(scipy.linalg.solve_triangular(lower, measured, lower=True))
    rows, values = whitened[:, : directions.shape[1]], whitened[:, directions.shape[1] :]
    found = Learnt(
        rows.reshape(len(rows), len(vertical), -1),
        across,
        vertical,
        values,
        float(np.sqrt(np.mean(lost**2))),
    )
    values[:, 0] += found.of(offset + modes @ prior.mean.reshape(n_levels, -1).T)
    return found


def _combinations(prior: Prior, modes: Array) -> tuple[Array, Array]:
    """Return orthonormal combinations of the velocities at points, shape (2P, k), and functions of depth, shape (q, Z)."""
    across, strength, _ = np.linalg.svd(modes * prior.mode_std(), full_matrices=False)
    across = across[:, : _count(strength**2)]
    # covariance between levels, of the first combinations together
    leading = across[:, :5].T @ modes
    of_levels = prior.matvec_modes(leading)  # (Z, c, Z, r)
    values, vectors = np.linalg.eigh(np.einsum("zcyr,cr->zy", of_levels, leading))
    count = _count(np.maximum(values[::-1], 0.0))
    return across[:, : max(_MOST // count, 1)], vectors.T[::-1][:count]


def _count(variance: Array) -> int:
    """Return how many variances, the largest first, hold all but the share that may be left out."""
    rest = variance.sum() - np.cumsum(variance)
    return int(np.argmax(rest <= _LEFT_OUT * variance.sum())) + 1


def _projected(modes: Array, velocity: Array) -> Array:
    """Return the least-squares fit of velocities, shape (2P, Z), by modes."""
    return np.asarray(modes @ np.linalg.lstsq(modes, velocity, rcond=1e-6)[0])


def _learnt_directions(before: Array, after: Array) -> tuple[Array, Array]:
    """Return directions a, shape (m, n), with a C0 a' = 1 and a C1 a' = 1 - l, and l, shape (m,), of those that were learnt.

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
