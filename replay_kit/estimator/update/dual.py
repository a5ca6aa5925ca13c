"""The posterior by the rows measured so far: exact, and cheap while they are fewer than the weights.

With all rows H (K, Z r), their whitened data z and the prior N(w0, P0):

    C = H P0 H' + I = L L',    f = L^-1 (z - H w0),    mean = w0 + P0 H' L^-T f,    P = P0 - (L^-1 H P0)' (L^-1 H P0).

A profile h appends to L the rows [x', chol(S)] with x = L^-1 H P0 h', S = I + h P0 h' - x'x, and to f what its innovation
z - h w0 - x'f is when whitened by S. Nothing before it changes: all states of a run share one log of rows, which grows at its end.
What errors of the instrument would have added to z are further columns of z and f.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg.lapack

from replay_kit.core.arrays import Array
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.update.kalman import ProfileRows
from replay_kit.estimator.update.posterior import Ahead, Look, Posterior, add_gram, means, times_columns, times_rows

# Rows of L kept together: one product with earlier unknowns for all of them.
_PANEL_ROWS = 256


class RowLog:
    """Rows and their Cholesky factor, which only ever grow at the end.

    A state owns the first ``n`` profiles of the log. It appends in place when the log holds no others; else another state went on from
    it before, and it goes on with a copy. So no state ever changes, and a run of steps copies nothing.

    Attributes:
        basis: shape (capacity, 2, r), G of each profile.
        depth: shape (capacity, Z, Z), R of each, with rows of zeros when it has fewer than Z.
        slots: shape (2 Z capacity,), of each row its position in (profile, component, row of R).
        forward: shape (2 Z capacity, 1 + b), f.
        ends: Number of rows after 0, 1, 2 ... profiles.
        panels: Of L, of ``panel_profiles`` profiles each.
    """

    def __init__(self, n_levels: int, n_modes: int, capacity: int, n_columns: int) -> None:
        self.basis = np.zeros((capacity, 2, n_modes))
        self.depth = np.zeros((capacity, n_levels, n_levels))
        self.slots = np.zeros(2 * n_levels * capacity, dtype=np.intp)
        self.forward = np.zeros((2 * n_levels * capacity, n_columns))
        self.ends = [0]
        self.panels: list[tuple[Array, Array]] = []
        self.panel_profiles = max(1, _PANEL_ROWS // (2 * n_levels))

    def extended(self, n: int) -> "RowLog":
        """Return a log that has the first n profiles and room for one more: this one, if it can be."""
        if n == len(self.ends) - 1 < len(self.basis):
            return self
        _, n_levels, _ = self.depth.shape
        new = RowLog(n_levels, self.basis.shape[2], max(16, 2 * n), self.forward.shape[1])
        new.basis[:n], new.depth[:n] = self.basis[:n], self.depth[:n]
        rows = self.ends[n]
        new.slots[:rows], new.forward[:rows] = self.slots[:rows], self.forward[:rows]
        new.ends = self.ends[: n + 1]
        # panels that are full never change again
        full, rest = divmod(n, self.panel_profiles)
        new.panels = self.panels[:full]
        if rest:
            left, corner = self.panels[full]
            new.panels.append((left.copy(), corner.copy(order="F")))
        return new

    def append(self, rows: ProfileRows, error_scale: float, before: Array, lower: Array, forward: Array) -> None:
        """Append a profile: its rows over the scale, and of L the rows' part ``before`` and their own ``lower``."""
        n, start, k = len(self.ends) - 1, self.ends[-1], rows.r.shape[0]
        stop, n_levels = start + 2 * k, self.depth.shape[1]
        self.basis[n], self.depth[n, :k] = rows.basis, rows.r / error_scale
        self.slots[start:stop] = np.add.outer(n_levels * (2 * n + np.arange(2)), np.arange(k)).ravel()
        self.forward[start:stop] = forward
        if n % self.panel_profiles == 0:
            height = 2 * n_levels * self.panel_profiles
            self.panels.append((np.zeros((height, start)), np.zeros((height, height), order="F")))
        left, corner = self.panels[-1]
        first = self.ends[n - n % self.panel_profiles]
        inside = slice(start - first, stop - first)
        left[inside] = before[:, :first]
        corner[inside, : start - first] = before[:, first:]
        corner[inside, inside] = lower
        self.ends.append(stop)

    def solve(self, n: int, right: Array, solved: Array | None = None) -> Array:
        """Return L^-1 right, of the first n profiles.

        Args:
            n: Number of profiles.
            right: shape (K, m), or its last rows when the first are solved.
            solved: shape (., m), rows of the answer for the first full panels.
        """
        known = 0 if solved is None else len(solved)
        out = np.empty((known + len(right), right.shape[1]))
        if solved is not None:
            out[:known] = solved
        for left, corner, start, stop in self._panels(n):
            if start >= known:
                out[start:stop] = _solve(corner, right[start - known : stop - known] - times_columns(left, out[:start]), 0)
        return out

    def solve_transposed(self, n: int, right: Array) -> Array:
        """Return L'^-1 right, of the first n profiles; ``right`` of shape (K, m)."""
        out = right.copy()
        for left, corner, start, stop in reversed(list(self._panels(n))):
            out[start:stop] = _solve(corner, out[start:stop], 1)
            out[:start] -= left.T @ out[start:stop]
        return out

    def _panels(self, n: int) -> Iterator[tuple[Array, Array, int, int]]:
        """Yield each panel's part left of its corner, its corner, and its first and last row."""
        for number, (left, corner) in enumerate(self.panels[: -(-n // self.panel_profiles)]):
            first = number * self.panel_profiles
            start, stop = self.ends[first], self.ends[min(first + self.panel_profiles, n)]
            yield left[: stop - start], corner[: stop - start, : stop - start], start, stop


def _solve(corner: Array, right: Array, transposed: int) -> Array:
    """Return the solution of a lower triangular system, or of its transpose; SciPy's own function checks longer than this works."""
    solution, info = scipy.linalg.lapack.dtrtrs(corner, right, lower=1, trans=transposed)
    assert info == 0
    return np.asarray(solution)


@dataclass(frozen=True, eq=False)
class Dual:
    """The posterior in the dual form.

    Attributes:
        prior: Of the weights.
        log: Rows, of which the first ``n`` profiles are this posterior's.
        n: Number of profiles.
        prior_answers: shape (b, Z, r), what errors of one unit added to the prior's mean.
    """

    prior: Prior
    log: RowLog
    n: int
    prior_answers: Array

    @property
    def n_rows(self) -> int:
        """Number of rows K."""
        return self.log.ends[self.n]

    @property
    def n_levels(self) -> int:
        """Number of levels Z."""
        return int(self.log.depth.shape[1])

    @property
    def forward(self) -> Array:
        """f, shape (K, 1 + b)."""
        return self.log.forward[: self.n_rows]

    @property
    def family(self) -> Any:
        """The log: posteriors of one log share its factor."""
        return self.log

    @cached_property
    def mean(self) -> Array:
        """Mean of the weights, shape (Z r,), level after level."""
        return np.asarray(means([self])[0])

    @staticmethod
    def sources(posteriors: "Sequence[Dual]") -> Array:
        """Return H' L'^-1 f of posteriors of one log, shape (m, Z, r); zeros below f leave L'^-1 f as it is without those rows."""
        last = max(posteriors, key=lambda posterior: posterior.n)
        forward = np.zeros((last.n_rows, len(posteriors)))
        for column, posterior in enumerate(posteriors):
            forward[: posterior.n_rows, column] = posterior.forward[:, 0]
        return last._back(forward)

    def _back(self, forward: Array) -> Array:
        """Return H' L'^-1 of columns, shape (K, m), in the shape (m, Z, r)."""
        log, n, m, n_levels = self.log, self.n, forward.shape[1], self.n_levels
        padded = np.zeros((m, n * 2 * n_levels))
        padded[:, log.slots[: self.n_rows]] = log.solve_transposed(n, forward).T
        by_level = np.matmul(padded.reshape(m, n, 2, n_levels), log.depth[:n])
        at_places = by_level.reshape(m, 2 * n, n_levels).swapaxes(1, 2).reshape(m * n_levels, 2 * n)
        return np.asarray(at_places @ self.places).reshape(m, n_levels, self.places.shape[1])

    def answers(self) -> Array:
        """Return what errors of one unit would have added to the mean, shape (b, Z, r)."""
        return self.prior_answers + self.prior.times(self._back(self.forward[:, 1:]))

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of the weights of some levels, None for all, shape (L r, L r)."""
        cov = self.prior.dense(levels)
        add_gram(cov, self.whitened_cross(levels), -1.0)
        return cov

    def whitened_cross(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the columns of L^-1 H P0 of some levels, None for all, shape (K, L r)."""
        spread = self.prior.times_modes(self.places, levels)  # (Z, 2 n, L, r)
        width = spread.shape[2] * spread.shape[3]
        return self.log.solve(self.n, self._rows_of(spread.transpose(1, 0, 2, 3).reshape(2 * self.n, self.n_levels, width)))

    def design(self, inside: Array) -> Array:
        """Return H with the modes expressed in directions, shape (K, Z s).

        Args:
            inside: shape (2 n, s), all G in the directions.
        """
        n_levels = self.n_levels
        by_level = inside[:, None, None] * np.eye(n_levels)[..., None]  # (2 n, Z, Z, s)
        return self._rows_of(by_level.reshape(len(inside), n_levels, n_levels * inside.shape[1]))

    def ahead(self, profiles: Sequence[ProfileRows]) -> list[Ahead]:
        """Return what can be computed of coming profiles before any of them counts: L is read once for all of them."""
        spread = self.prior.times_modes(np.concatenate([rows.basis for rows in profiles]))
        crosses = [times_rows(spread[:, 2 * i : 2 * i + 2], rows.r) for i, rows in enumerate(profiles)]
        n_solved = self.n - self.n % self.log.panel_profiles
        solved = self.log.solve(n_solved, self._rows_times(np.concatenate(crosses), 0, n_solved))
        ends = np.cumsum([len(cross) for cross in crosses])
        return [Ahead(cross, solved[:, end - len(cross) : end], n_solved) for cross, end in zip(crosses, ends, strict=True)]

    def look(self, rows: ProfileRows, ahead: Ahead) -> Look[Posterior]:
        """Return what the posterior expects of a profile's rows."""
        before = self.log.solve(self.n, self._rows_times(ahead.cross, ahead.n_solved, self.n), ahead.solved)
        cov = rows.times(ahead.cross) - before.T @ before
        prior_mean = rows.times(self.prior.mean.reshape(self.n_levels, -1))
        seen = before.T @ self.forward

        def absorb(lower: Array, whitened: Array, error_scale: float) -> "Dual":
            log = self.log.extended(self.n)
            log.append(rows, error_scale, before.T / error_scale, lower, whitened)
            return Dual(self.prior, log, self.n + 1, self.prior_answers)

        return Look(prior_mean + seen[:, 0], rows.times(self.prior_answers).T + seen[:, 1:], 0.5 * (cov + cov.T), absorb)

    @property
    def places(self) -> Array:
        """G of all profiles, shape (2 n, r)."""
        return self.log.basis[: self.n].reshape(2 * self.n, self.log.basis.shape[2])

    def _rows_times(self, cross: Array, first: int, last: int) -> Array:
        """Return the rows of some profiles times something's transpose, shape (., m); ``cross`` of shape (m, Z, r)."""
        across = cross.transpose(1, 0, 2).reshape(-1, cross.shape[2])  # (Z m, r), levels first
        at_places = self.places[2 * first : 2 * last] @ across.T
        return self._rows_of(at_places.reshape(2 * (last - first), cross.shape[1], len(cross)), first)

    def _rows_of(self, at_places: Array, first: int = 0) -> Array:
        """Return the rows, shape (., m), of something given at each level for each profile's G from one on, shape (2 n, Z, m)."""
        n, n_levels = len(at_places) // 2, self.n_levels
        width = at_places.shape[2]
        by_profile = at_places.reshape(n, 2, n_levels, width)
        rows: Array = np.matmul(self.log.depth[first : first + n, None], by_profile).reshape(2 * n * n_levels, width)
        return rows[self.log.slots[self.log.ends[first] : self.log.ends[first + n]] - 2 * n_levels * first]


def initial(prior: Prior, answers: Array) -> Dual:
    """Return a prior as a posterior of no rows.

    Args:
        prior: Of the weights.
        answers: shape (b, Z, r), what errors of one unit added to its mean.
    """
    n_errors, n_levels, n_modes = answers.shape
    return Dual(prior, RowLog(n_levels, n_modes, 16, 1 + n_errors), 0, answers)
