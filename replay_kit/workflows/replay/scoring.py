"""Scores of an estimate against a truth at its wet points, and of competing forecasts by log evidence."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.files.paths import Paths
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, rotate_to_geographic, rotate_to_local, to_local
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator import embed_member
from replay_kit.forecast import ensemble_files
from replay_kit.workflows.replay.inputs.job import Against


@dataclass(frozen=True, slots=True, eq=False)
class ScoredPoints:
    """Wet grid points of the truth inside a region and its levels.

    Attributes:
        points: shape (P, 2) [m], local east and north of the region's frame.
        depth: shape (P,) [m].
        velocity: shape (P, 2) [m/s], truth along the region's axes.
        index: Level, row and column in the truth's grid, each shape (P,).
    """

    points: Array
    depth: Array
    velocity: Array
    index: tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]

    @property
    def place(self) -> tuple[Array, Array, Array]:
        """East, north and depth [m], the arguments of a flow."""
        return self.points[:, 0], self.points[:, 1], self.depth


def score_against_truth(
    flow: FlowEstimate,
    ensemble: Ensemble,
    truth: Ensemble,
    config: EstimatorConfig,
) -> dict[str, float]:
    """Return the scores of an outcome.

    The truth is compared at its own grid points that lie inside the ensemble's region and levels: RMSE is the root mean square
    length of the error vector, unweighted, and the relative error is over the truth's RMS speed there.

    Args:
        flow: Estimate.
        ensemble: Ensemble, whose mean is scored too.
        truth: An ensemble of one.
        config: Settings of the embedding of the ensemble's mean.

    Raises:
        MeasurementError: No grid point of the truth can be scored.
    """
    at = scored_points(flow.grid, truth)
    mean = _ensemble_mean_at(ensemble, truth, config, at)
    rmse, speed = rms_length(flow.velocity(*at.place) - at.velocity), rms_length(at.velocity)
    return {
        "rmse": rmse,
        "rel_error": rmse / speed,
        "ensemble_mean_rmse": rms_length(mean - at.velocity),
        "points": int(at.depth.size),
    }


def scored_points(grid: Grid, truth: Ensemble) -> ScoredPoints:
    """Return the points at which a truth is compared with an estimate, and the truth along the grid's axes.

    Args:
        grid: Grid of the estimate.
        truth: An ensemble of one; its frame may have another centre, and its vectors are turned.

    Raises:
        MeasurementError: No wet point of the truth can be scored.
    """
    east, north = to_local(grid.projection, truth.grid.longitude, truth.grid.latitude)
    levels = truth.grid.levels
    deep = (levels >= grid.levels[0] - 1e-6) & (levels <= grid.levels[-1] + 1e-6)
    scored = truth.grid.wet & deep[:, None, None] & inside_grid(grid, east, north)
    z, j, i = np.nonzero(scored)
    if z.size == 0:
        raise MeasurementError(
            f"{truth.source}: no wet point of the truth lies in the ensemble's region and levels; is it of another place?"
        )
    u, v = truth.velocity[0][:, z, j, i]
    at = truth.grid.longitude[j, i], truth.grid.latitude[j, i]
    turned = rotate_to_local(
        grid.projection, *at, *rotate_to_geographic(truth.grid.projection, *at, u, v)
    )
    return ScoredPoints(
        np.column_stack([east[j, i], north[j, i]]), levels[z], np.column_stack(turned), (z, j, i)
    )


def rms_length(vectors: Array) -> float:
    """Return the root mean square length of vectors, shape (P, 2)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=-1))))


def _ensemble_mean_at(
    ensemble: Ensemble, truth: Ensemble, config: EstimatorConfig, at: ScoredPoints
) -> Array:
    """Return the ensemble mean at scored points: directly if the grids agree, else through its embedding."""
    same = ensemble.grid.wet.shape == truth.grid.wet.shape and np.allclose(
        ensemble.grid.levels, truth.grid.levels
    )
    if (
        same
        and np.allclose(ensemble.grid.longitude, truth.grid.longitude)
        and np.allclose(ensemble.grid.latitude, truth.grid.latitude)
    ):
        return np.asarray(ensemble.velocity.mean(axis=0)[:, *at.index].T)
    mean = Ensemble(
        ensemble.grid,
        ensemble.velocity.mean(axis=0, keepdims=True),
        ensemble.time_ns,
        ensemble.source,
    )
    return embed_member(mean, 0, config).velocity(*at.place)


#: Begin the keys of the rivals' files among the inputs.
RIVAL = "against"


def name_of(ensemble: Paths) -> str:
    """Return the name of an ensemble's file without its folder; for several the first name and their number."""
    files = ensemble_files(ensemble)
    return files[0].name if len(files) == 1 else f"{files[0].name} and {len(files) - 1} more"


def rival_inputs(against: Sequence[Against]) -> dict[str, Path]:
    """Return the files of competing forecasts by input key: ``against0``, or ``against0_1`` for several."""
    out: dict[str, Path] = {}
    for number, each in enumerate(against):
        files = ensemble_files(each)
        out |= {
            f"{RIVAL}{number}" if len(files) == 1 else f"{RIVAL}{number}_{i}": path
            for i, path in enumerate(files)
        }
    return out
