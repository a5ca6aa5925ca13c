"""The end of a replay: its summary, its estimate, and the score against a truth."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from replay_kit.core.as_flown import AS_FLOWN
from replay_kit.core.errors import Finding, MeasurementError, PlanError
from replay_kit.core.flow.dataset import write_grid
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import LogReader
from replay_kit.forecast import ensemble_files
from replay_kit.logs.registry import logs_in
from replay_kit.results.mcap_writer import ResultWriter
from replay_kit.results.outcome.from_run import outcome_of
from replay_kit.results.outcome.run import ReplaySummary, Rival, TruthScore
from replay_kit.results.topics import WINDOWS_RECORD
from replay_kit.workflows.replay.array import ArraySession, value_of_each
from replay_kit.workflows.replay.checks import require_usable
from replay_kit.workflows.replay.inputs.job import Prepared, ReplayJob, open_truth
from replay_kit.workflows.replay.inputs.provenance import cited
from replay_kit.workflows.replay.scoring import name_of, rival_inputs, score_against_truth
from replay_kit.workflows.replay.session import Session
from replay_kit.workflows.replay.stages.consistency import conclusions
from replay_kit.workflows.replay.stages.forecast_file import check_file
from replay_kit.workflows.replay.stages.planner import PlanQuery
from replay_kit.workflows.replay.statistics import pooled
from replay_kit.workflows.replay.surfacings.forecasts import next_surfacing

_NOT_DENIED = (
    "the estimate without each vehicle was not made: there are too many vehicles and measurements"
)


def conclude(
    session: Session | ArraySession, inputs: Prepared, others: tuple[Rival, ...] = ()
) -> tuple[ReplaySummary, FlowEstimate]:
    """Publish the result, then compare it with the truth: a truth that does not fit must not cost the result.

    Args:
        session: After the last message.
        inputs: What was read.
        others: The log evidence under other forecasts.
    """
    job, useless = inputs.job, _useless(session, inputs)
    logs = [file for path in job.logs for file in logs_in(path)]
    about = cited((*logs, *ensemble_files(job.ensemble)), session.vehicles[0].config)
    flow = session.conclude(about)
    flows = session.flows if isinstance(session, ArraySession) else {}
    each = {
        one.name: _summary(one, readers, inputs, flows.get(one.name, flow), others)
        for one, readers in zip(session.vehicles, inputs.by_vehicle, strict=True)
    }
    summary = next(iter(each.values()))
    if isinstance(session, ArraySession):
        value = value_of_each(session)
        unused = {one.name: one.why_not for one in job.vehicles if one.why_not} | useless
        notes = (*_notes(session, inputs, flow, ()), *map(": ".join, unused.items()))
        if not value:
            notes += (_NOT_DENIED,)
        if session.windows:
            first = session.vehicles[0].name
            notes += (
                f"estimate.npz, --netcdf, --save-estimate and a score against a truth are of the window of {first}; the result holds all",
            )
        notes += tuple(f"{one.name}: {text}" for one in job.vehicles for text in one.notes)
        summary = replace(
            counted(session, inputs),
            vehicles=each,
            value=value,
            unused=unused,
            notes=notes,
            findings=tuple(
                replace(found, name=f"{name}: {found.name}")
                for name, one in each.items()
                for found in one.findings
            ),
            outside=_outside(inputs),
            inputs=_inputs(job),
        )
    with session.clock.stage("write"):
        if session.writer is not None:
            for one in session.vehicles:
                with session.writer.of(one.name):
                    _record(session.writer, one, each[one.name])
            if isinstance(session, ArraySession):
                session.writer.summary(session.last_ns, outcome_of(summary).to_record())
            if windows := _windows(session):
                session.writer.write_metadata(WINDOWS_RECORD, windows)
            session.writer.finish(flow)
        if job.netcdf is not None:
            write_grid(flow, job.netcdf)
        if job.save_estimate is not None:
            flow.save(job.save_estimate)
    said = [*summary.notes]
    score = None
    if inputs.truth is not None:
        with session.clock.stage("score"):
            score, failures = _score(session, inputs, inputs.truth, flow)
            said += failures
    return replace(
        summary, seconds=dict(session.clock.seconds), truth=score, notes=tuple(said)
    ), flow


def counted(session: Session | ArraySession, inputs: Prepared) -> ReplaySummary:
    """Return the summary of what was counted so far, of all vehicles together."""
    each = {
        one.name: (one.statistics, [reader.report() for reader in readers])
        for one, readers in zip(session.vehicles, inputs.by_vehicle, strict=True)
    }
    if isinstance(session, ArraySession):
        return pooled(each)
    statistics, reports = each[session.name]
    summary: ReplaySummary = statistics.summary(reports)
    return summary


def findings_so_far(session: Session | ArraySession) -> tuple[Finding, ...]:
    """Return the contradictions found so far, of all vehicles."""
    return tuple(found for one in session.vehicles for found in one.monitoring.findings)


def _useless(session: Session | ArraySession, inputs: Prepared) -> dict[str, str]:
    """Return why vehicles gave nothing to the estimate, by their names.

    Raises:
        MeasurementError: The only vehicle gave nothing, or none of several.
    """
    useless, last = dict[str, str](), None
    for one, readers in zip(session.vehicles, inputs.by_vehicle, strict=True):
        reports, grid = [reader.report() for reader in readers], inputs.forecasts.ensemble.grid
        try:
            first = readers[0].input
            require_usable(one.monitoring, one.statistics, reports, grid, one.config, first)
        except MeasurementError as error:
            if isinstance(session, Session) or error.findings:
                raise
            useless[one.name], last = str(error), error
    if last is not None and len(useless) == len(session.vehicles):
        raise last
    return useless


def _summary(
    session: Session,
    readers: Sequence[LogReader],
    inputs: Prepared,
    flow: FlowEstimate,
    others: tuple[Rival, ...],
) -> ReplaySummary:
    """Return the summary of one vehicle."""
    job, reports = inputs.job, [reader.report() for reader in readers]
    of_logs = session.statistics.notes(reports) + session.publishing.surface.notes
    planning = session.planning
    found, blind = conclusions(
        session.monitoring,
        session.statistics.profiles,
        session.config,
        session.statistics.messages.skipped,
        check_file(session.built, session.monitoring.means),
    )
    summary: ReplaySummary = session.statistics.summary(reports)
    told = session.config.planner.depth
    depth = told if isinstance(told, float) else None
    return replace(
        summary,
        plan=None if planning.result is None else planning.result.plan,
        plan_note=planning.failure,
        outcomes=planning.outcomes,
        surfacings=session.forecasts.outcomes,
        next_surfacing=next_surfacing(session.forecasts, flow, depth),
        ensemble=name_of(job.ensemble) if others else "",
        rivals=others,
        # what is not of the vehicle is said once, of all
        notes=tuple(of_logs if job.vehicles else _notes(session, inputs, flow, of_logs)),
        findings=found,
        doubts=blind,
        outside=_outside(inputs),
        inputs=_inputs(job),
        flight_correction=session.flight.correction(session.statistics.profiles.corrections),
    )


def _inputs(job: ReplayJob) -> tuple[Path, ...]:
    return (*job.logs, *ensemble_files(job.ensemble), *rival_inputs(job.against).values())


def _outside(inputs: Prepared) -> tuple[str, ...]:
    notes = inputs.forecasts.notes
    return tuple(note for note in notes if "outside" in note or "is no forecast" in note)


def _record(writer: ResultWriter, session: Session, summary: ReplaySummary) -> None:
    """Write what is found of one vehicle at the end."""
    writer.consistency(session.last_ns, summary.findings)
    writer.summary(session.last_ns, outcome_of(summary).to_record())
    if (flown := session.forecasts.as_flown) is not None:
        writer.record(AS_FLOWN, flown.to_record())


def _windows(session: Session | ArraySession) -> dict[str, str]:
    """Return what a result states of its windows: how many do not count, and of vehicles whose is not the last one which it is."""
    withdrawn = session.vehicles[0].publishing.withdrawn
    own = session.windows if isinstance(session, ArraySession) else {}
    return ({"withdrawn": str(withdrawn)} if withdrawn else {}) | (
        {"vehicles": json.dumps(own)} if own else {}
    )


def _notes(
    session: Session | ArraySession, inputs: Prepared, flow: FlowEstimate, of_logs: Sequence[str]
) -> list[str]:
    """Return what the user should know of the forecast, the logs, the basis, the prior and the instrument, as sentences."""
    kernel, estimator = flow.horizontal.kernel, session.estimator
    lengths = f"{kernel.length_east / 1e3:.1f} x {kernel.length_north / 1e3:.1f} km"
    basis = f"{flow.n_modes} modes a level, kernel lengths {lengths}, mu {kernel.speed:.3f} m/s"
    no_goal = (
        []
        if inputs.job.goals
        else ["no goal was given (--goal LON,LAT,DEPTH), so nothing was planned"]
    )
    # biases are one instrument's
    biases = estimator.remarks(_state(session))
    return [*inputs.forecasts.notes, *of_logs, basis, *estimator.notes(), *biases, *no_goal]


def _state(session: Session | ArraySession) -> Any:
    """Return the estimator's state."""
    return session.vehicles[0].estimation.current


