"""Slow twins of the estimate through time: all observations at once, as one Gaussian."""

import numpy as np
from scipy.linalg import block_diag


def joint(sea, designs, times, values, at, counted=None):
    """Mean and covariance of the weights at a time, from rows at their own times.

    Args:
        sea: The prior through time.
        designs: for each observation (m, Z r), rows of the weights with unit noise.
        times: for each observation [ns].
        values: for each observation (m,), about the offset.
        at: [ns].
        counted: for each observation, when its unknowns are those of the sea [ns]; None for its own time.
    """
    counted = times if counted is None else counted

    def loading(t):
        return sea.loading(t).reshape(sea.size, -1)

    def covariance(t, t_counted, s, s_counted):
        kept = np.exp(-abs(t_counted - s_counted) / 1e9 / sea.scales)
        return loading(t).T @ (kept[:, None] * loading(s))

    seen = list(zip(designs, times, counted, strict=True))
    blocks = [[h @ covariance(t, tc, s, sc) @ g.T for g, s, sc in seen] for h, t, tc in seen]
    c = np.block(blocks) + np.eye(sum(map(len, designs)))
    cross = np.hstack([covariance(at, at, s, sc) @ g.T for g, s, sc in seen])
    innovation = np.concatenate(
        [v - h @ sea.mean_at(t).ravel() for h, t, v in zip(designs, times, values, strict=True)]
    )
    gain = cross @ np.linalg.inv(c)
    return sea.mean_at(at).ravel() + gain @ innovation, covariance(at, at, at, at) - gain @ cross.T


class WithConstants:
    """A prior through time beside unknowns of unit variance that never change, after the weights."""

    def __init__(self, sea, count):
        self.sea, self.count, self.size = sea, count, sea.size + count
        self.scales = np.append(sea.scales, np.full(count, np.inf))

    def loading(self, t):
        return block_diag(self.sea.loading(t).reshape(self.sea.size, -1), np.eye(self.count))

    def mean_at(self, t):
        return np.append(self.sea.mean_at(t).ravel(), np.zeros(self.count))


def turned(pairs, omega, seconds):
    """A vector of (first, second) turned by omega dt, with the complex exponential."""
    z = (pairs[..., 0] + 1j * pairs[..., 1]) * np.exp(-1j * omega * seconds)
    return np.stack([z.real, z.imag], axis=-1)
