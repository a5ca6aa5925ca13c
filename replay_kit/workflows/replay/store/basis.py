"""Built estimators kept in a folder that several replays share: the basis of an ensemble is made once and read by all.

A file is named after the SHA-256 of all that an estimator is built from. Its arrays are mapped into memory, which processes of one machine
share. It is written under another name and renamed, so that two replays that make the same basis do not disturb each other.
"""

import hashlib
import io
import json
import os
import pickle
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from replay_kit.config.run import RunConfig
from replay_kit.core.atomic import part_of
from replay_kit.core.sealed import Kind, read_store, unusable, write_store
from replay_kit.estimator import Estimator
from replay_kit.forecast import ensemble_files
from replay_kit.workflows.replay.inputs.estimator import build
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.provenance import file_hash, package_versions
from replay_kit.workflows.replay.store.pickling import dump, load

_KIND = Kind("basis", 2, "delete the file, and run again")
# Sections of the settings that an estimator is built from.
_SECTIONS = {"forecast", "estimator", "time", "gating"}


def built(forecasts: Forecasts, config: RunConfig, job: ReplayJob) -> Estimator[Any]:
    """Return the estimator of a run: from the job's store of them, where it has one, and made for it where it is not there yet.

    Args:
        forecasts: What it is built from.
        config: The run's settings.
        job: With the goal, and the folder of the store.

    Raises:
        LogError: A file of the store is damaged, or of another version.
        ReplayKitError: As of ``build``; or the store cannot be written.
    """
    if job.estimator is not None:
        return job.estimator(forecasts, config)
    goal_depth = None if job.goal is None else job.goal.depth
    if job.basis_store is None:
        return build(forecasts, config, goal_depth)
    path = job.basis_store / f"{_identity(forecasts, config, job)}.basis"
    if not path.exists():
        with _locked(path.with_suffix(".lock")):
            if not path.exists():
                _write(path, build(forecasts, config, goal_depth))
    # read also by who made it: all replays have the same value
    return _read(path)


def _identity(forecasts: Forecasts, config: RunConfig, job: ReplayJob) -> str:
    """Return the SHA-256 of what an estimator is built from: files, settings, the part of the forecast that is used, versions."""
    settings = config.model_dump(mode="json", include=_SECTIONS)
    files = [file_hash(path) for path in ensemble_files(job.ensemble)]
    depth = (
        job.goal.depth
        if job.goal is not None and config.estimator.name == "depth_average"
        else None
    )
    text = json.dumps(
        [settings, files, depth, config.output.threads, forecasts.evolves, package_versions()],
        sort_keys=True,
    )
    digest = hashlib.sha256(text.encode())
    dump(
        [(forecast.grid, forecast.time_ns, forecast.members) for forecast in forecasts.series],
        part := io.BytesIO(),
    )
    digest.update(part.getvalue())
    return digest.hexdigest()


def _write(path: Path, estimator: Estimator[Any]) -> None:
    arrays: list[pickle.PickleBuffer] = []
    body = io.BytesIO()
    dump(estimator, body, on_array=arrays.append)
    unique = path.with_name(f"{path.stem}-{uuid.uuid4().hex}.new")
    try:
        write_store(unique, _KIND, {}, [body.getvalue(), *(array.raw() for array in arrays)])
        os.replace(unique, path)
    finally:
        for left in (unique, part_of(unique)):
            left.unlink(missing_ok=True)


def _read(path: Path) -> Estimator[Any]:
    """Return the estimator of a file; its arrays are mapped and cannot be written to."""
    _, (body, *arrays) = read_store(path, _KIND)
    try:
        estimator: Estimator[Any] = load(io.BytesIO(body), arrays=arrays)
    # pickle states no end to what it raises on bytes that are not its own
    except Exception as error:
        raise unusable(path, _KIND, error) from error
    return estimator


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Let one process at a time through; the lock of one that is killed is free again.

    Where the file system has no locks, a basis may be made more than once, to the same bytes.
    """
    import fcntl

    with path.open("wb") as file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
