"""Tables of the paper's study on any ensemble."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.words.progress import Progress, silent
from replay_kit.estimator import embed_member
from replay_kit.studies.paper.methods import Advance, average_over_depth, each_counted
from replay_kit.studies.paper.rows import (
    AVERAGED,
    TRUTH,
    ErrorRow,
    GlideRow,
    SparseRow,
    over_truths,
    sparse_over_truths,
)
from replay_kit.studies.paper.tables import (
    Survey,
    run_glides,
    run_table,
    rungs,
    sparse_rows,
)
from replay_kit.studies.twins.adcp import (
    IDEAL_ERROR_STD,
    grid_observations,
    random_observations,
)
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.truths import Case, Pair, cases, draw_pairs, most_distant

NOISE = 0.09  # m/s


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


@dataclass(frozen=True, slots=True, eq=False)
class _OfCase:
    """Tables I and II of one truth, and the estimates for plans."""

    table1: tuple[ErrorRow, ...]
    table2: tuple[ErrorRow, ...]
    sparse: tuple[SparseRow, ...]
    planned: Mapping[str, FlowEstimate | None]


def run_paper(
    ensemble: Ensemble,
    truth: Ensemble | None,
    config: EstimatorConfig,
    job: PaperJob,
    progress: Progress = silent,
) -> Iterator[PaperTables]:
    """Yield the study's tables: partial ones after each truth's Tables I and II, then the complete ones.

    Args:
        ensemble: All members.
        truth: Ensemble of one; None to leave members out.
        config: Settings except preset, modes, length and the paper's error.
        job: Options.
        progress: Called with steps done, total steps, and the current task.

    Raises:
        ConfigError: A member does not exist.
        ForecastError: The truth has no water, or too little for glides.
        MeasurementError: No point of the truth lies in the region.
    """
    began = time.perf_counter()
    each = list(cases(ensemble, truth, job.leave_out))
    case = each[most_distant(ensemble) if job.leave_out == "all" else 0]
    truth_flow = embed_member(case.truth, 0, config)
    # before the hours of work, because this fails where the region is too small
    pairs = draw_pairs(build_field(case.truth), truth_flow, case.ensemble.grid, job.pairs, job.seed)
    advance = Advance(_total(each, job), progress)
    tables, done = _without_tables(case, pairs, job), list[_OfCase]()
    planned: Mapping[str, FlowEstimate | None] = {}
    calls = ((one, config, job, advance) for one in each)
    for (one, *_), of_case in each_counted(_run_case, calls, advance, _steps):
        if one is case:
            planned = of_case.planned
        # only the shown truth's estimates are needed later
        done.append(replace(of_case, planned={}))
        tables = replace(
            tables,
            table1=over_truths([of.table1 for of in done]),
            table2=over_truths([of.table2 for of in done]),
            sparse=sparse_over_truths([of.sparse for of in done]),
            truths=len(done),
            seconds={"tables": time.perf_counter() - began},
        )
        yield tables
    measured = time.perf_counter()
    averaged = average_over_depth(truth_flow, pairs[0].target.depth)
    flows = {TRUTH: truth_flow, AVERAGED: averaged, **planned}
    table3 = run_glides(flows, truth_flow, pairs, advance)
    seconds = {**tables.seconds, "glides": time.perf_counter() - measured}
    yield replace(tables, table3=table3, seconds=seconds, unfinished=False)


def _total(each: list[Case], job: PaperJob) -> int:
    steps = sum(_steps(case, None, job) for case in each)
    methods = {rung.method for rung in rungs(each[0].ensemble, job.most_modes)}
    # beside the methods: the truth and its depth average
    return steps + (len(methods) + 2) * job.pairs


def _steps(case: Case, _: object, job: PaperJob, *__: object) -> int:
    return len(rungs(case.ensemble, job.most_modes)) * (
        int(case.truth.grid.wet[0].sum()) + job.pings[-1]
    )


def _run_case(case: Case, config: EstimatorConfig, job: PaperJob, advance: Advance) -> _OfCase:
    ideal = Survey("Table I", grid_observations(case.truth), IDEAL_ERROR_STD)
    noisy = Survey(
        "Table II",
        random_observations(build_field(case.truth), job.pings[-1], NOISE, job.seed),
        config.paper_error_std,
        job.pings,
    )
    table1 = tuple(run.row for run in run_table(case, ideal, config, job.most_modes, advance))
    rows, planned = [], {}
    for run in run_table(case, noisy, config, job.most_modes, advance):
        rows.append(run.row)
        # the limit is on modes a level; those of the naive basis are whole flows
        few_enough = not run.row.rung or (run.row.modes or 0) <= (job.plan_modes or inf)
        if run.row.method not in planned and few_enough:
            planned[run.row.method] = run
    sparse = sparse_rows(list(planned.values()), noisy)
    flows = {name: run.flow for name, run in planned.items()}
    return _OfCase(table1, tuple(rows), sparse, flows)


def _without_tables(case: Case, pairs: Sequence[Pair], job: PaperJob) -> PaperTables:
    """Return the study's tables before any is computed."""
    grid = case.ensemble.grid
    return PaperTables(
        ensemble=case.ensemble.source,
        truth="all" if job.leave_out == "all" else case.truth.source,
        shown_truth=case.truth.source,
        members=case.ensemble.n_members,
        grid=(grid.east.shape[0], grid.east.shape[1]),
        levels=tuple(float(level) for level in grid.levels),
        plan_modes=job.plan_modes,
        seed=job.seed,
        noise=NOISE,
        target_depth=pairs[0].target.depth,
    )
