"""Tables of the paper's study on any ensemble: rows over truths from the runs of methods, and glides planned on the estimates."""

import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from math import inf
from statistics import fmean
from typing import TypeVar

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.words.progress import each_call, step_counter
from replay_kit.estimator import embed_member
from replay_kit.studies.paper.cases import (
    IDEAL_ERROR_STD,
    Case,
    draw_pairs,
    grid_observations,
    leave_out,
    members_left_out,
    most_distant,
    random_observations,
)
from replay_kit.studies.paper.methods import (
    GlideRow,
    Run,
    Survey,
    average_over_depth,
    glides_on,
    run,
    rungs,
)
from replay_kit.studies.twins.field import build_field

NOISE = 0.09  # m/s
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class PaperJob:
    """Options of the study.

    Attributes:
        leave_out: ``all``, ``most-distant`` or a member's position from 0; None when a truth is given.
        most_modes: Largest number of modes; None for no limit.
        plan_modes: Largest number of modes of the estimates for plans; None for the full rank.
        pings: Numbers of pings of Table II at which estimates are scored; the last is the table's.
        pairs: Number of starts and targets of Table III.
        seed: Seed of positions, noise and pairs.
    """

    leave_out: str | None = None
    most_modes: int | None = None
    plan_modes: int | None = 300
    pings: tuple[int, ...] = (5, 10, 25, 50, 150, 450)
    pairs: int = 100
    seed: int = 0


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """One estimator in Table I or II; over several truths the median and the worst.

    Attributes:
        method: ``naive3d``, ``paper``, ``paper_cells``, ``default``, ``nearest`` or ``ensemble_mean``.
        rung: Number of modes: ``full``, ``members`` or a number; empty without a choice.
        modes: Number r of basis flows per level, or of whole basis flows of ``naive3d``; None without a basis.
        elements: Number of elements of the basis, the paper's "elements in H"; None without a basis.
        rel_error: RMSE over the truth's RMS speed.
        rmse: RMS length of the error vector over the truth's wet grid points [m/s].
        bound: Least RMSE of any flow in the method's span [m/s].
        rel_error_worst: Relative error of the worst truth.
        rmse_worst: RMSE of the worst truth [m/s].
        rel_error_by_truth: Relative error of each truth.
        seconds: Wall time to build the estimator and assimilate all profiles [s], mean over truths.
        note: Reason for missing figures.
    """

    method: str
    rung: str
    modes: int | None
    elements: int | None
    rel_error: float
    rmse: float
    bound: float
    rel_error_worst: float
    rmse_worst: float
    rel_error_by_truth: tuple[float, ...]
    seconds: float
    note: str


@dataclass(frozen=True, slots=True)
class SparseRow:
    """Estimate after some profiles of Table II; over several truths the median and the worst.

    Attributes:
        pings: Number of profiles so far.
        method: As in ``ErrorRow``.
        modes: Basis flows per level; None without a basis.
        rel_error: RMSE over the truth's RMS speed.
        rel_error_worst: Relative error of the worst truth.
        rel_error_by_truth: Relative error of each truth.
    """

    pings: int
    method: str
    modes: int | None
    rel_error: float
    rel_error_worst: float
    rel_error_by_truth: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperTables:
    """Results of the study, the contents of ``paper.json``.

    Attributes:
        table1: Ideal conditions: each grid point once, no noise.
        table2: Random pings with noise.
        table3: Glides planned on each flow and flown in the truth.
        sparse: Errors after some of Table II's pings.
        ensemble: File of the ensemble.
        truth: File of the truth, the member left out, or ``all``.
        shown_truth: Truth of Table III.
        members: Number of members.
        truths: Number of truths in Tables I and II.
        grid: Points along the grid's two directions.
        levels: Levels [m].
        plan_modes: Largest number of modes for plans; None for the full rank.
        seed: Seed of positions, noise and pairs.
        noise: Noise of a component in Table II [m/s].
        target_depth: Depth of the targets of Table III [m].
        seconds: Wall time of each stage [s].
        unfinished: Whether the study was still running.
    """

    table1: tuple[ErrorRow, ...] = ()
    table2: tuple[ErrorRow, ...] = ()
    table3: tuple[GlideRow, ...] = ()
    sparse: tuple[SparseRow, ...] = ()
    ensemble: str
    truth: str
    shown_truth: str
    members: int
    truths: int = 0
    grid: tuple[int, int]
    levels: tuple[float, ...]
    plan_modes: int | None
    seed: int
    noise: float
    target_depth: float
    seconds: Mapping[str, float] = field(default_factory=dict)
    unfinished: bool = True


