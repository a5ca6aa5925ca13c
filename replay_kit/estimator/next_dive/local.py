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
# Position among the unknowns of the part that decorrelates, to the east; to the north it is the next.
_LOCAL = 2


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
    """Return the current beside the estimate after some dives; None before the first."""
    if state is None or state.time_ns is None:
        return None
    settings, part = _MODEL.settings, slice(_LOCAL, _LOCAL + 2)
    std, scale = np.sqrt(settings.variance[:, _LOCAL]), settings.scales[:, _LOCAL]
    return LocalCurrent(
        np.exp(state.log_weights),
        std,
        scale,
        state.mean[:, part],
        state.cov[:, part, part],
        state.time_ns,
    )
