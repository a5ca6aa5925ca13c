"""One mission of a fleet, in whatever process: a pure function of its inputs that writes to its own place; and all of them."""

import hashlib
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from replay_kit.core.atomic import write_whole
from replay_kit.core.errors import ReplayKitError
from replay_kit.core.progress import Progress, silent
from replay_kit.core.version import __version__
from replay_kit.workflows.fleet.cluster import Cluster
from replay_kit.workflows.fleet.missions import Mission
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.provenance import (
    file_hash,
    package_versions,
    run_settings_toml,
)
from replay_kit.workflows.replay.replay import replay

# Folder of results that are not complete, each in a folder of its own: of two workers that were given the same mission, as after the loss
# of a scheduler, neither disturbs the other.
_UNFINISHED = "unfinished"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a mission ended.

    Attributes:
        name: Of the mission.
        answer: The JSON object of its replay; empty where it failed.
        sha256: Of the result's bytes; empty where it failed.
        kept: Whether the result was there already.
        failed: Why there is no result; empty when there is one.
        exit_code: That of the replay.
    """

    name: str
    answer: Mapping[str, Any] = field(default_factory=dict)
    sha256: str = ""
    kept: bool = False
    failed: str = ""
    exit_code: int = 0


def run_fleet(
    missions: Sequence[Mission], cluster: Cluster, overwrite: bool, progress: Progress = silent
) -> Iterator[tuple[Outcome, ...]]:
    """Yield the outcomes so far, in the order of the missions, after each mission; a mission that fails does not stop the others.

    Args:
        missions: All; those whose results are there, made of the same inputs by the same versions, are not run again.
        cluster: Its workers.
        overwrite: Whether results that are there are made anew nevertheless.
        progress: Called with missions done, missions in all, and what was done last.

    Raises:
        UnreachableError: The scheduler was lost; what is done is kept.
    """
    out = missions[0].result.parent
    out.mkdir(parents=True, exist_ok=True)
    if overwrite:
        for mission in missions:
            mission.record.unlink(missing_ok=True)
    done: dict[int, Outcome] = {}
    progress(0, len(missions), "missions")
    try:
        for number, outcome, error in cluster.completed(
            run_mission, [(mission,) for mission in missions]
        ):
            name = missions[number].name
            done[number] = outcome if error is None else failure(name, error)
            progress(
                len(done),
                len(missions),
                f"missions: {name} {'failed' if done[number].failed else 'done'}",
            )
            yield tuple(done[k] for k in sorted(done))
    finally:
        shutil.rmtree(out / _UNFINISHED, ignore_errors=True)


def run_mission(mission: Mission) -> Outcome:
    """Return how a mission ended, with its result and its record on the disk; what is there and complete is not made again."""
    place = mission.result.parent / _UNFINISHED / f"{mission.name}-{uuid.uuid4().hex}"
    try:
        identity = _identity(mission)
        if (kept := _kept(mission, identity)) is not None:
            return kept
        place.mkdir(parents=True)
        return _run(mission, place / mission.result.name, identity)
    # what it is that fails in one of a thousand missions must not cost the others
    except Exception as error:
        return failure(mission.name, error)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _run(mission: Mission, made: Path, identity: str) -> Outcome:
    began = time.perf_counter()
    outcome, _ = replay(replace(mission.job, out=made), mission.config, planner_of)
    digest = file_hash(made)
    os.replace(made, mission.result)
    answer = outcome.to_json() | {"seconds_in_all": time.perf_counter() - began}
    record = {
        "result": mission.result.name,
        "sha256": digest,
        "inputs_sha256": identity,
        "replay_kit": __version__,
        **answer,
    }
    record["record_sha256"] = _digest(record)
    write_whole(made.with_suffix(".json"), json.dumps(record, indent=1, allow_nan=False) + "\n")
    # after the result: a record says that the result is complete
    os.replace(made.with_suffix(".json"), mission.record)
    return Outcome(mission.name, answer, digest, exit_code=outcome.exit_code)


def _identity(mission: Mission) -> str:
    """Return the SHA-256 of all that a result depends on: inputs, goal, settings, versions."""
    job = mission.job
    files = [(path.name, file_hash(path)) for path in mission.files]
    text = [
        files,
        [(one.name, len(one.logs)) for one in job.vehicles],
        str(job.goal),
        str(job.truth).rpartition("/")[2],
        run_settings_toml(mission.config),
        package_versions(),
    ]
    return _digest(text)


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _kept(mission: Mission, identity: str) -> Outcome | None:
    """Return the outcome of a result that is there, made of the same inputs and as it was written; None without one."""
    try:
        record = json.loads(mission.record.read_bytes())
        same = (
            record.pop("record_sha256") == _digest(record)
            and record["inputs_sha256"] == identity
            and record["sha256"] == file_hash(mission.result)
        )
        return (
            Outcome(mission.name, record, record["sha256"], True, exit_code=record["exit_code"])
            if same
            else None
        )
    except (OSError, ValueError, LookupError, TypeError):
        # no record, or none of this program: the mission is run
        return None


def failure(name: str, error: Exception) -> Outcome:
    """Return the outcome of a mission that ended with an error."""
    own = isinstance(error, ReplayKitError)
    words = str(error) if own else f"{type(error).__name__}: {error}"
    return Outcome(
        name, failed=words, exit_code=error.exit_code if isinstance(error, ReplayKitError) else 1
    )