def run_paper(
    ensemble: Ensemble, truth: Ensemble | None, config: EstimatorConfig, job: PaperJob
) -> Iterator[PaperTables]:
    """Yield the study's tables: partial ones after each truth's Tables I and II, then the complete ones.

    Args:
        ensemble: All members.
        truth: Ensemble of one; None to leave members out.
        config: Settings except preset, modes, length and the paper's error.
        job: Options.

    Raises:
        ConfigError: A member does not exist.
        ForecastError: The truth has no water, or too little for glides.
        MeasurementError: No point of the truth lies in the region.
    """
    began = time.perf_counter()
    members = members_left_out(ensemble, job.leave_out) if job.leave_out is not None else [0]
    # the truth of Table III: one that has most to show
    shown = most_distant(ensemble) if job.leave_out == "all" else members[0]

    def case_of(member: int) -> Case:
        return Case(truth, ensemble) if truth is not None else leave_out(ensemble, member)

    case, grid = case_of(shown), ensemble.grid
    truth_flow = embed_member(case.truth, 0, config)
    # before the hours of work, because this fails where the region is too small
    pairs = draw_pairs(build_field(case.truth), truth_flow, grid, job.pairs, job.seed)
    tables = PaperTables(
        ensemble=ensemble.source,
        truth="all" if job.leave_out == "all" else case.truth.source,
        shown_truth=case.truth.source,
        members=case.ensemble.n_members,
        grid=(grid.east.shape[0], grid.east.shape[1]),
        levels=tuple(grid.levels.tolist()),
        plan_modes=job.plan_modes,
        seed=job.seed,
        noise=NOISE,
        target_depth=pairs[0][1].depth,
    )
    rows = rungs(case.ensemble, job.most_modes)

    def calls() -> Iterator[tuple[object, ...]]:
        for member in members:
            studied = case_of(member)
            for survey in _surveys(studied.truth, config, job):
                keep = member == shown and survey.counts == job.pings
                yield from ((studied, survey, row, config, keep) for row in rows)

    step = step_counter("tables", 2 * len(members) * len(rows))
    runs = each_call(run, calls())
    flows: dict[str, FlowEstimate | None] = {"truth": truth_flow}
    flows["depth_averaged_truth"] = average_over_depth(truth_flow, tables.target_depth)
    ideal, noisy, planned = list[Run](), list[Run](), list[Run]()
    for number, member in enumerate(members, start=1):
        first, second = (_distinct_ranks(islice(runs, len(rows)), step) for _ in "12")
        few = _planned_on(second, job.plan_modes)
        if member == shown:
            flows |= {one.rung.method: one.flow for one in few}
        ideal += first
        noisy += [replace(one, flow=None) for one in second]
        planned += [replace(one, flow=None) for one in few]
        tables = replace(
            tables,
            table1=error_rows(ideal),
            table2=error_rows(noisy),
            sparse=_sparse_rows(planned, job.pings),
            truths=number,
            seconds={"tables": time.perf_counter() - began},
        )
        yield tables
    measured = time.perf_counter()
    step, table3 = step_counter("plans and flights", len(flows)), list[GlideRow]()
    asked = ((name, flow, truth_flow, pairs) for name, flow in flows.items())
    for row in each_call(glides_on, asked):
        table3.append(row)
        step()
    seconds = {**tables.seconds, "glides": time.perf_counter() - measured}
    yield replace(tables, table3=tuple(table3), seconds=seconds, unfinished=False)


def _surveys(truth: Ensemble, config: EstimatorConfig, job: PaperJob) -> tuple[Survey, Survey]:
    """Return the profiles of Tables I and II."""
    ideal = grid_observations(truth)
    noisy = random_observations(build_field(truth), job.pings[-1], NOISE, job.seed)
    return (
        Survey(ideal, IDEAL_ERROR_STD, (len(ideal),)),
        Survey(noisy, config.paper_error_std, job.pings),
    )


def _distinct_ranks(runs: Iterable[Run], step: Callable[[], None]) -> list[Run]:
    """Return the runs of a table without those that repeat a method's full rank; report a step after each."""
    kept, ranks = list[Run](), dict[str, int]()
    for one in runs:
        if one.rung.modes is None or one.rung.modes < ranks.get(one.rung.method, inf):
            kept.append(one)
        if one.modes is not None:
            ranks.setdefault(one.rung.method, one.modes)
        step()
    return kept


def _planned_on(runs: Iterable[Run], most: int | None) -> list[Run]:
    """Return each method's first run with few enough modes a level; the naive basis has whole flows."""
    few = (one for one in runs if not one.rung.name or (one.modes or 0) <= (most or inf))
    return [alike[0] for alike in grouped(few, lambda one: one.rung.method)]


def error_rows(runs: Iterable[Run]) -> tuple[ErrorRow, ...]:
    """Return the rows of a table; failed truths are excluded from the figures and counted in the note."""
    rows = []
    for alike in grouped(runs, lambda one: one.rung[:2]):
        failed = [one.note for one in alike if one.note]
        measured = [one for one in alike if not one.note] or alike
        of_several = f"{len(failed)} of {len(alike)} truths: " if len(alike) > 1 else ""
        relative = [one.relative[-1] for one in measured]
        rmse = [one.errors[-1] for one in measured]
        rows.append(
            ErrorRow(
                alike[0].rung.method,
                alike[0].rung.name,
                max((one.modes for one in alike if one.modes is not None), default=None),
                max((one.elements for one in alike if one.elements is not None), default=None),
                _median(relative),
                _median(rmse),
                _median([one.bound for one in measured]),
                max(relative),
                max(rmse),
                tuple(one.relative[-1] for one in alike),
                fmean(one.seconds for one in alike),
                of_several + failed[0] if failed else "",
            )
        )
    return tuple(rows)


def _sparse_rows(runs: Iterable[Run], counts: Sequence[int]) -> tuple[SparseRow, ...]:
    """Return the errors after some profiles of the 2.5D methods and of the ensemble mean."""
    shown = [one for one in runs if one.rung.method not in ("naive3d", "nearest")]
    found = []
    for k, count in enumerate(counts):
        for alike in grouped(shown, lambda one: one.rung.method):
            relative = tuple(one.relative[k] for one in alike)
            method, modes = alike[0].rung.method, alike[0].modes
            found.append(
                SparseRow(count, method, modes, _median(relative), max(relative), relative)
            )
    return tuple(found)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))


def grouped(items: Iterable[Item], key: Callable[[Item], Hashable]) -> list[list[Item]]:
    """Return items grouped by key, in order of first occurrence."""
    groups: dict[Hashable, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.values())
