"""``plan --objective learn`` and ``map``: what is asked for, checked against the estimate, and the plan that answers it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from planners.learning.maps import plan_map
from planners.learning.survey import plan_survey
from planners.learning.values import Box, LearnPlan, LearnRequest, LearnSettings, OtherProfiles
from planners.mission.flight.currents import local_notes
from planners.mission.values import MissionSettings
from replay_kit.config.plan import PlanRequest
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place
from replay_kit.core.progress import announce
from replay_kit.core.text import time_text
from replay_kit.results.views.record import read_planned_legs
from replay_kit.workflows.planning.adapters import MissionPlanner, with_origin
from replay_kit.workflows.planning.currents import KnownCurrent
from replay_kit.workflows.planning.inputs import PlannedOn, planned_on

# Hours of a survey where none are stated, and samples.
_SURVEY_H, _SAMPLES = 24.0, 200


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """A plan that learns, and what it was planned on.

    Attributes:
        plan: The plan.
        on: What it is made on.
    """

    plan: LearnPlan
    on: PlannedOn


def make_learning(job: PlanRequest, config: PlannerConfig) -> Learnt:
    """Return the plan of a job.

    Args:
        job: What is asked for, checked.
        config: ``[planner]`` with the command's options laid over it.

    Raises:
        PlanError: It cannot be planned, or the stretch outlasts the forecast.
        ForecastError: The bathymetry is unusable.
        LogError: A plan of others is unusable.
    """
    on = planned_on(job, config)
    known, seconds = on.known, _seconds(job)
    request, origin, notes = learn_request(job, config, on, job.start_place)
    begin_ns = request.start_time_ns
    _check_horizon(known, begin_ns, seconds, job)
    announce("comparing surveys")
    plan = _planned(job, known.first, request)
    if seconds is None and known.ends_ns is not None:
        notes += known.notes(begin_ns, begin_ns + round(plan.duration * 1e9))
    notes += _too_sure(known, plan.duration) + local_notes(known.local, begin_ns, left_out=True)
    return Learnt(with_origin(replace(plan, notes=(*plan.notes, *notes)), origin), on)


def learn_request(
    job: PlanRequest, config: PlannerConfig, on: PlannedOn, start: Place
) -> tuple[LearnRequest, str, tuple[str, ...]]:
    """Return what is asked of the planner for a vehicle at a place, what its dives are taken from, and what should be known.

    Raises:
        PlanError: It begins outside of the forecast.
        LogError: A plan of others is unusable.
    """
    bound, origin = replace(MissionPlanner.of(config), flown=on.flown).bound(
        on.known.first, job.then_places
    )
    begin_ns, notes = on.known.begin(job.start_time_ns)
    request = LearnRequest(
        start,
        job.then_places,
        bound.vehicle,
        _settings(job, config, bound.settings),
        on.no_go,
        on.bathymetry,
        begin_ns,
        profiles_of_others(job.others),
        job.profiles or 0,
    )
    return request, origin, (*notes, *on.notes)


def box_of(numbers: tuple[float, ...]) -> Box:
    """Return the box of a request's numbers: west, south, east, north, and depths."""
    west, south, east, north, *depths = numbers
    return Box(west, south, east, north, tuple(depths))


def _planned(job: PlanRequest, flow: FlowEstimate, request: LearnRequest) -> LearnPlan:
    if (numbers := job.box_numbers) is not None:
        return plan_map(flow, request, box_of(numbers))
    assert job.blind is not None
    return plan_survey(flow, request, 3600.0 * (job.survey or _SURVEY_H), 3600.0 * job.blind)


def _settings(job: PlanRequest, config: PlannerConfig, dives: MissionSettings) -> LearnSettings:
    """Return how profiles are brought, with the depth and the surface time of a mission's dives."""
    return LearnSettings(
        depth=dives.depth,
        dives=config.dives,
        surface_time=dives.surface_time,
        error=job.profile_error,
        margin=config.margin,
        clearance=config.clearance,
        tolerance=config.tolerance,
        arrive=job.arrive,
        samples=_SAMPLES if config.samples is None else config.samples,
        seed=config.seed,
    )


def _seconds(job: PlanRequest) -> float | None:
    """Return how long survey and stretch last [s]; None where that follows from the plan."""
    return None if job.blind is None else 3600.0 * ((job.survey or _SURVEY_H) + job.blind)


def _check_horizon(
    known: KnownCurrent, begin_ns: int, seconds: float | None, job: PlanRequest
) -> None:
    """Raise PlanError where survey and stretch outlast the forecast."""
    last = known.ends_ns
    if last is None or seconds is None or begin_ns + seconds * 1e9 <= last:
        return
    left = (last - begin_ns) / 3.6e12
    raise PlanError(
        f"--blind {job.blind:g}: expected survey and stretch to end within the forecast, {left:.1f} h from the start at "
        f"{time_text(begin_ns)} to {time_text(last)}, got {seconds / 3600.0:g} h; choose shorter ones, or the estimate of a longer forecast"
    )


def _too_sure(known: KnownCurrent, duration: float) -> tuple[str, ...]:
    """Return the warning that an estimate which does not change is too sure of a plan that takes long; none elsewhere."""
    hours = duration / 3600.0
    if known.process is not None:
        return ()
    lasts = (
        f"for some {known.hours_known:.0f} h"
        if np.isfinite(known.hours_known)
        else "for a time that is not known"
    )
    return (
        f"the estimate does not change with time and holds {lasts}, the plan takes {hours:.0f} h: where the sea changes all errors stated "
        "here are too small, two days later by several times; use the estimate of a replay through a forecast of several times",
    )


def profiles_of_others(paths: tuple[Path, ...]) -> OtherProfiles | None:
    """Return the profiles that the plans in some results bring, one between two surfacings; those of stretches without fixes bring none.

    Raises:
        LogError: A file is no result with a plan of legs.
    """
    found = list[tuple[float, float, int]]()
    for path in paths:
        found += _middles(*read_planned_legs(path))
    if not found:
        return None
    longitude, latitude, time_ns = zip(*found, strict=True)
    return OtherProfiles(np.array(longitude), np.array(latitude), np.array(time_ns, dtype=np.int64))


def _middles(legs: Mapping[str, str], begun: Mapping[str, str]) -> list[tuple[float, float, int]]:
    """Return longitude, latitude and time [ns, UTC] of the middle of each leg that ends with a fix."""
    start_ns, found = int(begun["start_time_ns"]), list[tuple[float, float, int]]()
    before = float(begun["longitude"]), float(begun["latitude"]), 0.0
    for text in (legs[key] for key in sorted(legs, key=int)):
        row = json.loads(text)
        after = float(row["longitude"]), float(row["latitude"]), float(row["surfacing_s"])
        if not row.get("blind", False):
            middle = [0.5 * (one + other) for one, other in zip(before, after, strict=True)]
            found.append((middle[0], middle[1], start_ns + round(middle[2] * 1e9)))
        before = after
    return found
