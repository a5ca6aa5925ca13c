"""Result of ``plan``: written with its inputs, and reproduced from its recorded request."""

import json
from collections.abc import Mapping
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from threadpoolctl import threadpool_limits

from planners.output import as_plan, legs_table
from replay_kit.config.plan import PlanRequest
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import LogError, PlanError
from replay_kit.results.differences import Recorded
from replay_kit.results.mcap.writer import ResultWriter
from replay_kit.results.outcome.outcome import checked_outcome
from replay_kit.results.outcome.parts import plan_part
from replay_kit.workflows.planning.adapters import over_bottom
from replay_kit.workflows.planning.bathymetry import seabed_of
from replay_kit.workflows.planning.outputs import departures_table
from replay_kit.workflows.planning.request import checked_request, planned_on
from replay_kit.workflows.planning.run import PlannedMission, make_plans, mission_settings
from replay_kit.workflows.replay.inputs.provenance import (
    BATHYMETRY,
    PLAN_RECORD,
    named_hash,
    package_versions,
    run_settings_toml,
)

# Files of a request, which the record of the inputs states by name and content.
_FILES = "no_go", BATHYMETRY


def write_mission(path: Path, overwrite: bool, planned: PlannedMission, config: RunConfig) -> None:
    """Write a mission as a result MCAP of its own.

    Args:
        path: The result.
        overwrite: Replace an existing one.
        planned: The mission.
        config: All settings; those of the mission are attached as ``config.toml``. The request is recorded, with hashes of its files.

    Raises:
        ConfigError: The result exists and may not be replaced, or cannot be written.
        ReplayKitError: It could not be written completely.
    """
    on, battery, legs = planned.on, config.plan.battery, legs_table(planned.plan, planned.odds)
    projection = on.region.projection
    plan = over_bottom(
        replace(
            as_plan(planned.plan, projection, planned.odds),
            battery=nan if battery is None else battery * 1e6,
            areas=tuple(area.area for area in on.no_go),
        ),
        on.bathymetry,
        projection,
    )
    begin = plan.start_time_ns
    metadata = {
        **_metadata(config.plan),
        "mission": {
            "status": plan.status,
            "message": plan.message,
            "start_time_ns": str(begin),
            "longitude": str(plan.start.longitude),
            "latitude": str(plan.start.latitude),
        },
        "legs": {str(row["leg"]): json.dumps(row) for row in legs},
    }
    settings = mission_settings(config.plan, config.planner)
    used = {"kind": "mission", "samples": planned.drawn, "max_duration": settings["max_duration"]}
    # weights have no place in a configuration
    if isinstance(settings["objective"], str):
        used["objective"] = settings["objective"]
    config = config.model_copy(update={"planner": config.planner.model_copy(update=used)})
    if rows := departures_table(planned):
        metadata["departures"] = {row["departure"]: json.dumps(row) for row in rows}
    with ResultWriter(path, overwrite) as writer:
        writer.start(projection, begin, metadata, run_settings_toml(config))
        if on.bathymetry is not None:
            writer.seabed(begin, seabed_of(on.bathymetry, on.region))
        writer.plan(plan, projection)
        writer.digest(begin)
        writer.summary(begin, checked_outcome({"plan": plan_part(plan), "complete": False}))


def _metadata(request: PlanRequest) -> dict[str, Mapping[str, str]]:
    """Return the metadata records of a plan: names and hashes of its inputs, request, versions."""
    read = {f"flow{k}": path for k, path in enumerate(request.flows)}
    read |= {name: getattr(request, name) for name in _FILES if getattr(request, name) is not None}
    files = {*_FILES, "flows"}
    given = request.model_dump(exclude={*files, "goal"}, exclude_defaults=True)
    return {
        "replay_kit.inputs": {name: named_hash(path) for name, path in read.items()},
        # for readers, as the user gave it
        "replay_kit.options": {name: str(value) for name, value in given.items()}
        | {"goals": " ".join(request.goal)},
        PLAN_RECORD: {"request": request.model_dump_json(exclude=files, exclude_none=True)},
        "replay_kit.versions": package_versions(),
    }


def recorded_request(record: Mapping[str, str], found: Mapping[str, Path]) -> PlanRequest:
    """Return the request of a recorded plan.

    Args:
        record: Record of a plan's result.
        found: Its inputs, by record key.

    Raises:
        LogError: The record is damaged, or of an earlier version.
        ConfigError: This version does not support such plans.
    """
    try:
        asked = TypeAdapter(dict[str, Any]).validate_json(record["request"])
        # an earlier version's further settings made no difference to the plan that the result holds
        kept = {name: value for name, value in asked.items() if name in PlanRequest.model_fields}
        # files are inputs alone: a record of somebody else names no file to read
        flows = sum(name.removeprefix("flow").isdecimal() for name in found)
        kept |= {name: found.get(name) for name in _FILES}
        kept["flows"] = [found[f"flow{k}"] for k in range(flows)]
        return PlanRequest.model_validate(kept)
    except (KeyError, TypeError, ValueError) as error:
        raise LogError(
            f"{PLAN_RECORD}: expected the request of a plan, got {dict(record)}; plan again"
        ) from error


def plan_again(recorded: Recorded, config: RunConfig, found: Mapping[str, Path], out: Path) -> None:
    """Repeat the plan of a result, and write it as ``plan`` does.

    Args:
        recorded: Record of the result.
        config: Its configuration.
        found: Its inputs, by record key.
        out: The new result.

    Raises:
        ReplayKitError: The record is damaged, or the kind of plan is no longer supported.
    """
    request = checked_request(recorded_request(recorded.metadata[PLAN_RECORD], found))
    with threadpool_limits(limits=config.output.threads):
        each = make_plans(request, config.planner, planned_on(request, config.planner)).planned
    if (name := (request.of_glider or "") if request.glider else "") not in each:
        raise PlanError(
            f"{PLAN_RECORD}: expected the plan of a glider, one of {', '.join(each)}, got {request.of_glider}; plan again"
        )
    write_mission(out, False, each[name], config.model_copy(update={"plan": request}))
