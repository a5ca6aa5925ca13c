"""Workers for independent calls: processes of this machine or of a Dask cluster, behind one interface.

A call whose worker dies is repeated; one whose worker dies each time ends with an error.
"""

import logging
import os
import signal
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import (
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from threading import Event, Thread, local
from typing import Any

from threadpoolctl import threadpool_limits

from replay_kit.core.errors import ConfigError, EstimatorError, ReplayKitError
from replay_kit.core.words.progress import called_by
from replay_kit.workflows.replay.inputs.provenance import package_versions

#: How long a scheduler, and its first worker, are waited for [s].
TIMEOUT_S = 20.0


class UnreachableError(ReplayKitError):
    """Error: a scheduler does not answer, or has no worker."""


class LostCallError(EstimatorError):
    """Error: the worker of a call died each time."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Processes that execute calls.

    Attributes:
        name: Description for messages.
        size: Number of simultaneous calls.
        submit: Gives a call to a worker.
        killed: Errors of a call whose worker died each time.
    """

    name: str
    size: int
    submit: Callable[..., Future[Any]]
    killed: tuple[type[Exception], ...]

    def starmap(
        self, function: Callable[..., Any], rows: Iterable[tuple[Any, ...]]
    ) -> Iterator[Any]:
        """Yield the results of calls in order, as ``itertools.starmap`` does.

        Raises:
            Exception: The error of the call.
        """
        calls = deque[Future[Any]]()
        try:
            for row in rows:
                # arguments and results may be large: few are held at once
                calls.append(self.submit(function, *row))
                if len(calls) == 2 * self.size:
                    yield self._result(calls.popleft())
            while calls:
                yield self._result(calls.popleft())
        finally:
            for future in calls:
                future.cancel()

    def completed(
        self, function: Callable[..., Any], rows: Iterable[tuple[Any, ...]]
    ) -> Iterator[tuple[int, Any, Exception | None]]:
        """Yield the number, result and error of each call as soon as it ends.

        Raises:
            UnreachableError: The scheduler was lost.
        """
        # what has not begun when the caller leaves is given up with the workers
        calls = {self.submit(function, *row): number for number, row in enumerate(rows)}
        for future in as_completed(calls):
            try:
                yield calls[future], self._result(future), None
            except UnreachableError:
                raise
            except Exception as error:
                yield calls[future], None, error

    def _result(self, future: Future[Any]) -> Any:
        """Return the result of a call, or raise its error."""
        try:
            return future.result()
        except CancelledError as error:
            raise UnreachableError(
                f"{self.name}: the scheduler was lost; finished results are kept: restart it, and continue with --resume"
            ) from error
        except self.killed as error:
            raise LostCallError("the worker died each time; was there enough memory?") from error


@contextmanager
def _processes(count: int) -> Iterator[Callable[..., Future[Any]]]:
    """Yield a function that submits calls to processes of this machine, which end with the block or with this process.

    A thread waits for each process, so that the death of one concerns its own call alone.
    """
    of_thread, ended, before = local(), Event(), set(active_children())

    def called(function: Callable[..., Any], *arguments: Any, repeat: bool = True) -> Any:
        """Return the result of a call by the process of this thread; one that dies is replaced, and its call repeated once."""
        if not hasattr(of_thread, "process"):
            of_thread.process = ProcessPoolExecutor(1, get_context("spawn"), _begin)
        try:
            return of_thread.process.submit(_alone, function, *arguments).result()
        except BrokenProcessPool:
            del of_thread.process
            if ended.is_set() or not repeat:
                raise
            return called(function, *arguments, repeat=False)

    threads: Any = ThreadPoolExecutor(count)
    try:
        yield partial(threads.submit, called)
    finally:
        ended.set()
        threads.shutdown(wait=False, cancel_futures=True)
        for process in set(active_children()) - before:
            process.terminate()
        threads.shutdown()


def _begin() -> None:
    """Initialise a worker: it ends with its parent and ignores interrupts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
    os._exit(1)


def _cores() -> int:
    """Return the number of cores available to this process, or of the machine if unknown."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def open_workers(
    scheduler: str | None, workers: int | None, files: Iterable[Path] = (), out: Path | None = None
) -> Iterator[Workers]:
    """Yield the workers of a cluster, or processes of this machine.

    Args:
        scheduler: Address, such as ``tcp://10.0.0.1:8786``; None for processes of this machine.
        workers: Number of these processes; None for one for each core.
        files: Absolute paths that workers of a cluster will read.
        out: Existing folder that they will write to; None for none.

    Raises:
        ConfigError: distributed is not installed, both are given, or a worker of the cluster cannot do the work.
        UnreachableError: The scheduler does not answer in time, or has no worker.
    """
    if scheduler is None:
        count = workers or _cores()
        with _processes(count) as submit:
            yield Workers("this machine", count, submit, (BrokenProcessPool,))
        return
    if workers is not None:
        raise ConfigError(f"--scheduler {scheduler} has its own workers; omit --workers")
    try:
        import dask
        import distributed
    except ImportError as error:
        raise ConfigError(
            "--scheduler: a cluster needs Dask's distributed; pip install 'replay-kit[fleet]'"
        ) from error
    # what the library says of workers that come and go is said here in words of our own
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    settings = {
        "distributed.comm.timeouts.connect": TIMEOUT_S,
        "distributed.admin.large-graph-warning-threshold": "1GB",
    }
    with dask.config.set(settings), _connected(scheduler) as client:
        _check(client, files, out)
        size = sum(client.nthreads().values())
        pool = client.get_executor(pure=False)
        try:
            submit = partial(pool.submit, _synchronous)
            yield Workers(scheduler, size, submit, (distributed.KilledWorker,))
        finally:
            pool.shutdown(wait=False)


