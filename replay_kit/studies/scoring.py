"""The estimation methods that studies compare, and scores of an estimate and its stated errors against a known truth."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.evidence import bootstrap_interval, coverage, crps_gaussian
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator import Estimator, build_estimator
from replay_kit.estimator.baselines import BASELINES, build_baseline
from replay_kit.estimator.basis.modes import LENGTH_IN_CELLS
from replay_kit.estimator.basis.slices import cell_size
from replay_kit.workflows.replay.scoring import ScoredPoints, rms_length

#: A goal that is passed this close counts as reached [m].
NEAR = 250.0


# ``paper_cells`` is the paper's estimator with its length in cells rather than in kilometres, for grids coarser than its own.
METHODS = (
    "default",
    "paper",
    "paper_cells",
    *(name for name in BASELINES if name != "depth_average"),
)


def build_method(name: str, ensemble: Ensemble, config: EstimatorConfig) -> Estimator[Any]:
    """Return the estimator that a method's name stands for.

    Raises:
        ConfigError: The name is unknown.
    """
    if name not in ("default", "paper", "paper_cells"):
        return build_baseline(name, ensemble, config)
    return build_estimator(
        ensemble,
        preset_config(name, ensemble.grid, config),
        GatingConfig() if name == "default" else None,
    )


def preset_config(name: str, grid: Grid, config: EstimatorConfig) -> EstimatorConfig:
    """Return the settings of ``default``, ``paper`` or ``paper_cells``: its preset, and its length on a grid."""
    length = LENGTH_IN_CELLS * float(np.sqrt(np.prod(cell_size(grid))))
    cells = {"length_horizontal": length} if name == "paper_cells" else {}
    return config.model_copy(
        update={"preset": "default" if name == "default" else "paper", **cells}
    )


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


def score(flow: FlowEstimate, at: ScoredPoints) -> Score:
    """Return the scores of an estimate."""
    error = flow.velocity(*at.place) - at.velocity
    rmse = rms_length(error)
    relative = rmse / rms_length(at.velocity)
    if flow.n_modes == 0:
        return Score(rmse, relative, np.nan, np.nan, float(np.mean(np.abs(error))))
    std = flow.standard_error(*at.place)
    return Score(
        rmse,
        relative,
        coverage(error, std, 0.5),
        coverage(error, std, 0.9),
        float(np.mean(crps_gaussian(error, std))),
    )


def bound(estimator: Estimator[Any], at: ScoredPoints) -> float:
    """Return the least RMSE [m/s] of any flow that an estimator can represent; NaN for one whose flows have no fixed span.

    It is that of the least-squares fit of the truth within the span, at the scored points.
    """
    residual = estimator.span_residual(at.points, at.depth, at.velocity)
    return float("nan") if residual is None else rms_length(residual)


def bootstrap_median(values: Array) -> tuple[float, float]:
    """Return the ends of the bootstrap interval of 90 % of a median.

    Args:
        values: shape (n,).
    """
    return bootstrap_interval(lambda drawn: np.median(values[drawn], axis=1), values.size)


def miss_figures(misses: Array) -> dict[str, Any]:
    """Return median, ends of its 90 % interval and quartiles of miss distances [m], shape (n,), and how many are within 250 m."""
    low, high = bootstrap_median(misses)
    lower, median, upper = (float(quartile) for quartile in np.quantile(misses, [0.25, 0.5, 0.75]))
    near = int(np.sum(misses <= NEAR))
    return {
        "median": median,
        "median_low": low,
        "median_high": high,
        "lower_quartile": lower,
        "upper_quartile": upper,
        "within_250": near,
    }


def bootstrap_ratio(values: Array, others: Array) -> tuple[float, float]:
    """Return the ends of the bootstrap interval of 90 % of the ratio of two medians over the same cases, resampled together.

    Args:
        values: shape (n,), above the line.
        others: shape (n,), below it.
    """
    return bootstrap_interval(
        lambda drawn: np.median(values[drawn], axis=1) / np.median(others[drawn], axis=1),
        values.size,
    )
