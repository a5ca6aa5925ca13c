"""End of a replay: outcome, estimate, and score against a truth."""

import json
import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from replay_kit.config.run import OutputConfig
from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import AS_FLOWN
from replay_kit.core.errors import MeasurementError, PlanError, finding_json
from replay_kit.core.evidence import Evidence
from replay_kit.core.flow.dataset import write_grid
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Profiles
from replay_kit.forecast import ensemble_files
from replay_kit.logs.opening import logs_in
from replay_kit.results.outcome.outcome import Outcome, made
from replay_kit.results.outcome.parts import (
    comparison_part,
    correction_part,
    expected_part,
    plan_part,
    surfacings_part,
)
from replay_kit.results.slices import depth_slices
from replay_kit.results.topics import WINDOWS_RECORD
from replay_kit.workflows.replay.account import together
from replay_kit.workflows.replay.follow_up import end, left_windows, publish
from replay_kit.workflows.replay.inputs.estimator import flow_at
from replay_kit.workflows.replay.inputs.job import open_truth
from replay_kit.workflows.replay.inputs.provenance import cited
from replay_kit.workflows.replay.prepare import Prepared
from replay_kit.workflows.replay.run import Run
from replay_kit.workflows.replay.scoring import (
    name_of,
    rival_inputs,
    score_against_truth,
)
from replay_kit.workflows.replay.stages.consistency import conclusions, require_one_vehicle
from replay_kit.workflows.replay.stages.forecast_file import check_file
from replay_kit.workflows.replay.stages.planner import PlanQuery
from replay_kit.workflows.replay.stages.publishing import published_depths
from replay_kit.workflows.replay.surfacings.forecasts import next_surfacing

# Measurements times vehicles up to which the estimate is made without each: it takes as many updates.
_MOST_DENIED = 20_000
# In a note on a forecast that is not of the log's place or time.
_OUTSIDE = re.compile("outside|not a forecast")
_NOT_DENIED = (
    "the estimate without each vehicle was not computed: too many vehicles and observations"
)


def conclude(
    run: Run, inputs: Prepared, others: Sequence[tuple[str, Evidence]] = ()
) -> tuple[Outcome, FlowEstimate]:
    """Publish the result, then score it against the truth, so that an unsuitable truth does not lose the result.

    Args:
        run: Run after the last message.
        inputs: Inputs of the run.
        others: Names of competing forecasts, and the log evidence under each.
    """
    job, useless = inputs.job, useless_of(run, inputs)
    logs = [file for path in job.logs for file in logs_in(path)]
    about = cited((*logs, *ensemble_files(job.ensemble)), run.config)
    flows, windows = _last_flows(run, about)
    found = [_found(run, number, inputs, own) for number, own in enumerate(flows)]
    for each, of in zip(found, run.of, strict=True):
        if others and (evidence := of.counts.log_evidence) is not None:
            each["comparison"] = comparison_part(name_of(job.ensemble), evidence, others)
    files = (*job.logs, *ensemble_files(job.ensemble), *rival_inputs(job.against).values())
    if job.vehicles:
        outcome = made(_of_several(run, inputs, flows, found, useless, bool(windows)), files)
    else:
        outcome = made(
            found[0] | {"notes": _notes(run, inputs, flows[0], found[0]["notes"])}, files
        )
    with run.clock.stage("write"):
        _write(run, inputs, outcome, [each["consistency"] for each in found], flows[0], windows)
    score, said = None, list[str]()
    if inputs.truth is not None:
        with run.clock.stage("score"):
            score, said = _score(run, inputs, inputs.truth, flows[0])
    truth, seconds = made({"truth": score}).truth, dict(run.clock.seconds)
    notes = (*outcome.notes, *said)
    return replace(outcome, seconds=seconds, truth=truth, notes=notes), flows[0]


def _write(
    run: Run,
    inputs: Prepared,
    outcome: Outcome,
    findings: Sequence[Sequence[Mapping[str, Any]]],
    flow: FlowEstimate,
    windows: Mapping[str, int],
) -> None:
    """Write the end of the result, and the files of the estimate."""
    if (writer := run.writer) is not None:
        for setup, of, own in zip(run.setups, run.of, findings, strict=True):
            with writer.of(setup.name):
                writer.consistency(run.last_ns, own)
                if (flown := of.forecasts.as_flown) is not None:
                    writer.record(AS_FLOWN, flown.to_record())
        writer.summary(run.last_ns, outcome)
        withdrawn = run.of[0].publishing.withdrawn
        stated = {"withdrawn": str(withdrawn)} if withdrawn else {}
        stated |= {"vehicles": json.dumps(windows)} if windows else {}
        if stated:
            writer.write_metadata(WINDOWS_RECORD, stated)
        writer.finish(flow)
    if inputs.job.netcdf is not None:
        write_grid(flow, inputs.job.netcdf)
    if inputs.job.save_estimate is not None:
        flown = run.of[0].forecasts.as_flown
        vehicle = {} if flown is None else {AS_FLOWN: json.dumps(flown.to_record())}
        replace(flow, about={**flow.about, **vehicle}).save(inputs.job.save_estimate)


