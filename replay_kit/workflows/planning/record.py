"""The result of ``plan``: written with what it was made of, and what was asked for read back from it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from replay_kit.config.plan import PlanRequest
from replay_kit.config.removed import SETTINGS, refuse_value
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import LogError
from replay_kit.core.plan import Plan
from replay_kit.results.mcap_writer import ResultWriter
from replay_kit.results.outcome.outcome import made
from replay_kit.results.outcome.parts import plan_part
from replay_kit.workflows.planning.adapters import over_bottom
from replay_kit.workflows.planning.bathymetry import seabed_of
from replay_kit.workflows.planning.inputs import PlannedOn
from replay_kit.workflows.replay.inputs.provenance import (
    BATHYMETRY,
    PLAN_RECORD,
    named_hash,
    package_versions,
    run_settings_toml,
)

# Files of a request, which the record of the inputs states by name and content.
_FILES = "no_go", BATHYMETRY


def plan_metadata(request: PlanRequest) -> dict[str, Mapping[str, str]]:
    """Return the metadata records of a plan made on its own: its inputs' names and hashes, what was asked for, the versions."""
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


def write_plan(
    path: Path,
    overwrite: bool,
    plan: Plan,
    on: PlannedOn,
    records: Mapping[str, Mapping[str, str]],
    config: RunConfig,
) -> None:
    """Write a plan as a result MCAP of its own.

    Args:
        path: The result.
        overwrite: Replace an existing one.
        plan: The plan, without what it was made on.
        on: What it was made on.
        records: Its legs, and what else it has.
        config: All settings, attached as ``config.toml``; what was asked for is recorded, its files with their hashes.

    Raises:
        ConfigError: The result exists and may not be replaced, or cannot be written.
        ReplayKitError: It could not be written whole.
    """
    projection, begin = on.region.projection, plan.start_time_ns
    about = {
        "status": plan.status,
        "message": plan.message,
        "start_time_ns": str(begin),
        "longitude": str(plan.start.longitude),
        "latitude": str(plan.start.latitude),
    }
    areas = tuple(area.area for area in on.no_go)
    metadata = {**plan_metadata(config.plan), "mission": about, **records}
    with ResultWriter(path, overwrite) as writer:
        writer.start(projection, begin, metadata, run_settings_toml(config))
        if on.bathymetry is not None:
            writer.seabed(begin, seabed_of(on.bathymetry, on.region))
        writer.plan(over_bottom(replace(plan, areas=areas), on.bathymetry, projection), projection)
        writer.digest(begin)
        writer.summary(begin, made({"plan": plan_part(plan), "complete": False}))


def recorded_request(record: Mapping[str, str], found: Mapping[str, Path]) -> PlanRequest:
    """Return what was asked for.

    Args:
        record: Of a plan's result.
        found: Its inputs, by the keys of their record.

    Raises:
        LogError: The record is damaged, or of an earlier version.
        ConfigError: This version has no such plans.
    """
    # all of them: a record of somebody else names no file to read
    files = {
        "flows": [found[name] for name in _numbered(found, "flow")],
        **{name: found.get(name) for name in _FILES},
    }
    try:
        asked = TypeAdapter(dict[str, Any]).validate_json(record.get("request") or record["job"])
        asked = asked if "request" in record else _renamed(asked)
        refuse_value("--objective", str(asked.get("objective")))
        # what made no difference to the plan that the result holds
        kept = {name: value for name, value in asked.items() if name not in SETTINGS["plan"]}
        return PlanRequest.model_validate({**kept, **files})
    except (KeyError, TypeError, ValueError) as error:
        raise LogError(
            f"{PLAN_RECORD}: expected what a plan was asked for, got {dict(record)}; plan again"
        ) from error


def _renamed(job: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was asked for as results before the table ``[plan]`` hold it, in today's names and forms."""

    def place(one: Mapping[str, float]) -> str:
        return ",".join(repr(one[name]) for name in ("longitude", "latitude", "depth"))

    def time(time_ns: int) -> str:
        return f"{np.datetime64(time_ns, 'ns')}Z"

    def listed(values: Sequence[float] | None) -> str | None:
        return ",".join(map(repr, values)) if values else None

    asked = {**job, **job.get("kind", {})}
    times = asked.pop("departures_ns", ())
    step_ns = times[1] - times[0] if len(times) > 1 else 10**9
    horizon, begin_ns = asked.get("horizon"), asked.pop("start_time_ns", None)
    asked |= {
        "start": place(asked["start"]),
        "goal": [place(one) for one in asked.pop("goals", ())],
        "mooring": listed(asked.get("mooring")),
        "start_time": None if begin_ns is None else time(begin_ns),
        "depart": f"{time(times[0])},{time(times[-1])},{step_ns / 1e9!r}s" if times else None,
        "horizon": None if horizon is None else f"{horizon!r}s",
    }
    # error is that of a profile, of plans that are no more
    left_out = "kind", "error"
    return {
        name: value for name, value in asked.items() if name not in left_out and value is not None
    }


def _numbered(found: Mapping[str, Path], key: str) -> list[str]:
    """Return the names of a list of inputs, ``flow0``, ``flow1`` and so on, in order."""
    return sorted(
        (name for name in found if name.removeprefix(key).isdecimal()),
        key=lambda name: int(name.removeprefix(key)),
    )
