"""Calls for workers, and whether these have the same versions, the same files, and a folder that all write to."""

import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from replay_kit.core.errors import ConfigError
from replay_kit.core.progress import called_by
from replay_kit.workflows.fleet.cluster import Cluster, open_cluster
from replay_kit.workflows.replay.inputs.provenance import package_versions


def check_workers(cluster: Cluster, files: Iterable[Path], out: Path | None = None) -> None:
    """Raise ConfigError unless every worker has these versions of the packages, sees the files, and shares the folder.

    Args:
        cluster: Its workers.
        files: What they will read, as absolute paths.
        out: Where they will write: a folder that exists; None for none.
    """
    sizes = {str(path): _size(path) for path in files}
    token = None if out is None else out / f".shared-{uuid.uuid4().hex}"
    try:
        if token is not None:
            token.touch()
        answers = cluster.on_each(_state, sizes, None if token is None else str(token))
    finally:
        if token is not None:
            token.unlink(missing_ok=True)
    for worker, answer in answers.items():
        if isinstance(answer, BaseException):
            raise ConfigError(
                f"{worker}: the worker cannot run replay-kit: {answer!r}; install the same version there"
            )
        versions, missing, shared = answer
        if others := _differences(package_versions(), versions):
            raise ConfigError(
                f"{worker}: the worker has other versions, which change the bytes of results: {others}; install these"
            )
        if missing:
            raise ConfigError(
                f"{worker}: the worker sees another file as {missing[0]}, or none; put the data where all see it"
            )
        if not shared:
            raise ConfigError(
                f"{worker}: the worker cannot write to {out}; choose a folder on a disk that all workers share"
            )


@contextmanager
def calls_made_by(scheduler: str | None, workers: int | None) -> Iterator[Cluster | None]:
    """Let workers make the calls of ``core.progress.each_call`` in the block; those of this process where neither is given.

    Args:
        scheduler: As in ``cluster.open_cluster``.
        workers: As in ``cluster.open_cluster``.
    """
    if scheduler is None and workers is None:
        yield None
        return
    with open_cluster(scheduler, workers) as cluster:
        check_workers(cluster, ())
        with called_by(cluster.starmap):
            yield cluster


def _state(sizes: Mapping[str, int], token: str | None) -> tuple[dict[str, str], list[str], bool]:
    """Return a worker's versions, which files it does not see as they are, and whether it can write beside a file that it sees."""
    missing = [
        name for name, size in sizes.items() if not Path(name).exists() or _size(Path(name)) != size
    ]
    return package_versions(), missing, token is None or _is_writable(Path(token))


def _is_writable(token: Path) -> bool:
    mine = token.with_name(f"{token.name}-{uuid.uuid4().hex}")
    try:
        found = token.exists()
        mine.touch()
        mine.unlink()
    except OSError:
        return False
    return found


def _size(path: Path) -> int:
    """Return the size of a file [bytes]; -1 of a folder."""
    return path.stat().st_size if path.is_file() else -1


def _differences(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    return ", ".join(
        f"{name} {there.get(name, 'missing')} (here {version})"
        for name, version in here.items()
        if there.get(name) != version
    )
