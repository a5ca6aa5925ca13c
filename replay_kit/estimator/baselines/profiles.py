"""A profile as every baseline meets it: the usable bins, their local velocity and error, and the innovation reported of them."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import DepthFunctions, depth_weights
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.grid import Grid
from replay_kit.core.observation import Innovation, Observation
from replay_kit.estimator.update.screening import rejected, scatter, screen, usable


@dataclass(frozen=True, slots=True, eq=False)
class UsableBins:
    """The bins of a profile that pass the screening.

    Attributes:
        used: shape (n,), their positions in the observation.
        place: shape (2,) [m], local east and north.
        depth_weights: shape (n, Z), of the levels at each bin.
        values: shape (n, 2) [m/s], measured, local east and north.
        flags: of all bins, QARTOD.
        reasons: of all bins, bit mask of ``Reason``.
    """

    used: NDArray[np.intp]
    place: Array
    depth_weights: Array
    values: Array
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]


def usable_bins(observation: Observation, grid: Grid) -> UsableBins:
    """Return the bins of a profile that an estimate on a grid can be compared with; hats in depth."""
    flags, reasons = screen(observation, grid)
    used = np.flatnonzero(usable(flags))
    place = np.array(to_local(grid.projection, observation.longitude, observation.latitude))
    weights = depth_weights(DepthFunctions("hat", 1.0), observation.depth[used], grid.levels)
    velocity = observation.velocity[used]
    local = np.column_stack(rotate_to_local(grid.projection, observation.longitude, observation.latitude, velocity[:, 0], velocity[:, 1]))
    return UsableBins(used, place, weights, local, flags, reasons)


def error_std(observation: Observation, used: NDArray[np.intp], config: EstimatorConfig) -> Array:
    """Return the error of each usable bin, shape (n,) [m/s]: its own, the bins' common one and any representation error; or the paper's."""
    if config.preset == "paper":
        return np.full(used.size, config.paper_error_std)
    return np.hypot(np.hypot(observation.error_std[used], observation.common_std), config.representation_error_std or 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Predictions:
    """What an estimator expected of the usable bins, each of shape (n, 2) [m/s].

    Attributes:
        before: From the state before the update.
        after: From the state after it.
        prior: From the state that has seen nothing.
        innovation_std: Predicted standard deviation of measured minus predicted; NaN when the estimator has none.
    """

    before: Array
    after: Array
    prior: Array
    innovation_std: Array


def innovation_of(observation: Observation, bins: UsableBins, predictions: Predictions, nis: float) -> Innovation:
    """Return the innovation of a profile.

    Args:
        observation: The profile.
        bins: Its usable bins, at least one.
        predictions: Of these bins.
        nis: Normalised innovation squared of all rows; NaN when the estimator predicts no variance.
    """

    def spread(values: Array) -> Array:
        return scatter(observation.depth.size, bins.used, values)

    return replace(
        rejected(observation, bins.flags, bins.reasons),
        innovation=spread(bins.values - predictions.before),
        innovation_std=spread(predictions.innovation_std),
        residual=spread(bins.values - predictions.after),
        prior_innovation=spread(bins.values - predictions.prior),
        nis=nis,
        dof=2 * bins.used.size,
        accepted=True,
    )
