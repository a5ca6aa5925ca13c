"""What legs pass, step after step: depths that are known beforehand, and the levels and times of the flow that count there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.functions import DepthFunctions, depth_weights

#: Steps of the drift at the surface.
DRIFT_STEPS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """What the legs pass: the same numbers of steps for all, each of which has a beginning, a middle and an end.

    Attributes:
        steps: shape (L, N), metres of depth of each step under water, then seconds of each adrift.
        n_wet: Steps under water.
        depth_passed: shape (L, N, 3), metres of depth until there.
        adrift: shape (L, N, 3), seconds adrift until there.
        columns: shape (L, N, 3, k), levels that count there.
        weights: shape (L, N, 3, k), their weights.
        n_levels: Of the flow.
        times: shape (T,) [s]; None for a flow that does not change.
    """

    steps: Array
    n_wet: int
    depth_passed: Array
    adrift: Array
    columns: NDArray[np.intp]
    weights: Array
    n_levels: int
    times: Array | None

    @property
    def lengths(self) -> Array:
        """Metres of depth that each leg passes, shape (L,)."""
        return np.asarray(np.sum(self.steps[:, : self.n_wet], axis=1))

    @property
    def n_derived(self) -> int:
        """Number of what a leg depends on: begin, heading, glide angle, and the time where the current changes."""
        return 4 if self.times is None else 5

    def stages(self, values: Array) -> Array:
        """Return what belongs to the stages of the midpoint method, shape (L, S, ...): two a step."""
        return values[:, :, :2].reshape(len(values), -1, *values.shape[3:])

    def columns_at(self, times: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the columns that count, shape (L, N, 3, k'), and their weights in the current and its rate, (L, N, 3, m, k').

        Args:
            times: shape (L, N, 3) [s].
        """
        if self.times is None:
            return self.columns, self.weights[..., None, :]
        before = np.clip(
            np.searchsorted(self.times, times, side="right") - 1, 0, self.times.size - 2
        )
        spacing = self.times[before + 1] - self.times[before]
        share = (times - self.times[before]) / spacing
        within, share = ((share >= 0.0) & (share <= 1.0)) / spacing, np.clip(share, 0.0, 1.0)
        columns = np.concatenate(
            [self.columns + (self.n_levels * (before + later))[..., None] for later in (0, 1)],
            axis=-1,
        )
        of_time = np.stack(
            [np.stack([1.0 - share, share], axis=-1), np.stack([-within, within], axis=-1)], axis=-2
        )
        return columns, (of_time[..., None] * self.weights[..., None, None, :]).reshape(
            *of_time.shape[:4], -1
        )


def schedule_of(
    depths: Sequence[Array],
    drifts: Array,
    adrift: bool,
    levels: Array,
    functions: DepthFunctions,
    times: Array | None,
) -> Schedule:
    """Return the schedule of legs.

    Args:
        depths: Of the ends of each leg's steps, shape (n + 1,) each [m].
        drifts: shape (L,) [s], after each leg.
        adrift: Whether there are drifts at all.
        levels: shape (Z,) [m].
        functions: How levels combine.
        times: Of the flow, shape (T,) [s]; None for one that does not change.
    """
    at, count, shares = np.array(depths), DRIFT_STEPS * int(adrift), np.array([0.0, 0.5, 1.0])
    wet, n_legs = np.abs(np.diff(at, axis=1)), len(at)
    middles = 0.5 * (at[:, :-1] + at[:, 1:])
    stages = np.concatenate(
        [np.stack([at[:, :-1], middles, at[:, 1:]], axis=2), np.zeros((n_legs, count, 3))], axis=1
    )
    steps = np.concatenate([wet, drifts[:, None] / DRIFT_STEPS * np.ones(count)], axis=1)
    until = [np.zeros((n_legs, steps.shape[1], 3)) for _ in range(2)]
    for kind, chosen in zip(
        until, (slice(0, wet.shape[1]), slice(wet.shape[1], None)), strict=True
    ):
        passed = np.cumsum(steps[:, chosen], axis=1)
        kind[:, chosen] = (passed - steps[:, chosen])[..., None] + steps[:, chosen, None] * shares
    until[0][:, wet.shape[1] :] = wet.sum(axis=1)[:, None, None]
    columns, weights = _of_levels(stages, levels, functions)
    return Schedule(steps, wet.shape[1], until[0], until[1], columns, weights, levels.size, times)


def _of_levels(
    depths: Array, levels: Array, functions: DepthFunctions
) -> tuple[NDArray[np.intp], Array]:
    """Return which levels count at each depth, and their weights: as many for each as the most that count at one."""
    different, which = np.unique(depths, return_inverse=True)
    weights = depth_weights(functions, different, levels)
    most = int(np.max(np.sum(weights != 0.0, axis=1)))
    columns = np.sort(np.argsort(weights == 0.0, axis=1, kind="stable")[:, :most], axis=1)
    shape = (*depths.shape, most)
    return columns[which.ravel()].reshape(shape), np.take_along_axis(weights, columns, axis=1)[
        which.ravel()
    ].reshape(shape)
