"""The end of a replay: its summary, its estimate, and the score against a truth."""

from collections.abc import Sequence
from dataclasses import replace

from replay_kit.core.as_flown import AS_FLOWN
from replay_kit.core.errors import MeasurementError, PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.netcdf import write_grid
from replay_kit.core.grid import Ensemble
from replay_kit.forecast import ensemble_files
from replay_kit.results.outcome.from_run import outcome_of
from replay_kit.results.outcome.run import ReplaySummary, Rival, TruthScore
from replay_kit.results.topics import WINDOWS_RECORD
from replay_kit.workflows.replay.checks import require_usable
from replay_kit.workflows.replay.inputs.opened import Prepared, open_truth
from replay_kit.workflows.replay.referee import name_of, rival_inputs
from replay_kit.workflows.replay.scoring import score_against_truth
from replay_kit.workflows.replay.session import Session
from replay_kit.workflows.replay.stages.consistency import conclusions
from replay_kit.workflows.replay.stages.planner import PlanQuery
from replay_kit.workflows.replay.surfacings.forecasts import next_surfacing


def conclude(
    session: Session, inputs: Prepared, others: tuple[Rival, ...] = ()
) -> tuple[ReplaySummary, FlowEstimate]:
    """Publish the result, then compare it with the truth: a truth that does not fit must not cost the result.

    Args:
        session: After the last message.
        inputs: What was read.
        others: The log evidence under other forecasts.
    """
    job, reports = inputs.job, [reader.report() for reader in inputs.readers]
    require_usable(
        session.monitoring,
        session.statistics,
        reports,
        inputs.forecasts.ensemble.grid,
        session.config,
    )
    flow = session.conclude()
    notes = _notes(session, inputs, flow, session.statistics.notes(reports))
    planning, (found, blind) = (
        session.planning,
        conclusions(
            session.monitoring,
            session.statistics.profiles,
            session.config,
            session.statistics.messages.skipped,
        ),
    )
    outside = tuple(
        note for note in inputs.forecasts.notes if "outside" in note or "is no forecast" in note
    )
    summary = replace(
        session.statistics.summary(reports),
        plan=None if planning.result is None else planning.result.plan,
        plan_note=planning.failure,
        outcomes=planning.outcomes,
        surfacings=session.forecasts.outcomes,
        next_surfacing=next_surfacing(session.forecasts, flow),
        ensemble=name_of(job.ensemble) if others else "",
        rivals=others,
        notes=tuple(notes),
        findings=found,
        doubts=blind,
        outside=outside,
        inputs=(*job.logs, *ensemble_files(job.ensemble), *rival_inputs(job.against).values()),
        flight_correction=session.flight.correction(session.statistics.profiles.corrections),
    )
    with session.clock.stage("write"):
        if session.writer is not None:
            session.writer.consistency(session.last_ns, found)
            session.writer.summary(session.last_ns, outcome_of(summary).to_record())
            if spread := session.estimator.spread_record(session.estimation.current):
                session.writer.write_metadata("replay_kit.spread", spread)
            if (flown := session.forecasts.as_flown) is not None:
                session.writer.write_metadata(AS_FLOWN, flown.to_record())
            if withdrawn := session.publishing.withdrawn:
                session.writer.write_metadata(WINDOWS_RECORD, {"withdrawn": str(withdrawn)})
            session.writer.finish(flow)
        if job.netcdf is not None:
            write_grid(flow, job.netcdf)
        if job.save_estimate is not None:
            flow.save(job.save_estimate)
    score = None
    if inputs.truth is not None:
        with session.clock.stage("score"):
            score, failures = _score(session, inputs, inputs.truth, flow)
            notes += failures
    return replace(
        summary, seconds=dict(session.clock.seconds), truth=score, notes=tuple(notes)
    ), flow


def _notes(
    session: Session, inputs: Prepared, flow: FlowEstimate, of_logs: Sequence[str]
) -> list[str]:
    """Return what the user should know of the forecast, the logs, the basis, the prior and the instrument, as sentences."""
    kernel, estimator = flow.horizontal.kernel, session.estimator
    lengths = f"{kernel.length_east / 1e3:.1f} x {kernel.length_north / 1e3:.1f} km"
    basis = f"{flow.n_modes} modes a level, kernel lengths {lengths}, mu {kernel.speed:.3f} m/s"
    no_goal = (
        []
        if inputs.job.goal is not None
        else ["no goal was given (--goal LON,LAT,DEPTH), so nothing was planned"]
    )
    biases = estimator.bias_notes(session.estimation.current)
    return [*inputs.forecasts.notes, *of_logs, basis, *estimator.notes(), *biases, *no_goal]


def _score(
    session: Session, inputs: Prepared, truth: Ensemble, flow: FlowEstimate
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
        prior_flow = prior_flow.at(session.last_ns)
    if forecasts.read is not None:
        forecasts, box = forecasts.in_last_window(flow.grid)
        truth = open_truth(job, config, forecasts.near_ns, forecasts.ensemble, box) or truth
    positions, ensemble = session.statistics.profiles.positions, forecasts.nearest(flow.time_ns)
    try:
        score, truth_flow = score_against_truth(
            flow, ensemble, truth, positions, job.truth_radius_km, config.estimator
        )
    except MeasurementError as error:
        return None, [f"no score: {error}"]
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
