"""End of a replay: outcome, estimate, and score against a truth."""

import json
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import AS_FLOWN
from replay_kit.core.errors import Caveat, MeasurementError, finding_json
from replay_kit.core.flow.dataset import write_grid
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, rotate_to_geographic, rotate_to_local, to_local
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.observation.evidence import Evidence
from replay_kit.core.region import bounds_of
from replay_kit.estimator import embed_member
from replay_kit.forecast.members.rules import WARNING
from replay_kit.results.mcap.topics import WINDOWS_RECORD
from replay_kit.results.outcome.outcome import Outcome, checked_outcome
from replay_kit.results.outcome.parts import (
    comparison_part,
    correction_part,
    expected_part,
    plan_part,
    surfacings_part,
)
from replay_kit.workflows.replay.account import pooled_part
from replay_kit.workflows.replay.consistency import check_file, conclusions, require_one_vehicle
from replay_kit.workflows.replay.inputs.forecast import flow_at
from replay_kit.workflows.replay.inputs.job import name_of, open_truth
from replay_kit.workflows.replay.inputs.prepare import Prepared
from replay_kit.workflows.replay.publishing import depth_slices
from replay_kit.workflows.replay.run import Run, finish_vehicle, left_windows
from replay_kit.workflows.replay.surfacings import next_surfacing
from replay_kit.workflows.replay.vehicle import VehicleRun


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
    flows, windows = _last_flows(run)
    flow, estimator = flows[0], run.vehicles[0].setup.estimator
    each = zip(run.vehicles, flows, strict=True)
    found = {one[0].setup.name: found_of(*one, inputs, others) for one in each}
    values = next(iter(found.values()))
    if job.vehicles:
        values = _pooled_values(run, inputs, found, useless, bool(windows))
    kernel = flow.horizontal.kernel
    lengths = f"{kernel.length_east / 1e3:.1f} x {kernel.length_north / 1e3:.1f} km"
    basis = f"{flow.n_modes} modes a level, kernel lengths {lengths}, mu {kernel.speed:.3f} m/s"
    remarks = estimator.remarks(run.current)
    no_goal = "no goal was given (--goal LON,LAT,DEPTH), so nothing was planned"
    # biases are one instrument's
    notes = [basis, *estimator.notes(), *remarks, *[no_goal] * (not job.goals)]
    notes = [*notes, *values["notes"]] if job.vehicles else [*values["notes"], *notes]
    notes = [*inputs.forecasts.notes, *notes]
    values = {**values, "notes": notes, "outside": [*values["outside"], *_caveats(remarks)]}
    outcome = checked_outcome(values, (*job.logs, *job.forecasts))
    with run.clock.stage("write"):
        _write(run, inputs, outcome, found, flow, windows)
    score, said = None, list[str]()
    if job.truth is not None:
        with run.clock.stage("score"):
            score, said = _score(run, inputs, flow)
    truth, seconds = checked_outcome({"truth": score}).truth, dict(run.clock.seconds)
    told = (*outcome.notes, *said)
    return replace(outcome, seconds=seconds, truth=truth, notes=told), flow


def _write(
    run: Run,
    inputs: Prepared,
    outcome: Outcome,
    found: Mapping[str, Mapping[str, Any]],
    flow: FlowEstimate,
    windows: Mapping[str, int],
) -> None:
    """Write the end of the result, and the files of the estimate."""
    if (writer := run.writer) is not None:
        for each in run.vehicles:
            with writer.for_vehicle(each.setup.name):
                writer.consistency(run.last_ns, found[each.setup.name]["consistency"])
                if (flown := each.forecasts.as_flown) is not None:
                    writer.record(AS_FLOWN, flown.to_record())
        writer.summary(run.last_ns, outcome)
        stated = {"withdrawn": str(run.withdrawn)} if run.withdrawn else {}
        stated |= {"vehicles": json.dumps(windows)} if windows else {}
        if stated:
            writer.write_metadata(WINDOWS_RECORD, stated)
        writer.finish(flow)
    if inputs.job.netcdf is not None:
        write_grid(flow, inputs.job.netcdf)
    if inputs.job.save_estimate is not None:
        flown = run.vehicles[0].forecasts.as_flown
        vehicle = {} if flown is None else {AS_FLOWN: json.dumps(flown.to_record())}
        replace(flow, about={**flow.about, **vehicle}).save(inputs.job.save_estimate)


