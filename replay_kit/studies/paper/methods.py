"""Methods in the paper's tables, their least possible errors, and the count of steps."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import tee
from typing import Any, TypeVar

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.observation.evidence import bootstrap_interval
from replay_kit.core.words.progress import Progress, each_call, silent
from replay_kit.estimator import Estimator, ReducedBasisEstimator, build
from replay_kit.estimator.baselines import NearestMember, build_named
from replay_kit.estimator.basis.modes import LENGTH_IN_CELLS, fit_residual
from replay_kit.estimator.basis.slices import cell_size
from replay_kit.workflows.replay.conclude import ScoredPoints, rms_length

Value = TypeVar("Value")


class Advance:
    """Counter of steps that reports to a progress function; without effect in another process.

    Mutable: calls in this process count in it.
    """

    def __init__(self, total: int = 0, progress: Progress = silent) -> None:
        """Create a counter at zero.

        Args:
            total: Total number of steps.
            progress: Called with steps done, total steps, and the current task.
        """
        self._total, self._progress, self.done = total, progress, 0

    def __call__(self, what: str, steps: int = 1) -> None:
        """Count steps of a task."""
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
    """Yield each call with its value, see ``each_call``; calls in other processes are counted when done.

    Args:
        function: See ``each_call``; counts its steps where it runs.
        calls: Arguments of the calls.
        advance: Counter of steps.
        steps: Returns the number of steps of a call.
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
    """Return the estimator of a method: ``default``, ``paper``, ``paper_cells`` or a baseline.

    ``paper_cells`` has the paper's length in cells instead of kilometres, for coarser grids.

    Raises:
        ConfigError: The name is unknown.
    """
    if name not in ("default", "paper", "paper_cells"):
        return build_named(ensemble, config.model_copy(update={"name": name}))
    return build(
        [ensemble],
        preset_config(name, ensemble.grid, config),
        GatingConfig() if name == "default" else None,
    )


def preset_config(name: str, grid: Grid, config: EstimatorConfig) -> EstimatorConfig:
    """Return the settings of ``default``, ``paper`` or ``paper_cells``: preset and length on a grid."""
    length = LENGTH_IN_CELLS * float(np.sqrt(np.prod(cell_size(grid))))
    cells = {"length_horizontal": length} if name == "paper_cells" else {}
    return config.model_copy(
        update={"preset": "default" if name == "default" else "paper", **cells}
    )


def size_of(estimator: Estimator[Any]) -> tuple[int | None, int | None]:
    """Return the number of modes, per level if levels have their own weights, and of basis elements; None without a basis."""
    if not isinstance(estimator, ReducedBasisEstimator):
        return None, None
    basis, process = estimator.observer.basis, estimator.observer.process
    if _has_whole_flows(estimator):
        return process.size, process.size * basis.grid.levels.size * 2 * len(basis.grid.nodes)
    return basis.n_modes, basis.modes.size


def bound(estimator: Estimator[Any], at: ScoredPoints) -> float:
    """Return the least RMSE [m/s] of any flow that an estimator can represent; NaN without a fixed span.

    It is that of the least-squares fit of the truth at the scored points.
    """
    if isinstance(estimator, NearestMember):
        off = _flows_at(estimator.members, at) - at.velocity[..., None]
        return float(np.sqrt(np.square(off).sum(axis=1).mean(axis=0)).min())
    if not isinstance(estimator, ReducedBasisEstimator):
        return float("nan")
    if not _has_whole_flows(estimator):
        basis = estimator.observer.basis
        return rms_length(basis.span_residual(at.points, at.depth, at.velocity))
    flows = _flows_at(estimator, at)
    residual = fit_residual(flows.reshape(-1, flows.shape[2]), at.velocity.ravel())
    return rms_length(residual.reshape(-1, 2))


def _has_whole_flows(estimator: ReducedBasisEstimator) -> bool:
    """Return whether each unknown of an estimator is a flow of all levels."""
    basis = estimator.observer.basis
    return basis.n_modes == len(basis.singular_values) * basis.grid.levels.size


def _flows_at(estimator: ReducedBasisEstimator, at: ScoredPoints) -> Array:
    """Return the velocity of each whole flow at the scored points, shape (P, 2, m) [m/s]."""
    basis = estimator.observer.basis
    out = np.empty((len(at.points), 2, len(basis.member_weights)))
    for start in range(0, len(at.points), 512):
        part = slice(start, start + 512)
        modes = basis.horizontal.velocity(at.points[part], basis.modes)
        weights = basis.depth_weights(at.depth[part])
        by_level = modes.reshape(*modes.shape[:2], -1, weights.shape[1])
        out[part] = np.einsum("cpmz,pz->pcm", by_level, weights)
    return out


def average_over_depth(flow: FlowEstimate, depth: float) -> FlowEstimate:
    """Return a depth-independent flow, the mean of another from the surface to a depth [m], without uncertainty."""
    levels = flow.levels
    regular = np.linspace(0.0, depth, max(int(np.ceil(depth)), 1) + 1)
    # the corners of hat functions are at the levels
    depths = np.union1d(regular, levels[(levels > 0.0) & (levels < depth)])
    by_depth = depth_weights(flow.depth_functions, depths, levels)
    weights = np.trapezoid(by_depth, depths, axis=0) / depth
    latent = np.repeat((flow.latent @ weights)[:, None], levels.size, axis=1)
    hats = DepthFunctions("hat", flow.depth_functions.length)
    return replace(flow.mean_flow(), depth_functions=hats, latent=latent)


def bootstrap_median(values: Array) -> tuple[float, float]:
    """Return the ends of the 90 % bootstrap interval of a median.

    Args:
        values: shape (n,).
    """
    return bootstrap_interval(lambda drawn: np.median(values[drawn], axis=1), values.size)


def miss_figures(misses: Array) -> dict[str, Any]:
    """Return median, ends of its 90 % interval and quartiles of miss distances [m], shape (n,), and the number within 250 m."""
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
