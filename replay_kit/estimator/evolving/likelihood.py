"""How likely observations are, each predicted from those before it; and an estimator in as few unknowns as they need.

The logarithm of the density of observations y_1 ... y_n is the sum of those of their innovations: it judges settings by what they would
have predicted, step by step, and by how sure they would have been.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.flow.horizontal import velocity_kernel
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import Innovation, Measurement, PathMean
from replay_kit.estimator.basis.noise import BinNoise
from replay_kit.estimator.evolving.dive_error import by_dive, new_dive
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.evolving.sea import Sea
from replay_kit.estimator.evolving.state import Layout

# of the largest; below it a direction of the sea is not seen
_UNSEEN = 1e-9


def log_likelihoods(estimator: EvolvingEstimator, observations: Sequence[Measurement]) -> Iterator[float]:
    """Yield the logarithm of each observation's density given those before it; 0 for one without a usable bin.

    The constant of 2 pi is left out. Errors are taken as stated: nothing is gated, and no error grows.
    """
    believing = replace(estimator, trust=None)
    state = believing.initial()
    for is_new, observation in by_dive(observations):
        state = new_dive(believing, state) if is_new else state
        offered = believing.offered(state, observation)
        if isinstance(offered, Innovation):
            yield 0.0
            continue
        look, innovation = offered.looked.look, offered.looked.innovation
        _, left_out = offered.seen.compress(offered.seen.values)
        half_log_det = 0.5 * float(np.linalg.slogdet(look.cov + np.eye(innovation.size))[1]) + 2.0 * log_scale(offered.seen.noise)
        yield -0.5 * (look.nis(innovation) + left_out) - half_log_det
        means, cov = look.posterior(offered.told, 1.0)
        state = replace(offered.before, means=means, covariance=cov, last=observation)


def log_scale(noise: BinNoise) -> float:
    """Return half the logarithm of the determinant of the noise of what is known: of all bins, or of their differences."""
    known, bins = noise.whiten.shape
    return noise.log_scale if known == bins else float(np.linalg.slogdet(np.diff(noise.unwhiten, axis=0))[1])


def narrowed(estimator: EvolvingEstimator, observations: Sequence[Measurement]) -> EvolvingEstimator:
    """Return an estimator that says the same of certain observations, in as few unknowns as these see of the sea.

    Unknowns that are forgotten alike may be turned into one another: those directions of them that no observation sees are left out.
    Elsewhere than at the observations the result says nothing sensible.
    """
    model = estimator.model
    sea = model.sea
    columns = [_seen(estimator, observation) for observation in observations]
    parts = [np.concatenate([column[k] for column in columns], axis=1) for k in range(2)]
    turns = [_span(part) for part in parts]
    small = replace(
        sea,
        trajectories=np.einsum("fk,tfzr->tkzr", turns[0], sea.trajectories, optimize=True),
        local=np.einsum("bk,bzr->kzr", turns[1], sea.local, optimize=True),
    )
    return replace(estimator, model=replace(model, sea=small), layout=_moved(estimator.layout, sea.size, small))


def _moved(layout: Layout, size: int, small: Sea) -> Layout:
    """Return a layout whose first unknowns, the sea's, are now those of a smaller one."""
    by = small.size - size
    parts = {name: slice(part.start + by, part.stop + by) for name, part in layout.parts.items() if name != "sea"}
    scales = np.concatenate([small.scales, layout.scales[size:]])
    return replace(layout, scales=scales, first=layout.first + by, second=layout.second + by, parts={"sea": slice(0, small.size), **parts})


def _seen(estimator: EvolvingEstimator, observation: Measurement) -> tuple[Array, Array]:
    """Return what an observation sees of each trajectory and of each local direction, one column a number seen: (F, m), (B, m)."""
    model = estimator.model
    sea, basis = model.sea, model.basis
    n_trajectories = sea.trajectories.shape[1]
    if isinstance(observation, PathMean):
        rows = model.path(observation).design[:, : sea.size].T
        return rows[:n_trajectories], rows[n_trajectories:]
    place = np.array([to_local(basis.grid.projection, observation.longitude, observation.latitude)], dtype=np.float64)
    modes = velocity_kernel(basis.kernel, place, basis.grid.nodes) @ basis.modes
    trajectories = np.concatenate([(of_time @ modes.T).reshape(n_trajectories, -1) for of_time in sea.trajectories], axis=1)
    return trajectories, (sea.local @ modes.T).reshape(len(sea.local), -1)


def _span(columns: Array) -> Array:
    """Return an orthonormal basis of the columns' span, shape (n, k)."""
    vectors, size, _ = scipy.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, size > _UNSEEN * size[0]], dtype=np.float64)