def _last_flows(run: Run, about: Mapping[str, str]) -> tuple[list[FlowEstimate], dict[str, int]]:
    """Finish surfacings, plan for each vehicle, publish the last slices and the other windows.

    Returns:
        Last estimate of each vehicle, with its citation, shared within a window; and the window numbers of vehicles in other windows than
        the first.
    """
    held, flows = dict[Hashable, FlowEstimate](), list[FlowEstimate]()
    begun = [of.first_ns for of in run.of if of.first_ns is not None]
    span_ns = (min(begun, default=run.last_ns), run.last_ns)
    for number, setup in enumerate(run.setups):
        planned_on, window = end(run, number), setup.estimator.window(run.current)
        if window not in held:
            own = (
                flow_at(setup.estimator, run.current, run.last_ns) if run.is_pooled else planned_on
            )
            dated = replace(run.dated(own), about=about)
            held[window] = replace(dated, span_ns=span_ns) if run.is_pooled else dated
        flows.append(held[window])
    _, *others = held.values()
    numbers = dict(zip(map(id, others), left_windows(run, iter(others)), strict=True))
    for one in (*others, flows[0]):
        publish(run, one, run.last_ns)
    each = zip(run.setups, flows, strict=True)
    return flows, {setup.name: numbers[id(own)] for setup, own in each if id(own) in numbers}


def value_of_each(
    run: Run, flows: Sequence[FlowEstimate]
) -> dict[str, Mapping[str, float | int | None]]:
    """Return the change of the final estimate without each vehicle's observations (data denial)."""
    found: dict[str, Mapping[str, float | int | None]] = {}
    if len(run.setups) * len(run.kept) > _MOST_DENIED:
        return found
    with run.clock.stage("value"):
        # vehicles of different windows
        windows = {id(flow): number for number, flow in enumerate(flows)}.values()
        pooled = _on_slices([flows[number] for number in windows], run.config.output)
        for number, setup in enumerate(run.setups):
            state = run.without(number)
            of_windows = [flow_at(run.setups[k].estimator, state, run.last_ns) for k in windows]
            without = _on_slices(of_windows, run.config.output)
            error, error_without = (_rms(one[1]) for one in (pooled, without))
            own = [event for of, event in run.kept if of == number]
            found[setup.name] = {
                "measurements": sum(len(e) if isinstance(e, Profiles) else 1 for e in own),
                "rms_change": _rms(np.hypot(*np.moveaxis(without[0] - pooled[0], -1, 0))),
                "standard_error": error,
                "standard_error_without": error_without,
            }
    return found


def _on_slices(flows: Sequence[FlowEstimate], settings: OutputConfig) -> tuple[Array, Array]:
    """Return the velocity at the published depths, shape (n, 2), and the magnitude of its standard error, shape (n,) [m/s]."""
    depths = published_depths(flows[0], settings)
    each = [one for flow in flows for one in depth_slices(flow, depths)]
    velocity, known = (
        np.hstack([one.fields[part].reshape(-1, one.fields[0].size) for one in each])
        for part in (slice(2), slice(2, None))
    )
    errors = np.hypot(*known) if known.size else np.full(velocity.shape[1], np.nan)
    return velocity.T, errors