def _last_flows(run: Run) -> tuple[list[FlowEstimate], dict[str, int]]:
    """Finish surfacings, plan for each vehicle, publish the last slices and the other windows.

    Returns:
        Last estimate of each vehicle, shared within a window; and the window numbers of vehicles in other windows than
        the first.
    """
    held, flows = dict[Hashable, FlowEstimate](), list[FlowEstimate]()
    begun = [vehicle.first_ns for vehicle in run.vehicles if vehicle.first_ns is not None]
    span_ns = (min(begun, default=run.last_ns), run.last_ns)
    for vehicle in run.vehicles:
        planned_on, estimator = finish_vehicle(run, vehicle), vehicle.setup.estimator
        window = estimator.window(run.current)
        if window not in held:
            flow = flow_at(estimator, run.current, run.last_ns) if run.is_pooled else planned_on
            dated = replace(run.dated(flow), about=dict(run.config.output.metadata))
            held[window] = replace(dated, span_ns=span_ns) if run.is_pooled else dated
        flows.append(held[window])
    _, *others = held.values()
    numbers = dict(zip(map(id, others), left_windows(run, others), strict=True))
    last = (depth_slices(run.last_ns, one, run.config.output) for one in (*others, flows[0]))
    run.write(run.vehicles[0], last)
    each = zip(run.vehicles, flows, strict=True)
    return flows, {
        vehicle.setup.name: numbers[id(flow)] for vehicle, flow in each if id(flow) in numbers
    }


def so_far(run: Run, inputs: Prepared) -> Outcome:
    """Return the outcome so far, of all vehicles together."""
    return checked_outcome(_counted(run, inputs))


def _counted(run: Run, inputs: Prepared) -> dict[str, Any]:
    each = {vehicle.setup.name: vehicle.account for vehicle in run.vehicles}
    return pooled_part(each) if inputs.job.vehicles else each[""].part()


def useless_of(run: Run, inputs: Prepared) -> dict[str, str]:
    """Return the reason that a vehicle contributed nothing to the estimate, by name.

    Raises:
        MeasurementError: No vehicle contributed anything.
    """
    useless, last = dict[str, str](), None
    names = [log.path for log in inputs.logs.all]
    for vehicle in run.vehicles:
        account = vehicle.account
        try:
            require_one_vehicle(vehicle.monitoring, names)
            if not vehicle.monitoring.explains_no_profile:
                account.require_usable(inputs.forecasts.ensemble.grid, inputs.logs)
            account.require_left_out(vehicle.setup.config.measurements.without)
        except MeasurementError as error:
            if not inputs.job.vehicles or error.findings:
                found = error.findings or vehicle.monitoring.findings
                said = dict.fromkeys((str(error), *map(str, vehicle.monitoring.findings)))
                raise MeasurementError(". ".join(said), found) from error
            useless[vehicle.setup.name], last = str(error), error
    if last is not None and len(useless) == len(run.vehicles):
        raise last
    return useless


def _caveats(notes: Iterable[str]) -> list[str]:
    """Return the notes that are reasons of the verdict."""
    return [note.removeprefix(WARNING) for note in notes if isinstance(note, Caveat)]


def found_of(
    vehicle: VehicleRun,
    flow: FlowEstimate,
    inputs: Prepared,
    others: Sequence[tuple[str, Evidence]] = (),
) -> dict[str, Any]:
    """Return the values of an outcome for one vehicle."""
    setup, account = vehicle.setup, vehicle.account
    of_file = check_file(setup.estimator, vehicle.monitoring.means)
    findings, blind = conclusions(vehicle.monitoring, vehicle.counts, setup.config, of_file)
    told, planning = setup.config.planner.depth, vehicle.planning
    depth = told if isinstance(told, float) else None
    following = next_surfacing(vehicle.forecasts, flow, depth)
    plan = None if planning.result is None else planning.result.plan
    evidence, ensemble = vehicle.counts.log_evidence, name_of(inputs.job.ensemble)
    compared = comparison_part(ensemble, evidence, others) if evidence and others else None
    return account.part() | {
        "comparison": compared,
        "plan": plan_part(plan, planning.failure),
        "surfacings": surfacings_part(planning.outcomes),
        "predicted_surfacings": expected_part(
            vehicle.forecasts.outcomes, following, planning.outcomes
        ),
        "notes": account.notes() + vehicle.publishing.surface.notes + vehicle.notes,
        "consistency": [*map(finding_json, findings)],
        "doubts": blind,
        "outside": _caveats(inputs.forecasts.notes),
        "flight_correction": correction_part(vehicle.flight.correction(vehicle.counts.corrections)),
    }


def _pooled_values(
    run: Run,
    inputs: Prepared,
    each: Mapping[str, Mapping[str, Any]],
    useless: Mapping[str, str],
    windowed: bool,
) -> dict[str, Any]:
    """Return the values of an outcome for several vehicles together, with the last of its notes."""
    unused = {one.name: one.why_not for one in inputs.job.vehicles if one.why_not} | {**useless}
    notes = [*map(": ".join, unused.items())]
    if windowed:
        notes.append(
            f"estimate.npz, --netcdf, --save-estimate and a score against a truth are of the window of {run.vehicles[0].setup.name}; "
            "the result holds all"
        )
    return _counted(run, inputs) | {
        "vehicles": {name: checked_outcome(one) for name, one in each.items()},
        "unused": unused,
        "notes": notes,
        "consistency": [
            found | {"name": f"{name}: {found['name']}"}
            for name, one in each.items()
            for found in one["consistency"]
        ],
        "outside": next(one["outside"] for one in each.values()),
    }


