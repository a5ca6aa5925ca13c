"""Runs of the study: each method of the paper's tables on the profiles of a truth, and glides planned on its estimate."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

import planners
from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.observation import Observation
from replay_kit.core.observation.evidence import bootstrap_interval
from replay_kit.estimator import Estimator, ReducedBasisEstimator, build, embed_member
from replay_kit.estimator.baselines import NearestMember, build_named
from replay_kit.estimator.basis.modes import LENGTH_IN_CELLS, fit_residual
from replay_kit.estimator.basis.slices import cell_size
from replay_kit.studies.paper.cases import Case, Pair
from replay_kit.workflows.replay.conclude import ScoredPoints, rms_length, scored_points

#: Names of methods and flows in tables and legends.
LABELS = {
    "truth": "truth",
    "depth_averaged_truth": "depth-averaged truth",
    "naive3d": "naive 3D basis",
    "paper": "2.5D paper, l = 10 km",
    "paper_cells": "2.5D paper, l = 1.16 cells",
    "default": "2.5D default",
    "nearest": "nearest member",
    "ensemble_mean": "ensemble mean",
}
# The paper's numbers of modes below the full rank; one for each member comes with them.
_NUMBERS_OF_MODES = (400, 300, 200)
# One glide at a constant velocity through water; the longest [s].
_GLIDE = planners.MissionSettings(yos=0, max_duration=432000.0)
# The paper's cells, 8.6 x 11 km [m]; a grid is coarser when its cells are a tenth larger than these.
_PAPER_CELL = float(np.sqrt(8.6e3 * 11e3))
#: A goal that is passed this close counts as reached [m].
_NEAR = 250.0


class Survey(NamedTuple):
    """Profiles for every row of a table.

    Attributes:
        observations: Profiles, in order.
        paper_error_std: Error of every bin in the paper's error model [m/s].
        counts: Numbers of profiles at which estimates are scored, increasing; the last is that of all.
    """

    observations: Sequence[Observation]
    paper_error_std: float
    counts: Sequence[int]


class Rung(NamedTuple):
    """Row to compute.

    Attributes:
        method: A key of ``LABELS``.
        name: Name of the number of modes: ``full``, ``members``, a number; empty without a choice.
        modes: Largest number of basis flows per level; None for all.
    """

    method: str
    name: str
    modes: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Computed row for one truth.

    Attributes:
        rung: What was computed.
        speed: RMS speed of the truth [m/s].
        modes: Number of basis flows per level, or of whole flows; None without a basis.
        elements: Number of elements of the basis; None without a basis.
        bound: Least RMSE of any flow in the method's span [m/s].
        errors: RMSE at ``Survey.counts`` [m/s]; NaN after a failure.
        seconds: Wall time [s].
        flow: Estimate after all profiles, without uncertainty; None if it failed or is not needed.
        note: Reason for a failure.
    """

    rung: Rung
    speed: float
    modes: int | None
    elements: int | None
    bound: float
    errors: tuple[float, ...]
    seconds: float
    flow: FlowEstimate | None
    note: str

    @property
    def relative(self) -> list[float]:
        """Relative errors at ``Survey.counts``: RMSE over the RMS speed of the truth."""
        return [error / self.speed for error in self.errors]


def rungs(ensemble: Ensemble, most_modes: int | None) -> list[Rung]:
    """Return the rows of Tables I and II; a lower full rank gives fewer.

    Args:
        ensemble: Members.
        most_modes: Largest number of modes; None for no limit.
    """
    slices = ensemble.n_members * ensemble.grid.levels.size
    most = min(2 * len(ensemble.grid.nodes), slices, most_modes or slices)
    fewer = {str(n): n for n in _NUMBERS_OF_MODES} | {"members": ensemble.n_members}
    below = sorted(((n, name) for name, n in fewer.items() if n < most), reverse=True)
    ladder = [(most_modes, str(most_modes or "full")), *below]
    coarser = _cell(ensemble.grid) > 1.1 * _PAPER_CELL
    reduced = ("paper", *["paper_cells"] * coarser, "default")
    return [
        Rung("naive3d", "", None),
        *(Rung(method, name, n) for method in reduced for n, name in ladder),
        Rung("nearest", "", None),
        Rung("ensemble_mean", "", None),
    ]


def _cell(grid: Grid) -> float:
    """Return the size of a grid's cells, the geometric mean of both sides [m]."""
    return float(np.sqrt(np.prod(cell_size(grid))))


def build_method(name: str, ensemble: Ensemble, config: EstimatorConfig) -> Estimator[Any]:
    """Return the estimator of a method: ``default``, ``paper``, ``paper_cells`` or a baseline.

    ``paper_cells`` has the paper's length in cells instead of kilometres, for coarser grids.

    Raises:
        ConfigError: The name is unknown.
    """
    changes: dict[str, Any] = {"preset": "default" if name == "default" else "paper"}
    if name == "paper_cells":
        changes["length_horizontal"] = LENGTH_IN_CELLS * _cell(ensemble.grid)
    if name not in ("default", "paper", "paper_cells"):
        # the naive basis takes its error model from the preset, and the paper's is the one it was compared under
        return build_named(ensemble, config.model_copy(update=changes | {"name": name}))
    gating = GatingConfig() if name == "default" else None
    return build([ensemble], config.model_copy(update=changes), gating)


