"""What studies share: options checked, progress counted, failures kept as results; the methods that are compared, and their scores."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import tee
from typing import Any, TypeVar

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import (
    ConfigError,
    EstimatorError,
    ForecastError,
    MeasurementError,
    PlanError,
)
from replay_kit.core.evidence import bootstrap_interval, coverage, crps_gaussian
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.progress import Progress, each_call, silent
from replay_kit.estimator import Estimator, build_estimator
from replay_kit.estimator.baselines.builders import BASELINES, build_baseline
from replay_kit.estimator.basis.modes import LENGTH_IN_CELLS
from replay_kit.estimator.basis.slices import cell_size
from replay_kit.workflows.replay.scoring import ScoredPoints, rms_length

Value = TypeVar("Value")

#: A matrix that cannot be factorised, and inputs that one method or study cannot use. A wrong option (``ConfigError``) concerns the
#: whole run, and any other error is a bug: neither is kept as a result.
EXPECTED_FAILURES = (
    np.linalg.LinAlgError,
    EstimatorError,
    ForecastError,
    MeasurementError,
    PlanError,
)


def reason_of(error: Exception) -> str:
    """Return the reason of a failure as results state it: the error's class and message."""
    return f"{type(error).__name__}: {error}"


class Advance:
    """Counts steps as done and reports each to a progress function; in another process, to which it is sent, it counts nothing.

    It is mutable: calls count in it as they go, where they are made in this process.
    """

    def __init__(self, total: int = 0, progress: Progress = silent) -> None:
        """Begin with no step done.

        Args:
            total: Steps in all.
            progress: Called with steps done, steps in all, and what is being run.
        """
        self._total, self._progress, self.done = total, progress, 0

    def __call__(self, what: str, steps: int = 1) -> None:
        """Count steps of what is being run."""
        self.done += steps
        self._progress(self.done, self._total, what)

    def __reduce__(self) -> tuple[type["Advance"], tuple[()]]:
        return Advance, ()


def each_counted(
    function: Callable[..., Value],
    calls: Iterable[tuple[Any, ...]],
    advance: Advance,
    steps: Callable[..., int],
) -> Iterator[tuple[tuple[Any, ...], Value]]:
    """Yield each call with its value, see ``each_call``; the steps of one made in another process are counted when it is done.

    Args:
        function: As of ``each_call``; it counts its steps where it runs.
        calls: Its arguments.
        advance: Counts steps.
        steps: Number of steps of a call, of the same arguments.
    """
    done, (calls, made) = advance.done, tee(calls)
    for call, value in zip(calls, each_call(function, made), strict=True):
        done += steps(*call)
        if done > advance.done:
            advance("cases", done - advance.done)
        yield call, value


def check_names(option: str, chosen: Sequence[str], known: Collection[str]) -> None:
    """Raise ConfigError unless some known names are chosen, each once.

    Args:
        option: That they come from.
        chosen: As given.
        known: All there are.
    """
    if not chosen or not set(chosen) <= set(known) or len(set(chosen)) < len(chosen):
        raise ConfigError(
            f"{option}: expected some of {', '.join(known)}, each once, got {', '.join(chosen) or 'none'}"
        )


def check_positive(**options: float) -> None:
    """Raise ConfigError unless every option, by its name without dashes, is a finite number above 0."""
    for name, value in options.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigError(f"--{name}: expected a finite number above 0, got {value:g}")


def check_not_negative(**options: float) -> None:
    """Raise ConfigError unless every option, by its name without dashes, is a finite number of at least 0."""
    for name, value in options.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ConfigError(f"--{name}: expected a finite number of at least 0, got {value:g}")


def check_counts(pings: Sequence[int]) -> None:
    """Raise ConfigError unless the numbers of pings at which estimates are scored increase from at least 1."""
    if not pings or min(pings) < 1 or list(pings) != sorted(set(pings)):
        raise ConfigError(
            f"--pings: expected increasing numbers of at least 1, got {', '.join(map(str, pings)) or 'none'}"
        )


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
