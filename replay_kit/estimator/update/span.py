"""The posterior by the directions measured so far: exact, cheap where positions repeat, and bounded however long the log.

Along a track the modes under the vehicle soon repeat themselves: every G is A B with few directions B (s, r), so every design is
h = R (x) A B. With C = (I (x) B) P0 (I (x) B'), of shape (Z s, Z s), the posterior is

    mean = w0 + P0 (I (x) B') a,    P = P0 - P0 (I (x) B') M (I (x) B) P0,

and a profile whose rows in the directions are g = R (x) A, with innovation e = z - h w0 - g C a, updates

    q = (I - M C) g',    S = I + g C q,    M += q S^-1 q',    a += q S^-1 e.

Errors of the instrument are further columns of e and a. C is nearly singular, as directions go from long waves to short, but nothing
inverts it. A new direction adds zeros to M and a.

What counts as a direction is measured in what a weight of one prior standard deviation does: B = V' / std and A = G std V with V
orthonormal. A vehicle meets directions one by one and late, each barely above the tolerance; a singular value decomposition of all A
seen finds fewer that hold the same, and replaces them when room runs out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.update.buffer import Buffer
from replay_kit.estimator.update.directions import new_directions
from replay_kit.estimator.update.dual import Dual
from replay_kit.estimator.update.kalman import ProfileRows
from replay_kit.estimator.update.posterior import Ahead, Look, Posterior, add_gram, add_symmetric, means, times_columns, times_rows

# Directions that all of them together hold with this share of G are left out when room runs out.
_NOT_NEEDED = 2.5e-11
# Updates of M kept as rows until they are as many, then added in one product.
_PENDING = 512
# Rows A kept as they are until they are as many, then summarised.
_SEEN = 256
# Room made for new directions, at least, and as a share of those there are.
_MORE, _MORE_SHARE = 32, 0.25


@dataclass(frozen=True, eq=False)
class Span:
    """The posterior in the span form; matrices have room for more directions than there are, zeros until then.

    Attributes:
        prior: Of the weights.
        mode_std: shape (r,), prior standard deviation of the modes' weights.
        directions: Rows of V', shape (room, r), of which the first ``size`` are this posterior's.
        size: Number s of directions.
        matrix: shape (Z room, Z room), M without what is pending.
        amplitude: shape (Z room, 1 + b), a.
        pending: Updates of M, rows of which it gains the Gram matrix, shape (., Z room); the first ``n_pending`` are this posterior's.
        n_pending: Their number.
        seen: Rows A, shape (., room), that hold all directions seen as strongly as all G did; the first ``n_seen`` are this posterior's.
        n_seen: Their number.
        prior_answers: shape (b, Z, r), what errors of one unit added to the prior's mean.
    """

    prior: Prior
    mode_std: Array
    directions: Buffer
    size: int
    matrix: Array
    amplitude: Array
    pending: Buffer
    n_pending: int
    seen: Buffer
    n_seen: int
    prior_answers: Array

    @property
    def room(self) -> int:
        """Number of directions there is room for."""
        return len(self.directions.rows)

    @property
    def n_levels(self) -> int:
        """Number of levels Z."""
        return len(self.amplitude) // self.room

    @property
    def taken(self) -> Array:
        """Rows of V' that are this posterior's, shape (s, r)."""
        return self.directions.rows[: self.size]

    @property
    def family(self) -> Any:
        """The prior: each posterior has a source of its own."""
        return self.prior

    @cached_property
    def mean(self) -> Array:
        """Mean of the weights, shape (Z r,), level after level."""
        return np.asarray(means([self])[0])

    @staticmethod
    def sources(posteriors: "Sequence[Span]") -> Array:
        """Return (I (x) B') a of posteriors, shape (m, Z, r)."""
        return np.concatenate([p._sources(slice(1)) for p in posteriors])

    def _sources(self, columns: slice) -> Array:
        """Return (I (x) B') of some columns of a, shape (., Z, r)."""
        by_level = self.amplitude[:, columns].T.reshape(-1, self.n_levels, self.room)[..., : self.size]
        return np.asarray(by_level @ self.taken / self.mode_std)

    def answers(self) -> Array:
        """Return what errors of one unit would have added to the mean, shape (b, Z, r)."""
        return self.prior_answers + self.prior.times(self._sources(slice(1, None)))

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of the weights of some levels, None for all, shape (L r, L r)."""
        cov = self.prior.dense(levels)
        across = self.prior.times_modes(self.taken / self.mode_std, levels).reshape(-1, len(cov))
        add_symmetric(cov, across, -(self._without_room() @ across))
        return cov

    def ahead(self, profiles: Sequence[ProfileRows]) -> list[Ahead]:
        """Return what can be computed of coming profiles before any of them counts."""
        spread = self.prior.times_modes(np.concatenate([rows.basis for rows in profiles]))
        nothing = np.empty((0, 0))
        return [Ahead(times_rows(spread[:, 2 * i : 2 * i + 2], rows.r), nothing, 0) for i, rows in enumerate(profiles)]

    def look(self, rows: ProfileRows, ahead: Ahead) -> Look[Posterior]:
        """Return what the posterior expects of a profile's rows."""
        return self._with_directions_of(rows.basis)._look(rows, ahead)

    def _look(self, rows: ProfileRows, ahead: Ahead) -> Look[Posterior]:
        n_levels, pending = self.n_levels, self.pending.rows[: self.n_pending]
        inside = self._with_room((rows.basis * self.mode_std) @ self.taken.T)
        spread = ahead.cross / self.mode_std
        g_cross = self._with_room(spread @ self.taken.T).reshape(len(spread), -1)
        q = -times_columns(self.matrix, np.ascontiguousarray(g_cross.T)).T - (g_cross @ pending.T) @ pending
        q += np.einsum("kz,cs->ckzs", rows.r, inside).reshape(q.shape)
        cov = g_cross @ q.T
        prior_mean = rows.times(self.prior.mean.reshape(n_levels, -1))
        seen = g_cross @ self.amplitude

        def absorb(lower: Array, whitened: Array, error_scale: float) -> "Span":
            half_gain = scipy.linalg.solve_triangular(lower, q / error_scale, lower=True, check_finite=False)
            return self._updated(half_gain, whitened, inside)

        return Look(prior_mean + seen[:, 0], rows.times(self.prior_answers).T + seen[:, 1:], 0.5 * (cov + cov.T), absorb)

    def _updated(self, half_gain: Array, whitened: Array, inside: Array) -> "Span":
        """Return the posterior with M and a updated by rows whose Gram matrix M gains, shape (2 k, Z room), and G's A among those seen."""
        new = self._flushed() if self.n_pending + len(half_gain) > len(self.pending.rows) else self
        if new.n_seen + 2 > len(new.seen.rows):
            new = new._summarised()
        return replace(
            new,
            amplitude=self.amplitude + half_gain.T @ whitened,
            pending=new.pending.appended(new.n_pending, half_gain),
            n_pending=new.n_pending + len(half_gain),
            seen=new.seen.appended(new.n_seen, inside),
            n_seen=new.n_seen + 2,
        )

    def _with_room(self, values: Array) -> Array:
        """Return values of the directions, shape (..., s), with zeros for room."""
        out = np.zeros((*values.shape[:-1], self.room))
        out[..., : self.size] = values
        return out

    def _without_room(self) -> Array:
        """Return M, shape (Z s, Z s)."""
        shape = (self.n_levels, self.room, self.n_levels, self.room)
        blocks = self._flushed().matrix.reshape(shape)[:, : self.size, :, : self.size]
        return blocks.reshape(self.n_levels * self.size, -1)

    def _flushed(self) -> "Span":
        """Return the same posterior with nothing pending."""
        matrix = self.matrix.copy()
        add_gram(matrix, self.pending.rows[: self.n_pending], 1.0)
        return replace(self, matrix=matrix, pending=Buffer(*self.pending.rows.shape), n_pending=0)

    def _summarised(self) -> "Span":
        """Return the same posterior with as few rows of those seen as hold their Gram matrix."""
        rows = scipy.linalg.qr(self.seen.rows[: self.n_seen, : self.size], mode="r")[0][: self.size]
        seen = Buffer(*self.seen.rows.shape).appended(0, self._with_room(rows))
        return replace(self, seen=seen, n_seen=len(rows))

    def _with_directions_of(self, basis: Array) -> "Span":
        """Return the same posterior with directions enough for G."""
        if self.size == basis.shape[1]:
            return self
        more = new_directions(self.taken, basis * self.mode_std)
        if not len(more):
            return self
        if self.size + len(more) > self.room:
            return self._in_fewer_directions(more, float(np.linalg.norm(basis * self.mode_std)))
        return replace(self, directions=self.directions.appended(self.size, more), size=self.size + len(more))

    def _in_fewer_directions(self, more: Array, length: float) -> "Span":
        """Return the same posterior in the directions that G of some length have, more ones, and room."""
        _, strength, turn = scipy.linalg.svd(self.seen.rows[: self.n_seen, : self.size], full_matrices=False)
        turn = turn[strength > _NOT_NEEDED * length]
        half = self._without_room().reshape(-1, self.size) @ turn.T
        turned = np.matmul(turn, half.reshape(self.n_levels, self.size, -1))
        amplitude = self.amplitude.T.reshape(-1, self.n_levels, self.room)[..., : self.size] @ turn.T
        directions = np.vstack([turn @ self.taken, more])
        return _build(self.prior, self.mode_std, directions, turned, amplitude, np.diag(strength[: len(turn)]), self.prior_answers)


def _build(prior: Prior, mode_std: Array, directions: Array, matrix: Array, amplitude: Array, seen: Array, prior_answers: Array) -> Span:
    """Return a posterior of parts without room, adding room.

    Args:
        prior: Of the weights.
        mode_std: shape (r,).
        directions: shape (s, r), orthonormal.
        matrix: shape (Z, s0, Z s0), M in the first s0 of them, as are the others.
        amplitude: shape (1 + b, Z, s0).
        seen: shape (., s0).
        prior_answers: shape (b, Z, r).
    """
    size, n_modes = directions.shape
    n_columns, n_levels, before = amplitude.shape
    room = min(n_modes, size + max(_MORE, int(_MORE_SHARE * size)))
    padded = np.zeros((n_levels, room, n_levels, room))
    padded[:, :before, :, :before] = matrix.reshape(n_levels, before, n_levels, before)
    wide = n_levels * room
    return Span(
        prior,
        mode_std,
        Buffer(room, n_modes).appended(0, directions),
        size,
        padded.reshape(wide, wide),
        np.ascontiguousarray(np.pad(amplitude, ((0, 0), (0, 0), (0, room - before))).reshape(n_columns, -1).T),
        Buffer(max(_PENDING, 2 * n_levels), wide),
        0,
        Buffer(room + _SEEN, room).appended(0, np.pad(seen, ((0, 0), (0, room - before)))),
        len(seen),
        prior_answers,
    )


def mode_scale(prior: Prior) -> Array:
    """Return the prior standard deviation of the modes' weights, shape (r,), not quite zero where it is."""
    std = prior.mode_std()
    return np.asarray(np.maximum(std, 1e-12 * std.max() or 1.0))


def span_of(dual: Dual, directions: Array, mode_std: Array) -> Span:
    """Return the posterior of the dual form in directions that hold all its rows: W = L^-1 H gives M = W'W and a = W'f.

    Args:
        dual: The posterior.
        directions: shape (s, r), orthonormal.
        mode_std: shape (r,), prior standard deviation of the modes' weights.
    """
    inside = (dual.places * mode_std) @ directions.T
    rows = dual.log.solve(dual.n, dual.design(inside))
    matrix = np.zeros((rows.shape[1], rows.shape[1]))
    add_gram(matrix, rows, 1.0)
    seen = scipy.linalg.qr(inside, mode="r")[0][: len(directions)]
    n_levels = len(matrix) // len(directions)
    amplitude = (dual.forward.T @ rows).reshape(-1, n_levels, len(directions))
    return _build(dual.prior, mode_std, directions, matrix, amplitude, seen, dual.prior_answers)
