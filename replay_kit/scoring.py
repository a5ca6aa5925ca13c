"""An estimate against a known truth, at the truth's wet grid points."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from replay_kit.config import EstimatorConfig
from replay_kit.errors import MeasurementError
from replay_kit.estimator import embed_member
from replay_kit.flow import FlowEstimate
from replay_kit.geodesy import inside_grid, rotate_to_geographic, rotate_to_local, to_local
from replay_kit.report import TruthScore
from replay_kit.types import Array, Ensemble


def score_against_truth(
    flow: FlowEstimate,
    ensemble: Ensemble,
    truth: Ensemble,
    positions: Sequence[tuple[float, float]],
    radius_km: float | None,
    config: EstimatorConfig,
) -> tuple[TruthScore, FlowEstimate]:
    """Return the scores, without closest approaches, and the truth as a flow.

    The truth is compared at its own grid points that lie inside the ensemble's region and levels: RMSE is the root mean square
    length of the error vector, unweighted, and the relative error is over the truth's RMS speed there.

    Args:
        flow: The estimate.
        ensemble: Whose mean is scored beside it.
        truth: An ensemble of one.
        positions: (longitude, latitude) of the profiles used.
        radius_km: Only points this near to a profile count; None counts all.
        config: For the truth's embedding.

    Raises:
        MeasurementError: No grid point of the truth is left to score.
    """
    grid = truth.grid
    east, north = to_local(flow.grid.projection, grid.longitude, grid.latitude)
    deep = (grid.levels >= ensemble.grid.levels[0] - 1e-6) & (grid.levels <= ensemble.grid.levels[-1] + 1e-6)
    scored = grid.wet & deep[:, None, None] & inside_grid(flow.grid, east, north)
    if radius_km is not None:
        scored &= _near(east, north, np.column_stack(to_local(flow.grid.projection, *np.array(positions).T)), 1e3 * radius_km)
    if not scored.any():
        raise MeasurementError(
            f"{truth.source}: no grid point of the truth lies in the ensemble's region and levels; is it of another place?"
        )
    z, j, i = np.nonzero(scored)
    points = east[j, i], north[j, i], grid.levels[z]
    true = _in_frame(truth, flow)[:, z, j, i].T
    mean = _ensemble_mean_at(ensemble, truth, flow, config, points, (z, j, i))
    rmse, speed = _rms_length(flow.velocity(*points) - true), _rms_length(true)
    score = TruthScore(rmse, rmse / speed, _rms_length(mean - true), int(z.size), float("nan"), float("nan"))
    return score, embed_member(truth, 0, config)


def _in_frame(truth: Ensemble, flow: FlowEstimate) -> Array:
    """Return the truth's velocities along the flow's axes, shape (2, Z, J, I); the two may have other centres."""
    grid = truth.grid
    u, v = rotate_to_geographic(grid.projection, grid.longitude, grid.latitude, truth.velocity[0, 0], truth.velocity[0, 1])
    return np.stack(rotate_to_local(flow.grid.projection, grid.longitude, grid.latitude, u, v))


def _rms_length(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _near(east: Array, north: Array, track: Array, radius: float) -> Array:
    distance, _ = cKDTree(track).query(np.stack([east, north], axis=-1))
    return np.asarray(distance <= radius)


def _ensemble_mean_at(
    ensemble: Ensemble,
    truth: Ensemble,
    flow: FlowEstimate,
    config: EstimatorConfig,
    points: tuple[Array, Array, Array],
    at: tuple[NDArray[np.intp], ...],
) -> Array:
    """Return the ensemble's mean at scored points: as it is where the grids agree, else through its embedding."""
    same = ensemble.grid.wet.shape == truth.grid.wet.shape and np.allclose(ensemble.grid.levels, truth.grid.levels)
    if same and np.allclose(ensemble.grid.longitude, truth.grid.longitude) and np.allclose(ensemble.grid.latitude, truth.grid.latitude):
        return np.asarray(ensemble.velocity.mean(axis=0)[:, at[0], at[1], at[2]].T)
    mean = Ensemble(ensemble.grid, ensemble.velocity.mean(axis=0, keepdims=True), ensemble.time_ns, ensemble.source)
    return embed_member(mean, 0, config).velocity(*points)
