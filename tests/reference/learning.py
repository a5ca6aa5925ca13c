"""The slow twins of plans that learn: dense covariances of all weights or all unknowns, paths one by one."""

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.evolution import Evolution


def static_rows(flow: FlowEstimate, shares: Array, points: Array) -> Array:
    """Return the rows of depth means at points on all weights, shape (2 P, Z r): east and north of each in turn."""
    rows = []
    for point in points:
        basis = flow.horizontal.velocity(point[None], flow.modes)[:, 0]
        rows += [
            np.concatenate([share * basis[component] for share in shares]) for component in (0, 1)
        ]
    return np.array(rows)


def covariance_through_time(
    flow: FlowEstimate, shares: Array, points: Array, times_ns: Array
) -> Array:
    """Return the covariance of depth means at points and times, shape (2 P, 2 P), from the unknowns of the process one pair at a time."""
    evolution = flow.later
    assert isinstance(evolution, Evolution)
    process, begin = (
        evolution.process,
        flow.time_ns if evolution.time_ns is None else evolution.time_ns,
    )
    rows, after = [], []
    for point, time_ns in zip(points, times_ns, strict=True):
        basis = flow.horizontal.velocity(point[None], flow.modes)[:, 0]
        loading = np.einsum("nzr,z->nr", process.loading(int(time_ns)), shares)
        rows += [loading @ basis[0], loading @ basis[1]]
        after += [(int(time_ns) - begin) / 1e9] * 2
    now, out = evolution.covariance(), np.zeros((len(rows), len(rows)))
    for i, (one, t) in enumerate(zip(rows, after, strict=True)):
        for j, (other, s) in enumerate(zip(rows, after, strict=True)):
            first, last = min(t, s), max(t, s)
            at_first = (
                np.exp(-first / process.scales)[:, None] * now * np.exp(-first / process.scales)
            )
            at_first = at_first + np.diag(1.0 - np.exp(-2.0 * first / process.scales))
            between = np.exp(-(last - first) / process.scales)[:, None] * at_first
            # of the later unknowns with the earlier
            out[i, j] = one @ between @ other if t >= s else other @ between @ one
    return out


def textbook(prior: Array, rows: Array, variance: float) -> Array:
    """Return P - P H' (H P H' + R)^-1 H P."""
    gain = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + variance * np.eye(len(rows)))
    return np.asarray(prior - gain @ rows @ prior)


def runge_kutta(
    current, start: complex, begin: float, held: complex, duration: float, steps: int
) -> complex:
    """Return where a path ends whose current is a function of place and time."""
    place, step = start, duration / steps
    for k in range(steps):
        time = begin + k * step
        first = held + current(place, time)
        second = held + current(place + step / 2 * first, time + step / 2)
        third = held + current(place + step / 2 * second, time + step / 2)
        fourth = held + current(place + step * third, time + step)
        place += step / 6 * (first + 2 * second + 2 * third + fourth)
    return place
