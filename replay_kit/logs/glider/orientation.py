"""Where an ADCP looks whose file does not state it: the shear that it measures must agree where its pings overlap."""

import numpy as np

from replay_kit.core.arrays import Array

# cells between two whose difference is a shear; nearer ones differ by noise alone
_APART = 5
_BIN = 5.0  # m of depth in which shears are compared
_LEAST = 3  # shears in a bin
# of the variances within the bins; five dives of a glider whose ADCP looks up have 1.03 to 1.31
_CLEAR = 1.02


def agreement(velocity: Array, depth: Array, distance: Array) -> float:
    """Return how much better shears agree if the instrument looks up than if it looks down: a ratio of variances, above 1 for up.

    The instrument's own motion is the same in all cells of a ping and leaves their differences alone.

    Args:
        velocity: shape (n, k, 2), east and north [m/s]; NaN where missing.
        depth: shape (n,), of the instrument [m].
        distance: shape (k,), of the cells from it [m].

    Returns:
        The ratio; NaN where too few pings overlap.
    """
    shear = velocity[:, _APART:] - velocity[:, :-_APART]
    middle = 0.5 * (distance[_APART:] + distance[:-_APART])
    up, down = (_variance_within(shear, depth[:, None] + sign * middle) for sign in (-1.0, 1.0))
    return down / up if up > 0.0 else float("nan")


def orientation(velocity: Array, depth: Array, distance: Array, notes: list[str]) -> str:
    """Return ``up`` or ``down``, by the agreement of the shears; up where it does not tell.

    Args:
        velocity: As of ``agreement``, as are the next two.
        depth: Of the instrument.
        distance: Of the cells.
        notes: What was found is added here.
    """
    ratio = agreement(velocity, depth, distance)
    found = "down" if ratio < 1.0 / _CLEAR else "up"
    if 1.0 / _CLEAR <= ratio <= _CLEAR or np.isnan(ratio):
        notes.append(
            "ADCP: taken to look up, because neither the file nor its shears tell where it looks"
        )
    else:
        notes.append(
            f"ADCP: looks {found}, by its shears, which agree {max(ratio, 1.0 / ratio):.2f} times as well so as the other way"
        )
    return found


def _variance_within(shear: Array, depth: Array) -> float:
    """Return the variance of shears about the means of their depths' bins; NaN when no bin has enough."""
    known = np.isfinite(shear).all(axis=-1) & np.isfinite(depth) & (depth > 0.0)
    values, at = shear[known], (depth[known] // _BIN).astype(np.int64)
    count = np.bincount(at)
    full = count >= _LEAST
    if not full.any():
        return float("nan")
    means = np.stack(
        [np.bincount(at, component) / np.maximum(count, 1) for component in values.T], axis=-1
    )
    squares = ((values - means[at]) ** 2).sum(axis=-1)
    return float(squares[full[at]].sum() / (count[full] - 1).sum())
