"""How an estimate and its stated uncertainty compare with a known truth: pure functions of arrays."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from replay_kit.errors import MeasurementError
from replay_kit.flow import FlowEstimate
from replay_kit.geodesy import inside_grid, to_local
from replay_kit.types import Array, Ensemble, Grid


@dataclass(frozen=True, slots=True, eq=False)
class ScoredPoints:
    """The truth's wet grid points inside a region and its levels.

    Attributes:
        points: shape (P, 2) [m], local east and north of the region's frame.
        depth: shape (P,) [m].
        velocity: shape (P, 2) [m/s], the truth there.
    """

    points: Array
    depth: Array
    velocity: Array

    @property
    def place(self) -> tuple[Array, Array, Array]:
        """East, north and depth [m], as a flow asks for them."""
        return self.points[:, 0], self.points[:, 1], self.depth


@dataclass(frozen=True, slots=True)
class Score:
    """An estimate against the truth over all scored points.

    Attributes:
        rmse: Root mean square length of the error vector [m/s].
        rel_error: ``rmse`` over the truth's RMS speed.
        coverage50: Share of components inside their central 50 % interval; NaN without uncertainty.
        coverage90: Share of components inside their central 90 % interval; NaN without uncertainty.
        crps: Mean continuous ranked probability score of a component [m/s]; the mean absolute error without uncertainty.
    """

    rmse: float
    rel_error: float
    coverage50: float
    coverage90: float
    crps: float


def scored_points(grid: Grid, truth: Ensemble) -> ScoredPoints:
    """Return where a truth is compared with an estimate on a grid.

    Raises:
        MeasurementError: No wet point of the truth lies in the grid's region and levels.
    """
    east, north = to_local(grid.projection, truth.grid.longitude, truth.grid.latitude)
    levels = truth.grid.levels
    deep = (levels >= grid.levels[0] - 1e-6) & (levels <= grid.levels[-1] + 1e-6)
    z, j, i = np.nonzero(truth.grid.wet & deep[:, None, None] & inside_grid(grid, east, north))
    if z.size == 0:
        raise MeasurementError(f"{truth.source}: no wet point of the truth lies in the ensemble's region and levels; of another place?")
    return ScoredPoints(np.column_stack([east[j, i], north[j, i]]), levels[z], truth.velocity[0][:, z, j, i].T)


def score(flow: FlowEstimate, at: ScoredPoints) -> Score:
    """Return the scores of an estimate."""
    error = flow.velocity(*at.place) - at.velocity
    rmse = rms_length(error)
    relative = rmse / rms_length(at.velocity)
    if flow.n_modes == 0:
        return Score(rmse, relative, np.nan, np.nan, float(np.mean(np.abs(error))))
    std = flow.standard_error(*at.place)
    return Score(rmse, relative, coverage(error, std, 0.5), coverage(error, std, 0.9), float(np.mean(crps_gaussian(error, std))))


def rms_length(vectors: Array) -> float:
    """Return the root mean square length of vectors, shape (P, 2)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=-1))))


def coverage(error: Array, std: Array, share: float) -> float:
    """Return which share of errors lies in the central interval that should hold ``share`` of them."""
    return float(np.mean(np.abs(error) <= ndtri(0.5 + 0.5 * share) * std))


def crps_gaussian(error: Array, std: Array) -> Array:
    """Return the continuous ranked probability score of Gaussian predictions (Gneiting et al. 2005, Mon. Wea. Rev. 133, eq. 5).

    Args:
        error: Predicted mean minus what came, any shape.
        std: Predicted standard deviation, broadcast against it; where it is 0 the score is the absolute error.
    """
    error, std = np.broadcast_arrays(error, std)
    z = np.divide(error, std, out=np.zeros(error.shape), where=std > 0.0)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    spread = std * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / np.sqrt(np.pi))
    return np.where(std > 0.0, spread, np.abs(error))
