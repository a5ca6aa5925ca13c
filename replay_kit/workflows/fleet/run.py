"""Fleet runs: one mission in any process, as a pure function of its inputs; and all missions."""

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from replay_kit.core import __version__
from replay_kit.core.errors import ReplayKitError
from replay_kit.core.files.atomic import part_of, write_whole
from replay_kit.core.words.progress import Progress, silent
from replay_kit.workflows.fleet.cluster import Workers
from replay_kit.workflows.fleet.missions import Mission
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.checks import DryRun, dry_run
from replay_kit.workflows.replay.inputs.provenance import (
    input_hash,
    package_versions,
    run_settings_toml,
)
from replay_kit.workflows.replay.replay import replay


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a mission.

    Attributes:
        name: Name of the mission.
        answer: JSON answer of its replay; empty after a failure.
        sha256: SHA-256 of the result; empty after a failure.
        kept: Whether the result existed before.
        failed: Reason of a missing result; empty otherwise.
        exit_code: Exit code of the replay.
    """

    name: str
    answer: Mapping[str, Any] = field(default_factory=dict)
    sha256: str = ""
    kept: bool = False
    failed: str = ""
    exit_code: int = 0


def run_fleet(
    missions: Sequence[Mission], workers: Workers, overwrite: bool, progress: Progress = silent
) -> Iterator[tuple[Outcome, ...]]:
    """Yield the outcomes so far, in the order of the missions, after each mission; a failure does not stop the others.

    Args:
        missions: All missions; those with results of the same inputs and versions are not repeated.
        workers: Processes that run them.
        overwrite: Whether existing results are replaced nevertheless.
        progress: Called with the number of missions done, their total, and the last one.

    Raises:
        UnreachableError: The scheduler was lost; finished results remain.
    """
    for mission in missions if overwrite else ():
        mission.record.unlink(missing_ok=True)
    done: dict[int, Outcome] = {}
    progress(0, len(missions), "missions")
    for number, outcome, error in workers.completed(run_mission, zip(missions)):
        name = missions[number].name
        done[number] = outcome if error is None else failed_mission(name, error)
        ended = "failed" if done[number].failed else "done"
        progress(len(done), len(missions), f"missions: {name} {ended}")
        yield tuple(done[k] for k in sorted(done))


def run_mission(mission: Mission) -> Outcome:
    """Return the outcome of a mission, with its result and record on disk; a complete one is not repeated."""
    try:
        identity = _identity(mission)
        return _kept(mission, identity) or _run(mission, identity)
    # what it is that fails in one of a thousand missions must not cost the others
    except Exception as error:
        part_of(mission.result).unlink(missing_ok=True)
        return failed_mission(mission.name, error)


def _run(mission: Mission, identity: str) -> Outcome:
    began = time.perf_counter()
    mission.record.unlink(missing_ok=True)
    outcome, _ = replay(replace(mission.job, overwrite=True), mission.config, planner_of)
    digest = input_hash(mission.result)
    answer = outcome.to_json() | {"seconds_in_all": time.perf_counter() - began}
    record = {
        "result": mission.result.name,
        "sha256": digest,
        "inputs_sha256": identity,
        "replay_kit": __version__,
        **answer,
    }
    record["record_sha256"] = _digest(record)
    # after the result: a record says that the result is complete
    write_whole(mission.record, json.dumps(record, indent=1, allow_nan=False) + "\n")
    return Outcome(mission.name, answer, digest, exit_code=outcome.exit_code)


def _identity(mission: Mission) -> str:
    """Return the SHA-256 of the inputs, goal, settings and versions that a result depends on."""
    job = mission.job
    return _digest(
        [
            [(path.name, input_hash(path)) for path in mission.files],
            [(one.name, len(one.logs)) for one in job.vehicles],
            str(job.goal),
            str(job.truth).rpartition("/")[2],
            run_settings_toml(mission.config),
            package_versions(),
        ]
    )


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _kept(mission: Mission, identity: str) -> Outcome | None:
    """Return the outcome of an existing intact result of the same inputs; None without one."""
    try:
        record = json.loads(mission.record.read_bytes())
        same = record.pop("record_sha256") == _digest(record)
        same &= record["inputs_sha256"] == identity
        if not same or record["sha256"] != input_hash(mission.result):
            return None
        return Outcome(mission.name, record, record["sha256"], True, exit_code=record["exit_code"])
    except (OSError, ValueError, LookupError, TypeError):
        # no record, or none of this program: the mission is run
        return None


def failed_mission(name: str, error: Exception) -> Outcome:
    """Return the outcome of a mission that failed with an error."""
    if isinstance(error, ReplayKitError):
        return Outcome(name, failed=str(error), exit_code=error.exit_code)
    return Outcome(name, failed=f"{type(error).__name__}: {error}", exit_code=1)


def expected_of(mission: Mission) -> DryRun | Outcome:
    """Return the expected memory and time of a mission, or why it cannot be replayed. Reads the forecast and all logs."""
    try:
        return dry_run(mission.job, mission.config, planner_of)
    except Exception as error:
        return failed_mission(mission.name, error)
