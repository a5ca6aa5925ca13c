"""The usable profiles of a group as arrays, whitened and compressed as ``rows.py`` does with one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.observation import LinearMeasurement
from replay_kit.estimator.update.biases import bias_rows, scale_error_std
from replay_kit.estimator.update.rows import BinNoise, compress

#: Joint factor and noise of a profile's used bins: shapes (m, q) and of m bins.
Factors = Callable[[LinearMeasurement, NDArray[np.intp]], tuple[Array, BinNoise]]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """What profiles with the same depths, errors and used bins have in common, padded with zeros where a bin is not used.

    Attributes:
        rows: shape (q, n), from velocities to compressed rows, Q'W.
        whiten: shape (n, n), W.
        unwhiten: shape (n, n).
        q: shape (n, q), Q.
        r: shape (q, q), R.
        distance: shape (n,) [m], from the first used bin.
        std: shape (n,) [m/s], stated error of each bin; zero where not used.
        dof: Number of measured values of both components.
        k: Number of compressed rows of a component.
        half_log_det: Of one component's error covariance.
    """

    rows: Array
    whiten: Array
    unwhiten: Array
    q: Array
    r: Array
    distance: Array
    std: Array
    dof: int
    k: int
    half_log_det: float


def layout_of(observation: LinearMeasurement, used: NDArray[np.intp], factors: Factors) -> Layout:
    """Return the layout of a profile's used bins."""
    joint, noise = factors(observation, used)
    q, r = compress(noise, joint)
    n, (known, k), width = observation.depth.size, q.shape, joint.shape[1]
    whiten, unwhiten, wide, square = (
        np.zeros((n, n)),
        np.zeros((n, n)),
        np.zeros((n, width)),
        np.zeros((width, width)),
    )
    whiten[:known, used], unwhiten[used, :known], wide[:known, :k], square[:k] = (
        noise.whiten,
        noise.unwhiten,
        q,
        r,
    )
    distance, std = np.zeros(n), np.zeros(n)
    distance[used], std[used] = (
        np.abs(observation.depth[used] - observation.depth[used[0]]),
        noise.std,
    )
    return Layout(
        wide.T @ whiten,
        whiten,
        unwhiten,
        wide,
        square,
        distance,
        std,
        2 * known,
        k,
        noise.half_log_det,
    )


@dataclass(frozen=True, eq=False)
class ProfileStack:
    """The usable profiles of a group, as arrays.

    Attributes:
        observations: The n profiles.
        used: shape (n, m), which bins are used.
        values: shape (n, m, 2) [m/s], local axes, about the estimator's reference current; 0 where not used.
        relative: shape (n, 2) [m/s], mean velocity of the used bins relative to the platform; None where the log does not state it.
        layouts: Those that occur.
        layout: shape (n,), each profile's.
    """

    observations: tuple[LinearMeasurement, ...]
    used: NDArray[np.bool_]
    values: Array
    relative: Array | None
    layouts: tuple[Layout, ...]
    layout: NDArray[np.intp]

    @cached_property
    def y(self) -> Array:
        """Compressed rows, shape (n, 2, q)."""
        return np.asarray(np.matmul(self.of("rows"), self.values).swapaxes(1, 2))

    @cached_property
    def residual_square(self) -> Array:
        """Squared norm of the compression residual, shape (n,)."""
        whitened = np.matmul(self.of("whiten"), self.values)
        return np.asarray(
            np.maximum(np.sum(whitened**2, axis=(1, 2)) - np.sum(self.y**2, axis=(1, 2)), 0.0)
        )

    def of(self, name: str) -> Array:
        """Return an attribute of the layouts: of each profile, shape (n, ...), or of all, shape (1, ...), where they have the same."""
        if len(self.layouts) == 1:
            return np.asarray(getattr(self.layouts[0], name))[None]
        return np.stack([np.asarray(getattr(layout, name)) for layout in self.layouts])[self.layout]

    def part(self, rows: NDArray[np.intp]) -> "ProfileStack":
        """Return some of the profiles."""
        kept = np.unique(self.layout[rows])
        found = ProfileStack(
            tuple(self.observations[i] for i in rows),
            self.used[rows],
            self.values[rows],
            None if self.relative is None else self.relative[rows],
            tuple(self.layouts[i] for i in kept),
            np.searchsorted(kept, self.layout[rows]),
        )
        # what was computed of all is not computed again
        for name in ("y", "residual_square"):
            found.__dict__[name] = getattr(self, name)[rows]
        return found

    def misfit(self, rows: Array) -> Array:
        """Return measured minus predicted bins, shape (n, m, 2) [m/s], 0 where not used; ``rows``, shape (n, 2, q), are predicted."""
        return np.asarray(np.matmul(self.of("unwhiten"), self.whitened_misfit(rows)))

    def whitened_misfit(self, rows: Array) -> Array:
        """Return the same in units of their error."""
        return np.asarray(
            np.matmul(self.of("whiten"), self.values) - np.matmul(self.of("q"), rows.swapaxes(1, 2))
        )

    @property
    def ones(self) -> Array:
        """The rows of a velocity of one in all used bins, shape (n, q)."""
        return np.asarray(
            np.matmul(self.of("rows"), self.used[..., None].astype(np.float64))[..., 0]
        )

    @property
    def scale_error_std(self) -> Array | None:
        """See ``biases.scale_error_std``, shape (n,); None where the first has none."""
        stds = [scale_error_std(observation) for observation in self.observations]
        return None if stds[0] is None else np.array(stds, dtype=np.float64)

    def bias_rows(self, misfit: Array) -> Array | None:
        """Return the effect of instrument errors of one unit on the rows, shape (n, 2, q, 3); see ``biases.bias_rows``.

        Args:
            misfit: shape (n, m, 2) [m/s], measured minus predicted bins.
        """
        if self.relative is None:
            return None
        growing = np.matmul(self.of("rows"), self.of("distance")[..., None])[..., 0]
        mean = misfit.sum(axis=1) / self.used.sum(axis=1)[:, None]
        return bias_rows(self.ones, growing, self.relative, mean)


def stacked(
    observations: Sequence[LinearMeasurement],
    used: NDArray[np.bool_],
    values: Array,
    relative: Array | None,
    factors: Factors,
) -> ProfileStack:
    """Return profiles as arrays; the arguments are those of ``ProfileStack``, and what makes a layout."""
    found: dict[tuple[bytes, bytes, bytes, float], int] = {}
    layouts: list[Layout] = []
    which = np.empty(len(observations), np.intp)
    for i, (observation, bins) in enumerate(zip(observations, used, strict=True)):
        key = (
            observation.depth.tobytes(),
            observation.error_std.tobytes(),
            bins.tobytes(),
            observation.common_std,
        )
        if key not in found:
            found[key] = len(layouts)
            layouts.append(layout_of(observation, np.flatnonzero(bins), factors))
        which[i] = found[key]
    return ProfileStack(
        tuple(observations),
        used,
        np.where(used[..., None], values, 0.0),
        relative,
        tuple(layouts),
        which,
    )
