"""The posterior in the reduced subspace measured so far: exact, cheap where positions repeat, and of bounded size.

Along a track the modes under the vehicle soon repeat: every G is A B with few directions B (s, r), so every design is h = R (x) A B.
With C = (I (x) B) P0 (I (x) B'), of shape (Z s, Z s), the posterior is

    mean = w0 + P0 (I (x) B') a,    P = P0 - P0 (I (x) B') M (I (x) B) P0,

and a profile whose rows in the directions are g = R (x) A, with innovation e = z - h w0 - g C a, updates

    q = (I - M C) g',    S = I + g C q,    M += q S^-1 q',    a += q S^-1 e.

Instrument errors are further columns of e and a. C is nearly singular, because the directions range from long waves to short ones, but
it is never inverted. A new direction adds zeros to M and a.

Directions are scaled by the prior standard deviation of the weights: B = V' / std and A = G std V with V orthonormal. A vehicle meets
directions one by one, each barely above the tolerance; when room runs out, a singular value decomposition of all A measured replaces
them with fewer that represent the same rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array, replace
from replay_kit.core.flow.covariance import Reduction
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.update.observation_space import ObservationSpacePosterior
from replay_kit.estimator.update.posterior import (
    Posterior,
    PriorCrossCovariance,
    by_component,
    gram,
    new_directions,
    prior_cross_covariances,
    rank_k_update,
    tiled_product,
)
from replay_kit.estimator.update.rows import PredictedObservation, ProfileRows


class Buffer:
    """Rows that only grow at the end, shared by the states of a run.

    A state owns the first n rows. If the buffer holds no others, ``appended`` writes in place; otherwise another state has already
    continued from this one, and it writes to a copy. So no state ever changes, and a run of steps copies nothing.
    """

    def __init__(self, capacity: int, size: int) -> None:
        self.rows = np.zeros((capacity, size))
        self.filled = 0

    def appended(self, n: int, more: Array) -> "Buffer":
        """Return a buffer of the first n rows followed by ``more``: this buffer where possible, else a copy."""
        new = self
        if self.filled != n:
            new = Buffer(*self.rows.shape)
            new.rows[:n] = self.rows[:n]
        new.filled = n + len(more)
        new.rows[n : new.filled] = more
        return new


# Directions whose singular value is below this share of G are dropped when room runs out.
_NEGLIGIBLE = 2.5e-11
# Updates of M are kept as rows up to this number, then added in one product.
_PENDING = 512
# Rows A are kept as measured up to this number, then compressed.
_MEASURED = 256
# Room for new directions: the least, and the share of the existing ones.
_MORE, _MORE_SHARE = 32, 0.25


@dataclass(frozen=True, slots=True, eq=False)
class InDirections(PriorCrossCovariance):
    """The same in the directions of a posterior, which later ones of its matrix M add to.

    Attributes:
        matrix: The posterior's M without pending updates: that of those for which this holds.
        size: Number of its directions.
        n_pending: Number of its pending updates.
        inside: shape (2 k, Z room), g C.
        taken: shape (2 k, Z room), g C M, pending updates included.
    """

    matrix: Array
    size: int
    n_pending: int
    inside: Array
    taken: Array

    def turned(self, r: Array) -> "InDirections":
        """Return the same of other rows; as of the class it inherits from."""
        cross, inside, taken = (
            by_component(r, each) for each in (self.cross, self.inside, self.taken)
        )
        return replace(self, cross=cross, inside=inside, taken=taken)


@dataclass(frozen=True, eq=False)
class ReducedSubspacePosterior(Posterior):
    """The posterior in the reduced subspace; matrices have room for further directions, filled with zeros.

    Attributes:
        mode_std: shape (r,), prior standard deviation of the modes' weights.
        directions: Rows of V', shape (room, r), of which the first ``size`` belong to this posterior.
        size: Number s of directions.
        matrix: shape (Z room, Z room), M without the pending updates.
        amplitude: shape (Z room, 1 + b), a.
        pending: Rows whose Gram matrix is still to be added to M, shape (., Z room); the first ``n_pending`` belong to this posterior.
        n_pending: Their number.
        measured: Rows A, shape (., room), with the Gram matrix of all G measured; the first ``n_measured`` belong to this posterior.
        n_measured: Their number.
    """

    mode_std: Array
    directions: Buffer
    size: int
    matrix: Array
    amplitude: Array
    pending: Buffer
    n_pending: int
    measured: Buffer
    n_measured: int

    @property
    def room(self) -> int:
        """Number of directions there is room for."""
        return len(self.directions.rows)

    @property
    def active_directions(self) -> Array:
        """Rows of V' that belong to this posterior, shape (s, r)."""
        return self.directions.rows[: self.size]

    @staticmethod
    def information_vectors(posteriors: "Sequence[ReducedSubspacePosterior]") -> Array:
        """Return (I (x) B') a of posteriors, shape (m, Z, r)."""
        return np.concatenate([p._to_weights(slice(1)) for p in posteriors])

    def _to_weights(self, columns: slice) -> Array:
        """Return (I (x) B') of some columns of a, shape (., Z, r)."""
        by_level = self.amplitude[:, columns].T.reshape(-1, self.n_levels, self.room)[
            ..., : self.size
        ]
        return np.asarray(by_level @ self.active_directions / self.mode_std)

    def bias_information(self) -> Array:
        """Return (I (x) B') a of the instrument errors of one unit, shape (b, Z, r)."""
        return self._to_weights(slice(1, None))

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, shape (L r, L r)."""
        cov = self.prior.covariance(levels)
        across = self.prior.matvec_modes(self.active_directions / self.mode_std, levels).reshape(
            -1, len(cov)
        )
        rank_k_update(cov, across, -(self._without_room() @ across))
        return cov

    def reduction(self) -> Reduction:
        """Return what the rows took from the prior's covariance of sums of levels."""
        return self.prior.reduction(self.active_directions / self.mode_std, self._without_room())

    def taken(self, most: int) -> tuple[Array, Array] | None:
        """Return B, shape (s, r), and M, shape (Z s, Z s); None with more than ``most`` directions."""
        return (
            None
            if self.size > most
            else (self.active_directions / self.mode_std, self._without_room())
        )

    def covariance_of(self, design: Array) -> Array:
        """Return the covariance of combinations of the weights, shape (m, m); ``design`` of shape (m, Z, r)."""
        cross, m = self.prior.matvec(design), len(design)
        inside = (cross / self.mode_std @ self.active_directions.T).reshape(m, -1)
        return np.asarray(
            design.reshape(m, -1) @ cross.reshape(m, -1).T
            - inside @ self._without_room() @ inside.T
        )

    def rescaled(self, prior: Prior, factor: float) -> "ReducedSubspacePosterior":
        """Return the same mean with the covariance multiplied by a factor, that of ``prior``: M and a are divided by it."""
        flushed = self._flushed()
        return replace(
            flushed, prior=prior, matrix=flushed.matrix / factor, amplitude=self.amplitude / factor
        )

    def predict(
        self, rows: ProfileRows, prefetched: PriorCrossCovariance
    ) -> PredictedObservation[Posterior]:
        """Return the prediction of a profile's rows."""
        return self._with_directions_of(rows.basis)._predict(rows, prefetched)

    @property
    def prefetched_for(self) -> object:
        """Identifies posteriors for which the same ``prefetch`` holds."""
        return self.matrix

    def prefetch(self, profiles: Sequence[ProfileRows]) -> list[PriorCrossCovariance]:
        """Return the parts of coming predictions that do not depend on the order of assimilation: M is read once for all of them."""
        crosses = prior_cross_covariances(self.prior, profiles)
        inside = self._projected(np.concatenate(crosses), slice(0, self.size))
        taken = self._taken_of(inside, 0)
        taken += tiled_product(self.matrix, np.ascontiguousarray(inside.T)).T
        ends = np.cumsum([len(cross) for cross in crosses])[:-1]
        each = zip(crosses, np.split(inside, ends), np.split(taken, ends), strict=True)
        none = np.empty((0, 0))
        return [
            InDirections(cross, none, 0, self.matrix, self.size, self.n_pending, part, product)
            for cross, part, product in each
        ]

    def _projected(self, cross: Array, which: slice) -> Array:
        """Return H P0 of rows in some of the directions, shape (m, Z room), 0 in the others."""
        out = np.zeros((len(cross), self.n_levels, self.room))
        by_row = cross.reshape(-1, cross.shape[2]) / self.mode_std
        part = by_row @ self.directions.rows[which].T
        out[..., which] = part.reshape(len(cross), self.n_levels, -1)
        return out.reshape(len(cross), -1)

    def _taken_of(self, inside: Array, first: int) -> Array:
        """Return g C, shape (m, Z room), times the pending updates from one on."""
        pending = self.pending.rows[first : self.n_pending]
        return np.asarray((inside @ pending.T) @ pending)

    def _predict(
        self, rows: ProfileRows, prefetched: PriorCrossCovariance
    ) -> PredictedObservation[Posterior]:
        if not (isinstance(prefetched, InDirections) and prefetched.matrix is self.matrix):
            (prefetched,) = self.prefetch([rows])
            assert isinstance(prefetched, InDirections)
        g_cross = prefetched.inside
        if self.size > prefetched.size:
            g_cross = g_cross + self._projected(prefetched.cross, slice(prefetched.size, self.size))
        inside = self._with_room((rows.basis * self.mode_std) @ self.active_directions.T)
        q = (rows.r[:, :, None] * inside[:, None, None]).reshape(g_cross.shape)
        q -= prefetched.taken
        q -= self._taken_of(g_cross, prefetched.n_pending)
        cov = g_cross @ q.T
        predicted = self.prior_prediction(rows) + g_cross @ self.amplitude

        def update(lower: Array, whitened: Array, error_scale: float) -> "ReducedSubspacePosterior":
            half_gain = scipy.linalg.solve_triangular(
                lower, q / error_scale, lower=True, check_finite=False
            )
            return self._updated(half_gain, whitened, inside)

        return PredictedObservation(predicted, 0.5 * (cov + cov.T), update)

    def _updated(
        self, half_gain: Array, whitened: Array, inside: Array
    ) -> "ReducedSubspacePosterior":
        """Return the posterior with M and a updated by half gains, shape (2 k, Z room), and with the rows A of G, shape (2, room)."""
        most = len(self.pending.rows) - len(half_gain)
        new = self._flushed() if self.n_pending > most else self
        if new.n_measured + len(inside) > len(new.measured.rows):
            new = new._compressed()
        new = replace(
            new,
            amplitude=self.amplitude + half_gain.T @ whitened,
            pending=new.pending.appended(new.n_pending, half_gain),
            n_pending=new.n_pending + len(half_gain),
            measured=new.measured.appended(new.n_measured, inside),
            n_measured=new.n_measured + len(inside),
        )
        # what is computed of M for a block of profiles holds to its end where M changes between blocks
        return new._flushed() if new.n_pending > most else new

    def _with_room(self, values: Array) -> Array:
        """Return values for the directions, shape (..., s), padded with zeros."""
        out = np.zeros((*values.shape[:-1], self.room))
        out[..., : self.size] = values
        return out

    def _without_room(self) -> Array:
        """Return M, shape (Z s, Z s)."""
        shape = (self.n_levels, self.room, self.n_levels, self.room)
        blocks = self._flushed().matrix.reshape(shape)[:, : self.size, :, : self.size]
        return blocks.reshape(self.n_levels * self.size, -1)

    def _flushed(self) -> "ReducedSubspacePosterior":
        """Return the same posterior without pending updates."""
        matrix, rows = self.matrix.copy(), self.pending.rows[: self.n_pending]
        rank_k_update(matrix, rows, rows)
        return replace(self, matrix=matrix, pending=Buffer(*self.pending.rows.shape), n_pending=0)

    def _compressed(self) -> "ReducedSubspacePosterior":
        """Return the same posterior with the least number of measured rows that have the same Gram matrix."""
        rows = scipy.linalg.qr(self.measured.rows[: self.n_measured, : self.size], mode="r")[0][
            : self.size
        ]
        measured = Buffer(*self.measured.rows.shape).appended(0, self._with_room(rows))
        return replace(self, measured=measured, n_measured=len(rows))

    def _with_directions_of(self, basis: Array) -> "ReducedSubspacePosterior":
        """Return the same posterior with all directions of G."""
        if self.size == basis.shape[1]:
            return self
        more = new_directions(self.active_directions, basis * self.mode_std)
        if not len(more):
            return self
        if self.size + len(more) > self.room:
            return self._in_fewer_directions(more, float(np.linalg.norm(basis * self.mode_std)))
        return replace(
            self, directions=self.directions.appended(self.size, more), size=self.size + len(more)
        )

    def _in_fewer_directions(self, more: Array, length: float) -> "ReducedSubspacePosterior":
        """Return the same posterior in the directions that are not negligible for a G of some length, and in further ones."""
        _, strength, turn = scipy.linalg.svd(
            self.measured.rows[: self.n_measured, : self.size], full_matrices=False
        )
        turn = turn[strength > _NEGLIGIBLE * length]
        half = self._without_room().reshape(-1, self.size) @ turn.T
        turned = np.matmul(turn, half.reshape(self.n_levels, self.size, -1))
        amplitude = (
            self.amplitude.T.reshape(-1, self.n_levels, self.room)[..., : self.size] @ turn.T
        )
        directions = np.vstack([turn @ self.active_directions, more])
        return _Parts(directions, turned, amplitude, np.diag(strength[: len(turn)])).with_room(
            self.prior, self.mode_std, self.prior_bias_sensitivity
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """What a posterior is made of, without room.

    Attributes:
        directions: shape (s, r), orthonormal.
        matrix: shape (Z, s0, Z s0), M in the first s0 of the directions, as are the other parts.
        amplitude: shape (1 + b, Z, s0), a.
        measured: shape (., s0), rows A.
    """

    directions: Array
    matrix: Array
    amplitude: Array
    measured: Array

    def with_room(
        self, prior: Prior, mode_std: Array, prior_bias_sensitivity: Array
    ) -> ReducedSubspacePosterior:
        """Return a posterior of these parts, padded; the arguments are its attributes."""
        size, n_modes = self.directions.shape
        n_columns, n_levels, before = self.amplitude.shape
        room = min(n_modes, size + max(_MORE, int(_MORE_SHARE * size)))
        padding = (0, room - before)
        matrix = np.pad(
            self.matrix.reshape(n_levels, before, n_levels, before),
            ((0, 0), padding, (0, 0), padding),
        )
        amplitude = np.pad(self.amplitude, ((0, 0), (0, 0), padding))
        wide = n_levels * room
        return ReducedSubspacePosterior(
            prior,
            prior_bias_sensitivity,
            mode_std,
            Buffer(room, n_modes).appended(0, self.directions),
            size,
            matrix.reshape(wide, wide),
            np.ascontiguousarray(amplitude.reshape(n_columns, -1).T),
            Buffer(max(_PENDING, 2 * n_levels), wide),
            0,
            Buffer(room + _MEASURED, room).appended(0, np.pad(self.measured, ((0, 0), padding))),
            len(self.measured),
        )


def to_reduced_subspace(
    posterior: ObservationSpacePosterior, directions: Array, mode_std: Array
) -> ReducedSubspacePosterior:
    """Return an observation-space posterior in directions that span all its rows: W = L^-1 H gives M = W'W and a = W'f.

    Args:
        posterior: The posterior.
        directions: shape (s, r), orthonormal.
        mode_std: shape (r,), prior standard deviation of the modes' weights.
    """
    inside = (posterior.profile_basis * mode_std) @ directions.T
    rows = posterior.rows_in(inside)
    matrix = gram(rows)
    measured = scipy.linalg.qr(inside, mode="r")[0][: len(directions)]
    amplitude = (posterior.forward.T @ rows).reshape(-1, posterior.n_levels, len(directions))
    return _Parts(directions, matrix, amplitude, measured).with_room(
        posterior.prior, mode_std, posterior.prior_bias_sensitivity
    )
