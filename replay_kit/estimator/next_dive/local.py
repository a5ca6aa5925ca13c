"""What the mean currents of the dives say of the current beside the estimate: the model of dives, about the estimate before each of them.

The estimate's own error is part of what a dive's mean current may differ by, and one combination of settings has no current beside the
estimate: only what the estimate does not explain, dive after dive, speaks for one.
"""

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.estimator.next_dive.filter import DiveMean, DiveModel, DiveState
from replay_kit.estimator.next_dive.settings import local_combinations

_MODEL = DiveModel(local_combinations())
# Positions of the part that decorrelates among the unknowns.
_LOCAL = slice(2, 4)


def local_step(state: DiveState | None, time_ns: int, innovation: Array, std: Array) -> DiveState:
    """Return the state after a dive.

    Args:
        state: After those before; None before the first.
        time_ns: Of the dive's middle [ns, UTC].
        innovation: shape (2,) [m/s], mean current minus that of the estimate before the dive, local axes.
        std: shape (2,) [m/s], of the innovation as the estimate and the measurement state it.
    """
    stated = float(np.sqrt(np.mean(std**2)))
    # an error of so many metres in a second is one of so many metres a second
    dive = DiveMean(time_ns, 1.0, np.zeros(2), 0.0, innovation, position_std=stated)
    return _MODEL.step(_MODEL.initial() if state is None else state, dive)


def local_current(state: DiveState | None) -> LocalCurrent | None:
    """Return the current beside the estimate after some dives; None before the first.

    Combinations that differ only in the error of a mean current foretell the same and are joined.
    """
    if state is None or state.time_ns is None:
        return None
    std, scale = np.sqrt(_MODEL.settings.variance[:, _LOCAL.start]), _MODEL.settings.scales[:, _LOCAL.start]
    weights = np.exp(state.log_weights)
    joined = []
    for pair in sorted({(one, time) for one, time in zip(std.tolist(), scale.tolist(), strict=True)}):
        of_pair = np.flatnonzero((std == pair[0]) & (scale == pair[1]))
        share = float(np.sum(weights[of_pair]))
        within = weights[of_pair] / share if share > 0.0 else np.full(of_pair.size, 1.0 / of_pair.size)
        means, covs = state.mean[of_pair, _LOCAL], state.cov[of_pair, _LOCAL, _LOCAL]
        about = means - within @ means
        cov = np.einsum("h,hij->ij", within, covs) + (within[:, None] * about).T @ about
        joined.append((share, *pair, within @ means, cov))
    shares, stds, scales, means, covs = (np.array(part) for part in zip(*joined, strict=True))
    return LocalCurrent(shares / np.sum(shares), stds, scales, means, covs, state.time_ns)