@contextmanager
def calls_made_by(scheduler: str | None, workers: int | None) -> Iterator[None]:
    """Execute the calls of ``core.progress.each_call`` in the block on workers; in this process if neither argument is given.

    Args:
        scheduler: See ``open_workers``.
        workers: See ``open_workers``.
    """
    if scheduler is None and workers is None:
        yield
        return
    with open_workers(scheduler, workers) as opened, called_by(opened.starmap):
        yield


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Yield a client of a scheduler with at least one worker."""
    from distributed import Client

    try:
        client = Client(address, timeout=TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UnreachableError(
            f"{address}: the scheduler does not answer in {TIMEOUT_S:g} s; check that it runs, and its address"
        ) from error
    try:
        client.wait_for_workers(1, timeout=TIMEOUT_S)
        yield client
    except TimeoutError as error:
        raise UnreachableError(
            f"{address}: the scheduler has no worker in {TIMEOUT_S:g} s; start one: dask worker {address}"
        ) from error
    finally:
        client.close(timeout=5)


def _check(client: Any, files: Iterable[Path], out: Path | None) -> None:
    """Raise ConfigError unless every worker has the same package versions, sees the files and shares the folder."""
    sizes = {str(path): _size(path) for path in files}
    token = None if out is None else out / f".shared-{uuid.uuid4().hex}"
    try:
        if token is not None:
            token.touch()
        answers = client.run(_lacking, package_versions(), sizes, token, on_error="return")
    finally:
        if token is not None:
            token.unlink(missing_ok=True)
    for worker, why in answers.items():
        if isinstance(why, BaseException):
            why = f"cannot run replay-kit: {why!r}; install the same version there"
        if why:
            raise ConfigError(f"{worker}: the worker {why}")


def _lacking(
    versions: Mapping[str, str], sizes: Mapping[str, int | None], token: Path | None
) -> str:
    """Return why the present worker cannot do the work; empty if it can."""
    here = package_versions()
    others = ", ".join(
        f"{name} {here.get(name, 'missing')} (here {version})"
        for name, version in versions.items()
        if here.get(name) != version
    )
    if others:
        return f"has other versions, which change the bytes of results: {others}; install these"
    found = {name: _size(Path(name)) for name in sizes}
    if missing := [name for name, size in found.items() if size is None or size != sizes[name]]:
        return f"sees another file as {missing[0]}, or none; put the data where all see it"
    if token is not None and not _is_shared(token):
        return f"cannot write to {token.parent}; choose a folder on a disk that all workers share"
    return ""


def _is_shared(token: Path) -> bool:
    """Return whether a file of the client is seen here and its folder can be written."""
    probe = token.with_name(f"{token.name}-{uuid.uuid4().hex}")
    try:
        # permissions do not show what a mounted disk allows
        probe.touch()
        probe.unlink()
    except OSError:
        return False
    return token.exists()


def _size(path: Path) -> int | None:
    """Return the size of a file [bytes], 0 for a folder; None if neither exists."""
    if not path.exists():
        return None
    return path.stat().st_size if path.is_file() else 0


def _alone(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of a function run with one BLAS thread."""
    with threadpool_limits(limits=1):
        return function(*arguments)


def _synchronous(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of a function run on a cluster, with xarray's search for a scheduler disabled."""
    import dask

    with dask.config.set(scheduler="synchronous"):
        return _alone(function, *arguments)
