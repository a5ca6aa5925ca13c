"""Rows and the Cholesky factor of their covariance, which only grow at the end and which all states of a run share."""

from collections.abc import Iterator

import numpy as np
import scipy.linalg.lapack

from replay_kit.core.arrays import Array
from replay_kit.estimator.update.posterior import tiled_product
from replay_kit.estimator.update.rows import ProfileRows

# Rows of L kept together: one product with earlier unknowns for all of them.
_PANEL_ROWS = 256


class GrowingCholesky:
    """Rows and the Cholesky factor of their covariance, which only grow at the end.

    A state owns the first ``n`` profiles. If the factor holds no others, they are extended in place; otherwise another state has already
    continued from this one, and a copy is extended. So no state ever changes, and a run of steps copies nothing.

    Attributes:
        basis: shape (capacity, 2, r), G of each profile; zero where it has one component.
        depth: shape (capacity, Z, Z), R of each, padded with rows of zeros where it has fewer than Z.
        slots: shape (2 Z capacity,), position of each row in (profile, component, row of R).
        forward: shape (2 Z capacity, 1 + b), f.
        ends: Number of rows after 0, 1, 2 ... profiles.
        panels: Panels of L, ``panel_profiles`` profiles each.
    """

    def __init__(self, n_levels: int, n_modes: int, capacity: int, n_columns: int) -> None:
        self.basis = np.zeros((capacity, 2, n_modes))
        self.depth = np.zeros((capacity, n_levels, n_levels))
        self.slots = np.zeros(2 * n_levels * capacity, dtype=np.intp)
        self.forward = np.zeros((2 * n_levels * capacity, n_columns))
        self.ends = [0]
        self.panels: list[tuple[Array, Array]] = []
        self.panel_profiles = max(1, _PANEL_ROWS // (2 * n_levels))

    def extended(self, n: int) -> "GrowingCholesky":
        """Return a factor that holds the first n profiles and room for one more: this one where possible, else a copy."""
        return self if n == len(self.ends) - 1 < len(self.basis) else self._copy(n)

    def rescaled(self, n: int, scale: float) -> "GrowingCholesky":
        """Return a factor of the first n profiles with rows and data multiplied by a number; L is the same."""
        new = self._copy(n)
        new.depth[:n] *= scale
        new.forward[: new.ends[n]] *= scale
        return new

    def dense(self, n: int) -> Array:
        """Return L of the first n profiles as one matrix, shape (K, K)."""
        whole = np.zeros((self.ends[n], self.ends[n]))
        for left, corner, start, stop in self._panels(n):
            whole[start:stop, :start], whole[start:stop, start:stop] = (
                left[:, :start],
                np.tril(corner),
            )
        return whole

    def refactored(self, n: int, lower: Array, forward: Array) -> "GrowingCholesky":
        """Return a factor of the first n profiles' rows with another L, shape (K, K), and another f, shape (K, 1 + b)."""
        new = self._copy(n)
        new.forward[: self.ends[n]] = forward
        panels = []
        for (left, corner), (_, _, start, stop) in zip(new.panels, self._panels(n), strict=True):
            left, corner = np.zeros_like(left), np.zeros_like(corner, order="F")
            left[: stop - start], corner[: stop - start, : stop - start] = (
                lower[start:stop, :start],
                lower[start:stop, start:stop],
            )
            panels.append((left, corner))
        new.panels = panels
        return new

    def _copy(self, n: int) -> "GrowingCholesky":
        _, n_levels, _ = self.depth.shape
        new = GrowingCholesky(n_levels, self.basis.shape[2], max(16, 2 * n), self.forward.shape[1])
        new.basis[:n], new.depth[:n] = self.basis[:n], self.depth[:n]
        rows = self.ends[n]
        new.slots[:rows], new.forward[:rows] = self.slots[:rows], self.forward[:rows]
        new.ends = self.ends[: n + 1]
        # full panels never change again
        full, rest = divmod(n, self.panel_profiles)
        new.panels = self.panels[:full]
        if rest:
            left, corner = self.panels[full]
            new.panels.append((left.copy(), corner.copy(order="F")))
        return new

    def append(
        self, rows: ProfileRows, error_scale: float, before: Array, lower: Array, forward: Array
    ) -> None:
        """Append a profile: its rows over the scale; of L the part left of the diagonal, ``before``, and the diagonal block ``lower``."""
        n, start, (k, n_levels), c = (
            len(self.ends) - 1,
            self.ends[-1],
            rows.r.shape,
            len(rows.basis),
        )
        stop = start + c * k
        self.basis[n, :c], self.depth[n, :k] = rows.basis, rows.r / error_scale
        self.slots[start:stop] = np.add.outer(
            n_levels * (2 * n + np.arange(c)), np.arange(k)
        ).ravel()
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
            solved: shape (., m), rows of the solution for the first full panels.
        """
        known = 0 if solved is None else len(solved)
        out = np.empty((known + len(right), right.shape[1]))
        if solved is not None:
            out[:known] = solved
        for left, corner, start, stop in self._panels(n):
            if start >= known:
                out[start:stop] = _solve(
                    corner,
                    right[start - known : stop - known] - tiled_product(left, out[:start]),
                    0,
                )
        return out

    def solve_transposed(self, n: int, right: Array) -> Array:
        """Return L'^-1 right, of the first n profiles; ``right`` of shape (K, m)."""
        out = right.copy()
        for left, corner, start, stop in reversed(list(self._panels(n))):
            out[start:stop] = _solve(corner, out[start:stop], 1)
            out[:start] -= left.T @ out[start:stop]
        return out

    def _panels(self, n: int) -> Iterator[tuple[Array, Array, int, int]]:
        """Yield each panel's part left of its diagonal block, that block, and its first and last row."""
        for number, (left, corner) in enumerate(self.panels[: -(-n // self.panel_profiles)]):
            first = number * self.panel_profiles
            start, stop = self.ends[first], self.ends[min(first + self.panel_profiles, n)]
            yield left[: stop - start], corner[: stop - start, : stop - start], start, stop


def _solve(corner: Array, right: Array, transposed: int) -> Array:
    """Return the solution of a lower triangular system, or of its transpose; SciPy's own checks would take longer than the solution."""
    solution, info = scipy.linalg.lapack.dtrtrs(corner, right, lower=1, trans=transposed)
    assert info == 0
    return np.asarray(solution)
