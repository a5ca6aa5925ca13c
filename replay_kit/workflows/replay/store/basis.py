"""Built estimators kept in a folder that several replays share: the basis of an ensemble is made once and read by all.

A file is named after the SHA-256 of all that an estimator is built from. Its arrays are mapped into memory, which processes of one machine
share. It is written under another name and renamed, so that two replays that make the same basis do not disturb each other.
"""

import hashlib
import io
import json
import mmap
import os
import pickle
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from replay_kit.config.run import RunConfig
from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import LogError
from replay_kit.estimator import Estimator
from replay_kit.forecast import ensemble_files
from replay_kit.workflows.replay.inputs.estimator import build
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.provenance import file_hash, package_versions
from replay_kit.workflows.replay.store.pickling import dump, load

_MAGIC = b"replay-kit basis 1\n"
# Bytes of the length of the index, and of the boundary at which arrays begin, as numpy's own routines like it.
_LENGTH, _BOUNDARY = 8, 64
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
    parts = [memoryview(body.getvalue()), *(array.raw() for array in arrays)]
    index = json.dumps([part.nbytes for part in parts]).encode()
    unique = path.with_name(f"{path.stem}-{uuid.uuid4().hex}.new")
    try:
        with atomic_file(unique) as file:
            file.write(_MAGIC + len(index).to_bytes(_LENGTH, "little") + index)
            for part in parts:
                _pad(file)
                file.write(part)
        os.replace(unique, path)
    finally:
        for left in (unique, unique.with_name(unique.name + ".part")):
            left.unlink(missing_ok=True)


def _pad(file: BinaryIO) -> None:
    file.write(bytes(-file.tell() % _BOUNDARY))


def _read(path: Path) -> Estimator[Any]:
    """Return the estimator of a file; its arrays are mapped and cannot be written to."""
    with path.open("rb") as file:
        data = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    start = len(_MAGIC) + _LENGTH
    try:
        if bytes(data[: len(_MAGIC)]) != _MAGIC:
            raise ValueError("it is of another version")
        end = start + int.from_bytes(data[len(_MAGIC) : start], "little")
        body, *arrays = _parts(data, json.loads(bytes(data[start:end])), end)
        estimator: Estimator[Any] = load(io.BytesIO(body), arrays=arrays)
    # pickle states no end to what it raises on bytes that are not its own
    except Exception as error:
        words = " ".join(str(error).split())[:200]
        raise LogError(
            f"{path}: the basis kept there cannot be used: {type(error).__name__}: {words}; delete the file"
        ) from error
    return estimator


def _parts(data: memoryview, sizes: Sequence[int], end: int) -> Iterator[memoryview]:
    """Yield the parts of a file behind its index."""
    for size in sizes:
        start = end + -end % _BOUNDARY
        end = start + size
        if end > data.nbytes:
            raise ValueError(f"it has {data.nbytes} bytes, and its index says at least {end}")
        yield data[start:end]


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