def _score(
    session: Session | ArraySession, inputs: Prepared, truth: Ensemble, flow: FlowEstimate
) -> tuple[TruthScore | None, list[str]]:
    """Return the score, or as much of it as there is, and why the rest is missing."""
    job, forecasts, prior_flow, config = (
        inputs.job,
        inputs.forecasts,
        inputs.prior_flow,
        session.config,
    )
    if forecasts.evolves:
        # the estimate is of the log's end, and so is what it is compared with
        truth = open_truth(job, config, flow.time_ns, forecasts.ensemble, forecasts.box) or truth
        prior_flow = prior_flow.moved(session.last_ns)
    if forecasts.read is not None:
        forecasts, box = forecasts.in_last_window(flow.grid)
        truth = open_truth(job, config, forecasts.near_ns, forecasts.ensemble, box) or truth
    positions = [place for one in session.vehicles for place in one.statistics.profiles.positions]
    ensemble = forecasts.nearest(flow.time_ns)
    try:
        score, truth_flow = score_against_truth(
            flow, ensemble, truth, positions, job.truth_radius_km, config.estimator
        )
    except MeasurementError as error:
        return None, [f"no score: {error}"]
    if isinstance(session, ArraySession):
        # each vehicle has a plan of its own
        return score, []
    problem, result = session.problem, session.planning.result
    if problem is None or result is None or result.plan.status == "failed":
        return score, []
    plan = result.plan
    query = PlanQuery(plan.start, plan.goal, plan.start_time_ns)
    mean_plan = problem.planner.plan(prior_flow, query)
    try:
        closest = [
            problem.planner.closest_approach(truth_flow, planned) for planned in (result, mean_plan)
        ]
    except PlanError as error:
        return score, [f"the plans cannot be flown in the truth: {error}"]
    return replace(
        score, closest_approach_m=closest[0], ensemble_mean_closest_approach_m=closest[1]
    ), []
