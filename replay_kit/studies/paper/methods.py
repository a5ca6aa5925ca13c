"""The methods that the paper's tables compare, the least error that each could have, and the steps that are counted."""

from collections.abc import Callable, Iterable, Iterator
from itertools import tee
from typing import Any, TypeVar

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.evidence import bootstrap_interval
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.progress import Progress, each_call, silent
from replay_kit.estimator import Estimator, build_estimator
from replay_kit.estimator.baselines.builders import build_baseline
from replay_kit.estimator.basis.modes import LENGTH_IN_CELLS
from replay_kit.estimator.basis.slices import cell_size
from replay_kit.workflows.replay.scoring import ScoredPoints, rms_length

Value = TypeVar("Value")


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


#: A goal that is passed this close counts as reached [m].
NEAR = 250.0


def build_method(name: str, ensemble: Ensemble, config: EstimatorConfig) -> Estimator[Any]:
    """Return the estimator that a method's name stands for: ``default``, ``paper``, ``paper_cells`` or a baseline's.

    ``paper_cells`` is the paper's with its length in cells rather than in kilometres, for grids coarser than its own.

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
