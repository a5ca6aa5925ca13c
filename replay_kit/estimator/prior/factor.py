"""Hybrid prior: members, their shifted copies, local directions, and the amplitude of the ensemble mean.

Every member is used unshifted and, with half the weight each, shifted to the four sides. The shape of eddies in the members holds for
eddies nearby too (spatial averages of covariances, Berre and Desroziers 2010, Mon. Wea. Rev. 138; valid-space shifting, Xu et al. 2011).
The sample covariance of so many members still has chance correlations between distant places, and low rank. The localised part (hybrid
covariance, Hamill and Snyder 2000) has full rank and no distant correlations (``localised.py``).

The hybrid covariance a cov(members and shifted copies) + (1 - a) localised is the sum of outer products of patterns, each with an
unknown of unit variance (``core/flow/process.py``). The localised part keeps the directions above a bound, the depth structure the
vertical functions above another. The dropped variance is part of the stated error, point by point.
"""

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.process import Process
from replay_kit.estimator.basis.shifts import SHIFT_WEIGHTS, ShiftedModes
from replay_kit.estimator.prior.localised import localised_part

# Bound for vertical functions over that for directions.
_VERTICAL_SHARE = 1.0 / 3.0
# Share of the largest spread below which the members are equal to rounding.
_LEAST_SPREAD = 1e-3
# Nodes at which the largest variance is looked for, at most.
_NODES = 600


@dataclass(frozen=True, slots=True)
class PriorSettings:
    """Settings of a hybrid prior.

    Attributes:
        sample_share: Share of the sample covariance; the localised one has the rest.
        shift: Distance of the shifted copies [m]; 0 makes none.
        radius: Distance at which the localised part's taper reaches zero [m].
    """

    sample_share: float
    shift: float
    radius: float

    def __str__(self) -> str:
        """Return the settings as text."""
        shift, radius = self.shift / 1e3, self.radius / 1e3
        return f"sample share {self.sample_share:.2f}, members shifted by {shift:.1f} km, taper to zero at {radius:.1f} km"


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """Kinds of the prior's unknowns.

    Attributes:
        members: Number of members E, whose unknowns are the first of the sample.
        sample: Unknowns of members and copies.
        has_amplitude: Whether the first unknown is the ensemble mean's amplitude.
        anomaly: Value of a member's unknown for its own anomaly.
        amplitude_variance: Prior variance of the amplitude.
    """

    members: int
    sample: slice
    has_amplitude: bool
    anomaly: float
    amplitude_variance: float

    @property
    def scaled(self) -> slice:
        """Unknowns with a prior variance that the log may scale: members and local directions."""
        return slice(int(self.has_amplitude), None)


def process_of(
    weights: Array,
    modes: ShiftedModes,
    settings: PriorSettings,
    mean_weights: Array | None,
    mean_variance: float,
    bound: float,
) -> tuple[Process, Parts, Array]:
    """Return the prior process without times, its kinds of unknowns, and the error of dropping patterns.

    Args:
        weights: Members' weights at each forecast time, shape (T, E, Z, r).
        modes: Modes with shift operators.
        settings: Share, shift and radius.
        mean_weights: Weights of the ensemble mean, shape (Z, r); None if certain.
        mean_variance: Variance of its amplitude.
        bound: Upper bound of the standard deviation of dropped directions [m/s].

    Returns:
        Process with ``times_ns`` and ``tau`` unset; kinds; error, shape (Z, N) [m/s].
    """
    n_members, share = weights.shape[1], settings.sample_share
    mean = weights.mean(axis=1)
    anomalies = (weights - mean[:, None]) / np.sqrt(n_members - 1.0)
    copies = np.stack([modes.copies(each) for each in anomalies])
    spread = np.sqrt(np.sum(anomalies**2, axis=(1, 2, 3)))
    heights, directions = np.empty((0, mean.shape[1])), np.empty((0, mean.shape[2]))
    dropped = np.zeros((mean.shape[1], len(modes.nodes)))
    if share < 1.0:
        heights, directions, dropped = local_directions(copies, spread, modes, settings, bound)
    moving = np.sqrt(share) * copies
    if mean_weights is not None:
        amplitude = np.sqrt(mean_variance) * (mean_weights + mean)
        moving = np.concatenate([amplitude[:, None], moving], axis=1)
    largest, at_nodes = (spread.max() * heights, directions), some_nodes(modes.velocity_modes)
    functions, left = vertical_functions(moving, largest, at_nodes, _VERTICAL_SHARE * bound)
    process = Process(
        np.zeros(len(weights), np.int64),
        mean,
        functions @ moving,
        (heights @ functions.T)[:, :, None] * directions[:, None],
        spread,
        functions,
        np.full(moving.shape[1] + len(heights), np.inf),
    )
    unshifted = SHIFT_WEIGHTS[0] if copies.shape[1] > n_members else 1.0
    first = moving.shape[1] - copies.shape[1]
    parts = Parts(
        n_members,
        slice(first, first + copies.shape[1]),
        bool(first),
        float(np.sqrt((n_members - 1.0) / share) / unshifted) if share > 0.0 else 0.0,
        mean_variance,
    )
    return process, parts, np.hypot(dropped, left[:, None])


