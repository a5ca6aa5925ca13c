"""Tables I and II, all estimators on one truth with ideal and noisy profiles, and Table III, glides planned on each flow."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import planners
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.observation import Observation
from replay_kit.estimator import embed_member
from replay_kit.estimator.basis.slices import cell_size
from replay_kit.studies.paper.methods import (
    Advance,
    bound,
    build_method,
    each_counted,
    miss_figures,
    size_of,
)
from replay_kit.studies.paper.rows import ErrorRow, GlideRow, SparseRow
from replay_kit.studies.twins.truths import Case, Pair
from replay_kit.workflows.replay.conclude import ScoredPoints, rms_length, scored_points

# The paper's numbers of modes below the full rank; one for each member comes with them.
NUMBERS_OF_MODES = (400, 300, 200)
# One glide at a constant velocity through water; the longest [s].
_GLIDE = planners.MissionSettings(yos=0, max_duration=432000.0)
# The paper's cells, 8.6 x 11 km [m]; a grid is coarser when its cells are a tenth larger than these.
_PAPER_CELL = float(np.sqrt(8.6e3 * 11e3))


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Profiles for every row of a table, in order.

    Attributes:
        name: Name of the table in progress reports.
        observations: Profiles.
        paper_error_std: Error of every bin in the paper's error model [m/s].
        counts: Numbers of profiles at which estimates are scored, increasing.
    """

    name: str
    observations: tuple[Observation, ...]
    paper_error_std: float
    counts: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Rung:
    """Row to compute.

    Attributes:
        method: As in ``ErrorRow``.
        name: Name of the number of modes: ``full``, ``members``, a number; empty without a choice.
        modes: Largest number of basis flows per level; None for all.
    """

    method: str
    name: str
    modes: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Computed row.

    Attributes:
        row: Figures.
        flow: Estimate after all profiles, without uncertainty; None if it failed.
        on_the_way: Relative errors at ``Survey.counts``; NaN after a failure.
    """

    row: ErrorRow
    flow: FlowEstimate | None
    on_the_way: tuple[float, ...]


def methods_with_modes(grid: Grid) -> tuple[str, ...]:
    """Return the 2.5D methods, with ``paper_cells`` if the grid is coarser than the paper's."""
    coarser = float(np.sqrt(np.prod(cell_size(grid)))) > 1.1 * _PAPER_CELL
    return ("paper", "paper_cells", "default") if coarser else ("paper", "default")


def rungs(ensemble: Ensemble, most_modes: int | None) -> tuple[Rung, ...]:
    """Return the rows of Tables I and II; a lower full rank gives fewer.

    Args:
        ensemble: Members.
        most_modes: Largest number of modes; None for no limit.
    """
    slices = ensemble.n_members * ensemble.grid.levels.size
    most = min(2 * ensemble.grid.nodes.shape[0], slices, most_modes or slices)
    fewer = {str(n): n for n in NUMBERS_OF_MODES} | {"members": ensemble.n_members}
    below = sorted(((n, name) for name, n in fewer.items() if n < most), reverse=True)
    first = Rung("", "full" if most_modes is None else str(most_modes), most_modes)
    ladder = (first, *(Rung("", name, n) for n, name in below))
    reduced = (
        replace(rung, method=method)
        for method in methods_with_modes(ensemble.grid)
        for rung in ladder
    )
    return (
        Rung("naive3d", "", None),
        *reduced,
        Rung("nearest", "", None),
        Rung("ensemble_mean", "", None),
    )


def run_table(
    case: Case, survey: Survey, config: EstimatorConfig, most_modes: int | None, advance: Advance
) -> Iterator[Run]:
    """Yield the rows of a table.

    Args:
        case: Truth and members.
        survey: Profiles.
        config: Settings except preset, modes, length and the paper's error.
        most_modes: Largest number of modes; None for no limit.
        advance: Counter of profiles.
    """
    at = scored_points(case.ensemble.grid, case.truth)
    ranks: dict[str, int] = {}
    for rung in rungs(case.ensemble, most_modes):
        what = f"{case.truth.source} {survey.name} {rung.method} {rung.name}"
        if rung.method in ranks and rung.modes is not None and rung.modes >= ranks[rung.method]:
            advance(what, len(survey.observations))
            continue
        run = _run(rung, case, survey, config, at, partial(advance, what))
        if run.row.modes is not None:
            ranks.setdefault(rung.method, run.row.modes)
        yield run


