"""Local correction of the estimate, inferred recursively from the innovations of DACs.

The innovation includes the estimate's error, and one of the processes has no correction. With some probability the correction jumps between
dives; both cases are merged to one Gaussian per process after the dive (Blom and Bar-Shalom 1988, IEEE TAC 33).
"""

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.estimator.next_dive.mixture import log_densities

# m/s and s: long-run deviations of the processes, each with each decorrelation time; with even odds there is no such current
_STDS = np.repeat([0.0, 0.02, 0.04, 0.08, 0.16], 3)
_BEFORE = LocalCurrent(
    np.where(_STDS > 0.0, 1.0 / 24.0, 1.0 / 6.0),
    _STDS,
    np.tile([21_600.0, 86_400.0, 345_600.0], 5),
    np.zeros((15, 2)),
    _STDS[:, None, None] ** 2 * np.eye(2),
    0,
)
# m/s; of a component, what no other dive shares beside the stated error
_WHITE_STD = 0.005
# Probability of a change by more than usual, and what it adds to the variances, as a multiple of those in the long run.
_JUMP, _JUMP_FACTOR = 0.05, 3.0


def local_step(
    state: LocalCurrent | None, time_ns: int, innovation: Array, std: Array
) -> LocalCurrent:
    """Return the local correction after a dive.

    Args:
        state: Correction before it; None before the first.
        time_ns: Middle of the dive [ns, UTC].
        innovation: shape (2,) [m/s], DAC minus that of the estimate before the dive, local axes.
        std: shape (2,) [m/s], stated standard deviation of the innovation.
    """
    now = (state or _BEFORE).at(time_ns)
    more = np.array([0.0, _JUMP_FACTOR])[:, None, None, None] * now.std[:, None, None] ** 2
    covs, errors = now.cov + more * np.eye(2), innovation - now.mean
    spreads = covs + (np.mean(std**2) + _WHITE_STD**2) * np.eye(2)
    gains = covs @ np.linalg.inv(spreads)
    log_each = np.log([[1.0 - _JUMP], [_JUMP]]) + log_densities(errors, spreads)
    total = np.logaddexp.reduce(log_each, axis=0)
    shares = np.exp(log_each - total)[..., None]
    moves = (gains @ errors[:, :, None])[..., 0]
    move = np.sum(shares * moves, axis=0)
    about = (moves - move)[..., None]
    cov = covs - gains @ covs + about @ about.swapaxes(-1, -2)
    # one that rounding has made impossible may become likely again
    log_weights = np.log(now.probability + 1e-300) + total
    return replace(
        now,
        probability=np.exp(log_weights - np.logaddexp.reduce(log_weights)),
        mean=now.mean + move,
        cov=np.sum(shares[..., None] * cov, axis=0),
    )
