"""Functions of depth: how the level coefficients of a flow combine at a depth.

``hat`` is piecewise linear between levels. ``gaussian`` is the paper's squared exponential of length lz. Both are constant
above the first level and below the last: the flow there is that of the nearest level.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True)
class DepthFunctions:
    """Kind and length of the depth functions.

    Attributes:
        kind: ``hat`` or ``gaussian``.
        length: lz [m]; not used by hats.
    """

    kind: Literal["hat", "gaussian"]
    length: float


def depth_weights(functions: DepthFunctions, depth: Array, levels: Array) -> Array:
    """Return the value of each level's function at each depth, shape (n, Z).

    Args:
        functions: Kind and length.
        depth: shape (n,) [m], positive down.
        levels: shape (Z,) [m], increasing.
    """
    depth = np.clip(depth, levels[0], levels[-1])
    if functions.kind == "gaussian":
        return np.asarray(np.exp(-0.5 * ((depth[:, None] - levels) / functions.length) ** 2))
    weights = np.zeros((depth.size, levels.size))
    if levels.size == 1:
        weights[:, 0] = 1.0
        return weights
    upper = np.clip(np.searchsorted(levels, depth, side="right") - 1, 0, levels.size - 2)
    fraction = (depth - levels[upper]) / (levels[upper + 1] - levels[upper])
    rows = np.arange(depth.size)
    weights[rows, upper] = 1.0 - fraction
    weights[rows, upper + 1] = fraction
    return weights