def sparse_rows(runs: Sequence[Run], survey: Survey) -> tuple[SparseRow, ...]:
    """Return the errors after some profiles of the 2.5D methods and of the ensemble mean.

    Args:
        runs: One run per method.
        survey: Their profiles.
    """
    shown = [run for run in runs if run.on_the_way and run.row.method not in ("naive3d", "nearest")]
    return tuple(
        SparseRow(
            n,
            run.row.method,
            run.row.modes,
            run.on_the_way[k],
            run.on_the_way[k],
            (run.on_the_way[k],),
        )
        for k, n in enumerate(survey.counts)
        for run in shown
    )


def _run(
    rung: Rung,
    case: Case,
    survey: Survey,
    config: EstimatorConfig,
    at: ScoredPoints,
    advance: Callable[[int], None],
) -> Run:
    """Return the run of a row; a numerical failure becomes its note."""
    began, done = time.perf_counter(), 0
    modes = elements = None
    least, errors = np.nan, []
    try:
        if rung.method == "ensemble_mean":
            mean = replace(
                case.ensemble, velocity=case.ensemble.velocity.mean(axis=0, keepdims=True)
            )
            flow = embed_member(mean, 0, config)
            least = _rmse(flow, at)
            errors = [least] * len(survey.counts)
        else:
            estimator = build_method(rung.method, case.ensemble, _config(rung, config, survey))
            modes, elements = size_of(estimator)
            least = bound(estimator, at)
            state = estimator.initial()
            for count in sorted({*survey.counts, len(survey.observations)}):
                state, steps = estimator.assimilate(state, survey.observations[done:count])
                done += len(steps)
                advance(len(steps))
                if count in survey.counts:
                    errors.append(_rmse(estimator.flow(state), at))
            # without its uncertainty: at full rank the covariance takes 300 MB
            flow = estimator.flow(state).mean_flow()
        rmse = _rmse(flow, at)
        note = "" if np.isfinite(rmse) else "the estimate is not a number"
    except (EstimatorError, ValueError) as error:
        # NumPy's LinAlgError is one, and so is SciPy's refusal of numbers that are not finite
        rmse, note = (
            np.nan,
            f"failed at profile {done + 1}: {error}" if done else f"cannot be built: {error}",
        )
    advance(len(survey.observations) - done)
    speed = rms_length(at.velocity)
    relative = rmse / speed
    seconds = time.perf_counter() - began
    row = ErrorRow(
        rung.method,
        rung.name,
        modes,
        elements,
        relative,
        rmse,
        least,
        relative,
        rmse,
        (relative,),
        seconds,
        note,
    )
    on_the_way = [*errors, *[np.nan] * (len(survey.counts) - len(errors))]
    return Run(row, flow if not note else None, tuple(error / speed for error in on_the_way))


def _config(rung: Rung, config: EstimatorConfig, survey: Survey) -> EstimatorConfig:
    # the naive basis takes its error model from the preset, and the paper's is the one it was compared under
    return config.model_copy(
        update={"preset": "paper", "modes": rung.modes, "paper_error_std": survey.paper_error_std}
    )


def _rmse(flow: FlowEstimate, at: ScoredPoints) -> float:
    return rms_length(flow.velocity(*at.place) - at.velocity)


def run_glides(
    flows: Mapping[str, FlowEstimate | None],
    truth: FlowEstimate,
    pairs: tuple[Pair, ...],
    advance: Advance,
) -> tuple[GlideRow, ...]:
    """Return the closest approaches to the targets of the plans on each flow, in order.

    Args:
        flows: Flows for plans; None if an estimate failed.
        truth: Current in which the plans are flown.
        pairs: Starts and targets.
        advance: Counter of plans.
    """
    calls = (
        (name, flow, truth, pairs, partial(advance, f"Table III {name}"))
        for name, flow in flows.items()
    )
    each = each_counted(_glides_on, calls, advance, lambda *_: len(pairs))
    return tuple(row for _, row in each)


def _glides_on(
    name: str,
    flow: FlowEstimate | None,
    truth: FlowEstimate,
    pairs: tuple[Pair, ...],
    advance: Callable[[int], None],
) -> GlideRow:
    if flow is None:
        advance(len(pairs))
        return GlideRow(name, note="there is no estimate to plan on")
    began = time.perf_counter()
    distances = []
    for pair in pairs:
        request = planners.MissionRequest(pair.start, (pair.target,), settings=_GLIDE)
        plan = planners.plan_mission(flow, request)
        distances.append(planners.closest_approach(truth, plan))
        advance(1)
    seconds = time.perf_counter() - began
    return GlideRow(
        name,
        len(pairs),
        **miss_figures(np.array(distances)),
        seconds=seconds,
        closest_approach=tuple(distances),
    )
