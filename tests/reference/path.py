"""The mean along a polyline, by walking it in small steps of time."""

import numpy as np


def time_mean(times, values, steps=200):
    """Mean over time of values that are linear between the times given."""
    total = 0.0
    for k in range(len(times) - 1):
        shares = (np.arange(steps) + 0.5) / steps
        total += (times[k + 1] - times[k]) * np.mean(
            values[k] + shares * (values[k + 1] - values[k])
        )
    return total / (times[-1] - times[0])