def local_directions(
    copies: Array, spread: Array, modes: ShiftedModes, settings: PriorSettings, bound: float
) -> tuple[Array, Array, Array]:
    """Return the directions of the localised covariance at unit spread, and the standard deviation of dropped ones.

    Args:
        copies: Anomalies of members and copies, shape (T, F, Z, r).
        spread: Spread of the members, shape (T,).
        modes: Modes at the nodes.
        settings: Share and radius.
        bound: See ``process_of``.

    Returns:
        Vertical function of each direction, shape (B, Z); its mode weights, a factor, shape (B, r); standard deviation, shape (Z, N) [m/s].
    """
    apart = times_with_spread(spread)
    normalised = copies[apart] / spread[apart, None, None, None] / np.sqrt(apart.size)
    functions, horizontal = localised_part(
        normalised.reshape(-1, *copies.shape[2:]), modes, settings.radius
    )
    values, vectors = np.linalg.eigh(horizontal)
    root = np.sqrt((1.0 - settings.sample_share) * np.maximum(values, 0.0))
    directions = spread.max() * root[:, None, :] * vectors  # (g, r, r), of the largest spread
    group = np.minimum(np.arange(len(functions)), len(horizontal) - 1)
    height = np.square(functions)

    # the smallest are dropped, while all together stay below the bound everywhere
    some = np.square(some_nodes(modes.velocity_modes) @ directions)  # (g, 2P, r)
    size = some.max(axis=1)[group] * height.max(axis=1)[:, None]
    order = np.argsort(size, axis=None).argsort().reshape(size.shape)

    groups = [np.flatnonzero(group == g) for g in range(len(directions))]

    def of_levels(n: int) -> list[Array]:
        """Return the share of the n smallest directions at each level, by group, shapes (Z, r)."""
        return [height[columns].T @ (order[columns] < n) for columns in groups]

    def largest(n: int) -> float:
        each = zip(of_levels(n), some, strict=True)
        return float(np.max(sum(counts @ at.T for counts, at in each)))

    n = bisect_right(range(1, size.size + 1), bound**2, key=largest) if bound else 0
    q, b = np.nonzero(order >= n)
    left = np.zeros((len(height.T), len(modes.velocity_modes)))
    for counts, columns in zip(of_levels(n), directions, strict=True):
        used = counts.any(axis=0)
        left += counts[:, used] @ np.square(modes.velocity_modes @ columns[:, used]).T
    error = np.sqrt(left.reshape(len(left), 2, -1).mean(axis=1))
    return functions[q], directions[group[q], :, b] / spread.max(), error


def some_nodes(velocity_modes: Array) -> Array:
    """Return the modes at an even subset of nodes, shape (2P, r), enough to find the maximum of a smooth variance."""
    by_component = velocity_modes.reshape(2, -1, velocity_modes.shape[1])
    step = -(-by_component.shape[1] // _NODES)
    return by_component[:, ::step].reshape(-1, velocity_modes.shape[1])


def vertical_functions(
    moving: Array, fixed: tuple[Array, Array], velocity_modes: Array, bound: float
) -> tuple[Array, Array]:
    """Return the leading orthonormal vertical functions of patterns, shape (K, Z), and the error without the others, shape (Z,) [m/s].

    Args:
        moving: Patterns at each time, shape (T, F, Z, r).
        fixed: Vertical functions, shape (B, Z), and mode weights, shape (B, r), of the constant patterns.
        velocity_modes: Modes at some nodes, shape (2P, r) [m/s per unit weight].
        bound: Upper bound of the standard deviation of all dropped functions together [m/s].
    """
    heights, directions = fixed
    scaled = heights * np.linalg.norm(directions, axis=1)[:, None]
    flat = np.moveaxis(moving, 2, 0).reshape(heights.shape[1], -1)
    covariance = flat @ flat.T + scaled.T @ scaled
    functions = np.linalg.eigh(covariance)[1].T[::-1]

    def largest(function: Array) -> float:
        """Return the largest variance of a function, over the nodes and times."""
        of_function = (heights @ function)[:, None] * directions
        at_any_time = np.sum(
            (velocity_modes @ (of_function.T @ of_function)) * velocity_modes, axis=1
        )
        each = (velocity_modes @ np.tensordot(at, function, (1, 0)).T for at in moving)
        return float(max(np.max(np.square(one).sum(axis=1) + at_any_time) for one in each))

    left, total = np.zeros(functions.shape[1]), 0.0
    for n in range(len(functions), 1, -1):
        variance = largest(functions[n - 1])
        total += variance
        if total > bound**2:
            return functions[:n], np.sqrt(left)
        left += functions[n - 1] ** 2 * variance
    return functions[:1], np.sqrt(left)


def times_with_spread(spread: Array) -> NDArray[np.intp]:
    """Return the positions of the times at which members differ; all may start from one analysis."""
    return np.flatnonzero(spread > _LEAST_SPREAD * spread.max())
