"""What the result of ``plan`` says of how it was made, and what was asked for read back from it."""

from collections.abc import Mapping
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from replay_kit.core.errors import LogError
from replay_kit.workflows.planning.learning_request import LearnJob
from replay_kit.workflows.planning.request import PlanJob
from replay_kit.workflows.replay.inputs.provenance import (
    BATHYMETRY,
    PLAN_RECORD,
    named_hash,
    package_versions,
)

_JOBS: dict[str, type[PlanJob] | type[LearnJob]] = {"mission": PlanJob, "learning": LearnJob}
# Fields of jobs that name files, which the record of the inputs states by name and content.
_FILES, _LISTS = ("no_go", BATHYMETRY), {"flows": "flow", "others": "others"}


def plan_metadata(
    job: PlanJob | LearnJob, options: Mapping[str, object]
) -> dict[str, Mapping[str, str]]:
    """Return the metadata records of a plan made on its own: its inputs' names and hashes, what was asked for, the versions.

    Args:
        job: What was asked for.
        options: It as the user gave it, for readers; None for what was not given.
    """
    read = {
        f"{key}{k}": path
        for field, key in _LISTS.items()
        for k, path in enumerate(getattr(job, field, ()))
    }
    read |= {field: getattr(job, field) for field in _FILES if getattr(job, field) is not None}
    (kind,) = [name for name, made in _JOBS.items() if isinstance(job, made)]
    asked = TypeAdapter(type(job)).dump_json(job, exclude={*_FILES, *_LISTS}).decode()
    return {
        "replay_kit.inputs": {name: named_hash(path) for name, path in read.items()},
        "replay_kit.options": {
            name: str(value) for name, value in options.items() if value is not None
        },
        PLAN_RECORD: {"kind": kind, "job": asked},
        "replay_kit.versions": package_versions(),
    }


def recorded_job(record: Mapping[str, str], found: Mapping[str, Path]) -> PlanJob | LearnJob:
    """Return what was asked for.

    Args:
        record: Of a plan's result.
        found: Its inputs, by the keys of their record.

    Raises:
        LogError: The record is damaged.
    """
    lists = {
        field: [found[name] for name in _numbered(found, key)] for field, key in _LISTS.items()
    }
    # all of them: a record of somebody else names no file to read
    files = {**lists, **{name: found.get(name) for name in _FILES}}
    try:
        adapter: TypeAdapter[PlanJob | LearnJob] = TypeAdapter(_JOBS[record["kind"]])
        asked = TypeAdapter(dict[str, object]).validate_json(record["job"])
        return adapter.validate_python({**asked, **files})
    except (KeyError, ValidationError) as error:
        raise LogError(
            f"{PLAN_RECORD}: expected the kind of a plan and what was asked for, got {dict(record)}; plan again"
        ) from error


def _numbered(found: Mapping[str, Path], key: str) -> list[str]:
    """Return the names of a list of inputs, ``flow0``, ``flow1`` and so on, in order."""
    return sorted(
        (name for name in found if name.removeprefix(key).isdecimal()),
        key=lambda name: int(name.removeprefix(key)),
    )
