"""What the consistency checks need of a ping, bin by bin."""

import math
import statistics
from itertools import pairwise


def summary(ping, repairable, at_surface, levels, mean_square):
    """Return near mean (depth, east, north) or None, whether it is above the surface or None, and its speed numbers or None."""
    bins = [
        (depth, u, v, error, reason)
        for depth, (u, v), error, reason in zip(
            ping.depth.tolist(),
            ping.velocity.tolist(),
            ping.error_std.tolist(),
            ping.reasons.tolist(),
            strict=True,
        )
        if math.isfinite(u) and math.isfinite(v)
    ]
    good = [each for each in bins if not each[4] & ~repairable]
    near, above, speed = None, None, None
    if good:
        close = [each for each in good if abs(each[0] - good[0][0]) <= 100.0]
        near = (good[0][0], *(math.fsum(each[k] for each in close) / len(close) for k in (1, 2)))
    told = [each[0] for each in bins if not each[4] & at_surface]
    if told:
        above = sum(depth < 0.0 for depth in told) > len(told) / 2
    if good and math.isfinite(ping.common_std):
        squares = statistics.median_high([u * u + v * v for _, u, v, _, _ in good])
        typical = math.fsum(_interpolated(each[0], levels, mean_square) for each in good) / len(
            good
        )
        speed = squares, typical, math.fsum(each[3] for each in good) / len(good)
    return near, above, speed


def _interpolated(depth, levels, values):
    if depth <= levels[0]:
        return values[0]
    for (a, b), (x, y) in zip(pairwise(levels), pairwise(values), strict=True):
        if depth <= b:
            return x + (depth - a) / (b - a) * (y - x)
    return values[-1]