def _rms(values: Array) -> float | None:
    """Return the RMS of the finite values; None without any."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def so_far(run: Run, inputs: Prepared) -> Outcome:
    """Return the outcome so far, of all vehicles together."""
    return made(_counted(run, inputs))


def _counted(run: Run, inputs: Prepared) -> dict[str, Any]:
    accounts = inputs.accounts(run)
    if not inputs.job.vehicles:
        return accounts[0].part()
    return together({one.name: own for one, own in zip(run.setups, accounts, strict=True)})


def useless_of(run: Run, inputs: Prepared) -> dict[str, str]:
    """Return the reason that a vehicle contributed nothing to the estimate, by name.

    Raises:
        MeasurementError: No vehicle contributed anything.
    """
    useless, last = dict[str, str](), None
    for setup, of, account in zip(run.setups, run.of, inputs.accounts(run), strict=True):
        try:
            names = [*[""] * account.first_input, *(one.path for one in account.reports)]
            require_one_vehicle(of.monitoring, names)
            if not of.monitoring.explains_no_profile:
                account.require_usable(inputs.forecasts.ensemble.grid)
            account.require_left_out(setup.config.measurements.without)
        except MeasurementError as error:
            if not inputs.job.vehicles or error.findings:
                found = error.findings or of.monitoring.findings
                said = dict.fromkeys((str(error), *map(str, of.monitoring.findings)))
                raise MeasurementError(". ".join(said), found) from error
            useless[setup.name], last = str(error), error
    if last is not None and len(useless) == len(run.setups):
        raise last
    return useless


def _found(run: Run, number: int, inputs: Prepared, flow: FlowEstimate) -> dict[str, Any]:
    """Return the values of an outcome for one vehicle."""
    setup, of, account = run.setups[number], run.of[number], inputs.accounts(run)[number]
    of_file = check_file(setup.estimator, of.monitoring.means)
    findings, blind = conclusions(of.monitoring, of.counts, setup.config, of_file)
    told, planning = setup.config.planner.depth, of.planning
    depth = told if isinstance(told, float) else None
    following = next_surfacing(of.forecasts, flow, depth)
    plan = None if planning.result is None else planning.result.plan
    return account.part() | {
        "plan": plan_part(plan, planning.failure),
        "surfacings": surfacings_part(planning.outcomes),
        "predicted_surfacings": expected_part(of.forecasts.outcomes, following, planning.outcomes),
        "notes": account.notes() + of.publishing.surface.notes,
        "consistency": [*map(finding_json, findings)],
        "doubts": blind,
        "outside": [note for note in inputs.forecasts.notes if _OUTSIDE.search(note)],
        "flight_correction": correction_part(of.flight.correction(of.counts.corrections)),
    }


def _of_several(
    run: Run,
    inputs: Prepared,
    flows: Sequence[FlowEstimate],
    each: Sequence[Mapping[str, Any]],
    useless: dict[str, str],
    windowed: bool,
) -> dict[str, Any]:
    """Return the values of an outcome for several vehicles together."""
    names, named = [one.name for one in run.setups], inputs.job.vehicles
    value = value_of_each(run, flows)
    unused = {one.name: one.why_not for one in named if one.why_not} | useless
    notes = [*_notes(run, inputs, flows[0], ()), *map(": ".join, unused.items())]
    if not value:
        notes.append(_NOT_DENIED)
    if windowed:
        notes.append(
            f"estimate.npz, --netcdf, --save-estimate and a score against a truth are of the window of {names[0]}; "
            "the result holds all"
        )
    notes += [f"{one.name}: {text}" for one in named for text in one.notes]
    return _counted(run, inputs) | {
        "vehicles": {name: made(one) for name, one in zip(names, each, strict=True)},
        "value": value,
        "unused": unused,
        "notes": notes,
        "consistency": [
            found | {"name": f"{name}: {found['name']}"}
            for name, one in zip(names, each, strict=True)
            for found in one["consistency"]
        ],
        "outside": each[0]["outside"],
    }


def _notes(run: Run, inputs: Prepared, flow: FlowEstimate, of_logs: Sequence[str]) -> list[str]:
    """Return notes on the forecast, the logs, the basis, the prior and the instrument, as sentences."""
    kernel, estimator = flow.horizontal.kernel, run.setups[0].estimator
    lengths = f"{kernel.length_east / 1e3:.1f} x {kernel.length_north / 1e3:.1f} km"
    basis = f"{flow.n_modes} modes a level, kernel lengths {lengths}, mu {kernel.speed:.3f} m/s"
    no_goal = (
        []
        if inputs.job.goals
        else ["no goal was given (--goal LON,LAT,DEPTH), so nothing was planned"]
    )
    # biases are one instrument's
    biases = estimator.remarks(run.current)
    return [*inputs.forecasts.notes, *of_logs, basis, *estimator.notes(), *biases, *no_goal]


def _score(
    run: Run, inputs: Prepared, truth: Ensemble, flow: FlowEstimate
) -> tuple[dict[str, float | None] | None, list[str]]:
    """Return the score as far as available, and the reasons for missing parts."""
    job, forecasts, prior_flow, config = (
        inputs.job,
        inputs.forecasts,
        inputs.prior_flow,
        run.config,
    )
    if forecasts.evolves:
        # the estimate is of the log's end, and so is what it is compared with
        truth = open_truth(job, config, flow.time_ns, forecasts.ensemble, forecasts.box) or truth
        prior_flow = prior_flow.moved(run.last_ns)
    if forecasts.read is not None:
        forecasts, box = forecasts.in_last_window(flow.grid)
        truth = open_truth(job, config, forecasts.near_ns, forecasts.ensemble, box) or truth
    positions = [place for of in run.of for place in of.counts.positions]
    ensemble = forecasts.nearest(flow.time_ns)
    try:
        score, truth_flow = score_against_truth(
            flow, ensemble, truth, positions, job.truth_radius_km, config.estimator
        )
    except MeasurementError as error:
        return None, [f"no score: {error}"]
    if job.vehicles:
        # each vehicle has a plan of its own
        return score, []
    problem, result = run.problem(0), run.of[0].planning.result
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
    names = ("closest_approach_m", "ensemble_mean_closest_approach_m")
    return score | dict(zip(names, closest, strict=True)), []