def _score(
    run: Run, inputs: Prepared, flow: FlowEstimate
) -> tuple[dict[str, float] | None, list[str]]:
    """Return the score, None with the reason where none of the truth can be scored."""
    job, forecasts, config = inputs.job, inputs.forecasts, run.config
    box, near_ns = forecasts.box, forecasts.near_ns
    if forecasts.read is not None:
        # the window that the estimate is of
        box = bounds_of(flow.grid)
        forecasts = replace(forecasts, series=(forecasts.read(box),))
    elif flow.process is not None:
        # the estimate is of the log's end, and so is what it is compared with
        near_ns = flow.time_ns
    truth = open_truth(job, config, near_ns, forecasts.ensemble, box)
    assert truth is not None
    ensemble = forecasts.nearest(flow.time_ns)
    try:
        return score_against_truth(flow, ensemble, truth, config.estimator), []
    except MeasurementError as error:
        return None, [f"no score: {error}"]


@dataclass(frozen=True, slots=True, eq=False)
class ScoredPoints:
    """Wet grid points of the truth inside a region and its levels.

    Attributes:
        points: shape (P, 2) [m], local east and north of the region's frame.
        depth: shape (P,) [m].
        velocity: shape (P, 2) [m/s], truth along the region's axes.
        index: Level, row and column in the truth's grid, each shape (P,).
    """

    points: Array
    depth: Array
    velocity: Array
    index: tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]

    @property
    def place(self) -> tuple[Array, Array, Array]:
        """East, north and depth [m], the arguments of a flow."""
        return self.points[:, 0], self.points[:, 1], self.depth


def score_against_truth(
    flow: FlowEstimate, ensemble: Ensemble, truth: Ensemble, config: EstimatorConfig
) -> dict[str, float]:
    """Return the scores of an outcome.

    The truth is compared at its own grid points that lie inside the ensemble's region and levels: RMSE is the root mean square
    length of the error vector, unweighted, and the relative error is over the truth's RMS speed there.

    Args:
        flow: Estimate.
        ensemble: Ensemble, whose mean is scored too.
        truth: An ensemble of one.
        config: Settings of the embedding of the ensemble's mean.

    Raises:
        MeasurementError: No grid point of the truth can be scored.
    """
    at = scored_points(flow.grid, truth)
    mean = _ensemble_mean_at(ensemble, truth, config, at)
    rmse, speed = rms_length(flow.velocity(*at.place) - at.velocity), rms_length(at.velocity)
    return {
        "rmse": rmse,
        "rel_error": rmse / speed,
        "ensemble_mean_rmse": rms_length(mean - at.velocity),
        "points": int(at.depth.size),
    }


def scored_points(grid: Grid, truth: Ensemble) -> ScoredPoints:
    """Return the points at which a truth is compared with an estimate, and the truth along the grid's axes.

    Args:
        grid: Grid of the estimate.
        truth: An ensemble of one; its frame may have another centre, and its vectors are turned.

    Raises:
        MeasurementError: No wet point of the truth can be scored.
    """
    east, north = to_local(grid.projection, truth.grid.longitude, truth.grid.latitude)
    levels = truth.grid.levels
    deep = (levels >= grid.levels[0] - 1e-6) & (levels <= grid.levels[-1] + 1e-6)
    scored = truth.grid.wet & deep[:, None, None] & inside_grid(grid, east, north)
    z, j, i = np.nonzero(scored)
    if z.size == 0:
        raise MeasurementError(
            f"{truth.source}: no wet point of the truth lies in the ensemble's region and levels; is it of another place?"
        )
    u, v = truth.velocity[0][:, z, j, i]
    at = truth.grid.longitude[j, i], truth.grid.latitude[j, i]
    turned = rotate_to_local(
        grid.projection, *at, *rotate_to_geographic(truth.grid.projection, *at, u, v)
    )
    return ScoredPoints(
        np.column_stack([east[j, i], north[j, i]]), levels[z], np.column_stack(turned), (z, j, i)
    )


def rms_length(vectors: Array) -> float:
    """Return the root mean square length of vectors, shape (P, 2)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=-1))))


def _ensemble_mean_at(
    ensemble: Ensemble, truth: Ensemble, config: EstimatorConfig, at: ScoredPoints
) -> Array:
    """Return the ensemble mean at scored points: directly if the grids agree, else through its embedding."""
    grid, other, velocity = ensemble.grid, truth.grid, ensemble.velocity
    if grid.wet.shape == other.wet.shape and all(
        np.allclose(getattr(grid, name), getattr(other, name))
        for name in ("levels", "longitude", "latitude")
    ):
        return np.asarray(velocity.mean(axis=0)[:, *at.index].T)
    mean = replace(ensemble, velocity=velocity.mean(axis=0, keepdims=True))
    return embed_member(mean, 0, config).velocity(*at.place)
