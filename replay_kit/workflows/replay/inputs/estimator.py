"""The estimator of a run, built from its forecast and settings: static, through time, or a baseline; or kept in a folder.

Built estimators may be kept in a folder that several replays share: the basis of an ensemble is made once and read by all. A file is named
after the SHA-256 of all that an estimator is built from. Its arrays are mapped into memory, which processes of one machine share. It is
written under another name and renamed, so that two replays that make the same basis do not disturb each other.
"""

import hashlib
import io
import json
import os
import pickle
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from replay_kit.config.run import RunConfig
from replay_kit.core.atomic import part_of
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.region import Region
from replay_kit.core.sealed import Kind, read_store, unusable, write_store
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator import build as build_reduced
from replay_kit.estimator.baselines import build_named
from replay_kit.estimator.windows.filter import WindowedEstimator
from replay_kit.forecast import ensemble_files
from replay_kit.workflows.replay.inputs.forecast import OWN, Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.provenance import file_hash, package_versions
from replay_kit.workflows.replay.inputs.region import FoundRegion
from replay_kit.workflows.replay.store.pickling import dump, load

_KIND = Kind("basis", 2, "delete the file, and run again")
# Sections of the settings that an estimator is built from.
_SECTIONS = {"forecast", "estimator", "time", "gating"}


def build(forecasts: Forecasts, config: RunConfig, vehicles: int = 1) -> Estimator[Any]:
    """Return the estimator of a run.

    Args:
        forecasts: What it is built from.
        config: The run's settings.
        vehicles: Number of vehicles that windows may follow.

    Raises:
        ConfigError: The estimator's name is unknown.
    """
    if forecasts.region is not None and forecasts.read is not None:
        return with_window(
            _windowed(forecasts, forecasts.region, forecasts.read, config, vehicles),
            config.time.window,
        )
    if forecasts.evolves:
        return with_window(
            build_reduced(forecasts.series, config.estimator, config.gating, config.time),
            config.time.window,
        )
    if config.estimator.name == OWN:
        made = build_reduced([forecasts.ensemble], config.estimator, config.gating)
        return with_window(made, config.time.window)
    return build_named(forecasts.ensemble, config.estimator)


def with_window(estimator: Estimator[Any], window: float | Literal["auto"]) -> Estimator[Any]:
    """Return an estimator that combines profiles within a time [s]; auto leaves it to the estimator, 0 combines none."""
    grouping = estimator.grouping
    if grouping is None or window == "auto":
        return estimator
    # Any: those that have a grouping are dataclasses
    grouped: Any = estimator
    changed: Estimator[Any] = replace(
        grouped, grouping=grouping.by_hand(window) if window > 0.0 else None
    )
    return changed


def _windowed(
    forecasts: Forecasts,
    found: FoundRegion,
    read: Callable[[Region], Ensemble],
    config: RunConfig,
    vehicles: int,
) -> WindowedEstimator:
    """Return the estimator of windows that follow vehicles; as many of the latest are kept, and one more."""

    @lru_cache(maxsize=vehicles + 1)
    def estimator_of(region: Region) -> ReducedBasisEstimator:
        ensemble = forecasts.ensemble if region == found.region else read(region)
        return build_reduced([ensemble], config.estimator, config.gating)

    grouping = estimator_of(found.region).grouping
    return WindowedEstimator(found.region, found.margin, found.bounds, estimator_of, grouping)


def flow_at(estimator: Estimator[Any], state: Any, time_ns: int) -> FlowEstimate:
    """Return the current estimate of a state for a time at or after its last observation [ns, UTC]; a static one is as it was."""
    return estimator.flow(estimator.predict(state, time_ns))


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
    if job.basis_store is None or forecasts.read is not None:
        # windows are begun as vehicles go on
        return build(forecasts, config, len(job.each_vehicle))
    path = job.basis_store / f"{_identity(forecasts, config, job)}.basis"
    if not path.exists():
        with _locked(path.with_suffix(".lock")) as alone:
            # of processes that were killed as they wrote
            for left in path.parent.glob(f"{path.stem}-*.new*") if alone else ():
                left.unlink(missing_ok=True)
            if not path.exists():
                _write(path, build(forecasts, config))
    # read also by who made it: all replays have the same value
    return _read(path)


def _identity(forecasts: Forecasts, config: RunConfig, job: ReplayJob) -> str:
    """Return the SHA-256 of what an estimator is built from: files, settings, the part of the forecast that is used, versions."""
    settings = config.model_dump(mode="json", include=_SECTIONS)
    files = [file_hash(path) for path in ensemble_files(job.ensemble)]
    text = json.dumps(
        [settings, files, config.output.threads, forecasts.evolves, package_versions()],
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
def _locked(path: Path) -> Iterator[bool]:
    """Let one process at a time through, and say whether it is the only one; the lock of one that is killed is free again.

    Where the file system has no locks, a basis may be made more than once, to the same bytes.
    """
    import fcntl

    with path.open("wb") as file:
        alone = False
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
            alone = True
        yield alone
