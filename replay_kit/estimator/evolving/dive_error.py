"""An error that all profiles of one dive share: those of an inversion, which takes a dive's pings together.

The legs of a dive agree with each other better than with the dives before and after, whatever the sea did. Taken for the sea's, that
would look like a current that changes within hours; taken for each profile's own, the second leg would count as if it were news. So it is
a part of the state: a structure in depth, the same for a dive's profiles, that begins anew with each dive.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.time import TimeConfig
from replay_kit.core.observation import Measurement, Observation, PathMean
from replay_kit.estimator.evolving.extras import Oscillations, oscillations
from replay_kit.estimator.evolving.filter import EvolvingEstimator, EvolvingState
from replay_kit.estimator.evolving.seen import Model, Seen

_PART = "dive_error"


@dataclass(frozen=True, slots=True, eq=False)
class DiveErrorModel(Model):
    """What of the state an observation is about, with the error that the profiles of its dive share.

    Attributes:
        dive_error: Its structure in depth, one pair (east, north) that does not turn.
    """

    dive_error: Oscillations

    def profile(self, observation: Observation, used: NDArray[np.intp]) -> Seen:
        """Return the rows of a profile's usable bins."""
        # the class that slots make is not the one that super() would look for
        seen = Model.profile(self, observation, used)
        weights = self.dive_error.weights(observation.depth[used])
        k = seen.q.shape[1]
        q, r = np.linalg.qr(np.hstack([seen.q, seen.noise.whiten @ weights]))
        design = [np.hstack([r[:, :k] @ seen.design[c * k : (c + 1) * k], r[:, k:] @ self.dive_error.factor(c)]) for c in range(2)]
        return Seen(q, seen.noise, np.vstack(design), seen.values)

    def path(self, mean: PathMean) -> Seen:
        """Return the rows of a mean along a path, which no inversion made."""
        seen = Model.path(self, mean)
        return replace(seen, design=np.hstack([seen.design, np.zeros((2, self.dive_error.size))]))


def with_dive_error(estimator: EvolvingEstimator, std: float, depth_length: float) -> EvolvingEstimator:
    """Return an estimator that counts with an error shared by the profiles of a dive; tell it of each new dive by ``new_dive``.

    Args:
        estimator: Without such an error.
        std: Of each component [m/s].
        depth_length: Over which it stays alike in depth [m].
    """
    model, layout = estimator.model, estimator.layout
    shape = TimeConfig(oscillators=("steady",), oscillator_std=std, oscillator_depth_length=depth_length)
    error = oscillations(shape, 0.0, float(model.basis.grid.levels[-1]))
    whole = DiveErrorModel(model.basis, model.sea, model.oscillations, model.biases, model.representation_std, error)
    parts = {**layout.parts, _PART: slice(layout.size, layout.size + error.size)}
    scales = np.concatenate([layout.scales, np.full(error.size, np.inf)])
    return replace(estimator, model=whole, layout=replace(layout, scales=scales, parts=parts))


def new_dive(estimator: EvolvingEstimator, state: EvolvingState) -> EvolvingState:
    """Return the state at the beginning of a dive, of whose own error nothing is known; unchanged for an estimator without one."""
    part = estimator.layout.parts.get(_PART)
    if part is None:
        return state
    means, cov = state.means.copy(), state.cov.copy()
    means[part] = 0.0
    cov[part], cov[:, part] = 0.0, 0.0
    cov[part, part] = np.eye(part.stop - part.start)
    return replace(state, means=means, covariance=cov, group=None)


def by_dive(observations: Sequence[Measurement]) -> Iterator[tuple[bool, Measurement]]:
    """Yield observations, each with whether it is the first of its dive."""
    for k, observation in enumerate(observations):
        yield k > 0 and observation.dive != observations[k - 1].dive, observation