def span_of(estimator: Estimator[Any], at: ScoredPoints) -> tuple[int | None, int | None, float]:
    """Return the number of modes and of basis elements, None without a basis, and the least RMSE [m/s] of any flow in the span.

    Modes are counted per level if levels have their own weights. The least RMSE is that of the least-squares fit of the truth at the scored
    points, or of the nearest member.
    """
    if isinstance(estimator, NearestMember):
        off = _flows_at(estimator.members, at) - at.velocity[..., None]
        return None, None, float(np.sqrt(np.square(off).sum(axis=1).mean(axis=0)).min())
    assert isinstance(estimator, ReducedBasisEstimator)
    basis, size = estimator.observer.basis, estimator.observer.process.size
    n_levels = basis.grid.levels.size
    if basis.n_modes != len(basis.singular_values) * n_levels:
        bound = rms_length(basis.span_residual(at.points, at.depth, at.velocity))
        return basis.n_modes, basis.modes.size, bound
    # each unknown is a flow of all levels
    flows = _flows_at(estimator, at)
    residual = fit_residual(flows.reshape(-1, flows.shape[2]), at.velocity.ravel())
    return size, size * n_levels * 2 * len(basis.grid.nodes), rms_length(residual.reshape(-1, 2))


def _flows_at(estimator: ReducedBasisEstimator, at: ScoredPoints) -> Array:
    """Return the velocity of each whole flow at the scored points, shape (P, 2, m) [m/s]."""
    basis, mean = estimator.observer.basis, estimator.flow(estimator.initial()).mean_flow()
    latents = basis.modes.reshape(len(basis.modes), -1, basis.grid.levels.size)
    each = [
        replace(mean, latent=latent).velocity(*at.place) for latent in np.moveaxis(latents, 1, 0)
    ]
    return np.stack(each, axis=-1)


def run(case: Case, survey: Survey, rung: Rung, config: EstimatorConfig, keep: bool) -> Run:
    """Return the run of a row; a numerical failure becomes its note.

    Args:
        case: Truth and members.
        survey: Profiles.
        rung: Row.
        config: Settings except preset, modes, length and the paper's error.
        keep: Whether the estimate is needed.
    """
    began, done, at = time.perf_counter(), 0, scored_points(case.ensemble.grid, case.truth)

    def rmse(flow: FlowEstimate) -> float:
        return rms_length(flow.velocity(*at.place) - at.velocity)

    modes, elements, bound, flow, note = None, None, np.nan, None, ""
    errors: list[float] = []
    try:
        if rung.method == "ensemble_mean":
            mean = case.ensemble.velocity.mean(axis=0, keepdims=True)
            flow = embed_member(replace(case.ensemble, velocity=mean), 0, config)
            bound = rmse(flow)
            errors = [bound] * len(survey.counts)
        else:
            changes = {"modes": rung.modes, "paper_error_std": survey.paper_error_std}
            estimator = build_method(rung.method, case.ensemble, config.model_copy(update=changes))
            modes, elements, bound = span_of(estimator, at)
            state = estimator.initial()
            for count in survey.counts:
                state, _ = estimator.assimilate(state, survey.observations[done:count])
                # without its uncertainty: at full rank the covariance takes 300 MB
                done, flow = count, estimator.flow(state).mean_flow()
                errors.append(rmse(flow))
        if not np.isfinite(errors[-1]):
            note = "the estimate is not a number"
    except (EstimatorError, ValueError) as error:
        # NumPy's LinAlgError is one, and so is SciPy's refusal of numbers that are not finite
        note = f"failed at profile {done + 1}: {error}" if done else f"cannot be built: {error}"
    errors += [np.nan] * (len(survey.counts) - len(errors))
    return Run(
        rung,
        rms_length(at.velocity),
        *(modes, elements, bound, tuple(errors), time.perf_counter() - began),
        flow if keep and not note else None,
        note,
    )


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


@dataclass(frozen=True, slots=True)
class GlideRow:
    """Plans made on one flow and flown in the truth (Table III).

    Attributes:
        flow: ``truth``, ``depth_averaged_truth`` or a method.
        pairs: Number of starts and targets.
        median: Median closest approach to the target [m].
        lower_quartile: Lower quartile [m].
        upper_quartile: Upper quartile [m].
        median_low: Lower end of the bootstrap 90 % interval of the median [m].
        median_high: Upper end [m].
        within_250: Number of pairs within 250 m.
        seconds: Wall time of all plans and flights [s].
        closest_approach: By pair [m].
        note: Reason for missing figures.
    """

    flow: str
    pairs: int = 0
    median: float = np.nan
    lower_quartile: float = np.nan
    upper_quartile: float = np.nan
    median_low: float = np.nan
    median_high: float = np.nan
    within_250: int = 0
    seconds: float = 0.0
    closest_approach: tuple[float, ...] = ()
    note: str = ""


def glides_on(
    name: str, flow: FlowEstimate | None, truth: FlowEstimate, pairs: Sequence[Pair]
) -> GlideRow:
    """Return the closest approaches to the targets of the plans on a flow, None if its estimate failed, flown in the truth."""
    if flow is None:
        return GlideRow(name, note="there is no estimate to plan on")
    began, found = time.perf_counter(), []
    for start, target in pairs:
        request = planners.MissionRequest(start, (target,), settings=_GLIDE)
        found.append(planners.closest_approach(truth, planners.plan_mission(flow, request)))
    misses = np.array(found)
    lower, median, upper = np.quantile(misses, [0.25, 0.5, 0.75]).tolist()
    interval = bootstrap_interval(lambda drawn: np.median(misses[drawn], axis=1), misses.size)
    near, seconds = int(np.sum(misses <= _NEAR)), time.perf_counter() - began
    return GlideRow(name, len(pairs), median, lower, upper, *interval, near, seconds, tuple(found))
