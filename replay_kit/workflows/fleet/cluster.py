"""The processes that make independent calls: of this machine, or of a cluster by its address; Dask's distributed behind one class.

A call whose worker dies is made again, by another worker or by the one that takes its place; so are all calls that are not finished when
the scheduler is lost and comes back. A call that outlives no worker ends with an error.
"""

import logging
import os
import signal
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from multiprocessing import resource_tracker
from typing import Any

from threadpoolctl import threadpool_limits

from replay_kit.core.errors import ConfigError, EstimatorError, ReplayKitError

#: How long a scheduler, and its first worker, are waited for [s].
TIMEOUT_S = 20.0
# How often a call is given to the scheduler, which itself gives it to up to four workers one after the other.
_ATTEMPTS = 2
# What is larger is sent once, however many calls have it [bytes]; below that, looking for it costs more than sending it.
_KEPT = 1 << 14


class UnreachableError(ReplayKitError):
    """A scheduler that does not answer, or has no worker."""


class LostCallError(EstimatorError):
    """A call whose workers died each time."""


class Cluster:
    """A scheduler and its workers."""

    def __init__(self, address: str) -> None:
        """Connect to a scheduler.

        Args:
            address: Of the scheduler, such as ``tcp://10.0.0.1:8786``.

        Raises:
            UnreachableError: It does not answer, or has no worker.
        """
        self.address = address
        self._client = _connected(address)

    @property
    def dashboard(self) -> str:
        """Address of the scheduler's page in a browser; empty where bokeh, which draws it, is not installed."""
        return str(self._client.dashboard_link) if find_spec("bokeh") else ""

    @property
    def size(self) -> int:
        """Number of calls that are made at the same time."""
        return sum(self._client.nthreads().values())

    def on_each(self, function: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Return the value of a function on each worker, by its address; an exception where it raised one; nothing of one that is gone."""
        from distributed.comm.core import CommClosedError

        answers = self._client.run(function, *arguments, on_error="return")
        return {
            name: value for name, value in answers.items() if not isinstance(value, CommClosedError)
        }

    def starmap(
        self, function: Callable[..., Any], rows: Iterable[tuple[Any, ...]]
    ) -> Iterator[Any]:
        """Yield the values of calls in their order, as ``itertools.starmap``.

        Raises:
            Exception: What the call raised.
        """
        done: dict[int, Any] = {}
        following = 0
        for number, value, error in self.completed(function, rows):
            done[number] = value, error
            while following in done:
                value, error = done.pop(following)
                following += 1
                if error is not None:
                    raise error
                yield value

    def completed(
        self, function: Callable[..., Any], calls: Iterable[tuple[Any, ...]]
    ) -> Iterator[tuple[int, Any, Exception | None]]:
        """Yield the position of each call, its value, and the error that it ended with, as soon as it is made.

        Raises:
            UnreachableError: The scheduler was lost and did not come back in time.
        """
        from distributed import KilledWorker, as_completed

        left, deaths = dict(enumerate(calls)), Counter[int]()
        while left:
            held: dict[int, Any] = {}
            futures = {
                self._submit(function, arguments, held): number
                for number, arguments in left.items()
            }
            for future in as_completed(list(futures), loop=self._client.loop):
                number = futures.pop(future)
                value, error = _outcome(future)
                future.release()
                deaths[number] += isinstance(error, KilledWorker)
                if isinstance(error, KilledWorker) and deaths[number] == _ATTEMPTS:
                    error = LostCallError("the worker died each time; was there enough memory?")
                if not isinstance(error, CancelledError | KilledWorker):
                    del left[number]
                    yield number, value, error
            if left and self._client.status != "running":
                self._client = _connected(self.address)

    def close(self) -> None:
        """Disconnect."""
        self._client.close(timeout=5)

    def _submit(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], held: dict[int, Any]
    ) -> Any:
        """Return the future of a call; large arguments are values that the scheduler has, so that a worker's death does not lose them."""
        given = []
        for argument in arguments:
            if not _is_large(argument):
                given.append(argument)
                continue
            if id(argument) not in held:
                held[id(argument)] = self._client.submit(_same, argument, pure=False), argument
            given.append(held[id(argument)][0])
        return self._client.submit(_alone, function, *given, pure=False)


@contextmanager
def open_cluster(scheduler: str | None, workers: int | None) -> Iterator[Cluster]:
    """Yield the workers of a cluster, or processes of this machine, which end with the block.

    Args:
        scheduler: Address; None for processes of this machine.
        workers: Number of these processes; None for one for each core.

    Raises:
        ConfigError: distributed is not installed, or both are given.
        UnreachableError: The scheduler does not answer in time, or has no worker.
    """
    if scheduler is not None and workers is not None:
        raise ConfigError(f"--scheduler {scheduler} has workers of its own; leave --workers out")
    try:
        import dask
        import distributed  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            "many processes need Dask's distributed; pip install 'replay-kit[fleet]'"
        ) from error
    # what the library says of workers that come and go is said here in words of our own
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with dask.config.set(
        {
            "distributed.comm.timeouts.connect": TIMEOUT_S,
            "distributed.admin.large-graph-warning-threshold": "1GB",
            # it holds frames, and with them objects of HDF5, which now and then changes where a file has what: other bytes
            "distributed.worker.profile.enabled": False,
        }
    ):
        if scheduler is None:
            with _local(workers or _cores()) as address:
                yield from _used(Cluster(address))
        else:
            yield from _used(Cluster(scheduler))


def _used(cluster: Cluster) -> Iterator[Cluster]:
    try:
        yield cluster
    finally:
        cluster.close()


@contextmanager
def _local(workers: int) -> Iterator[str]:
    """Yield the address of a scheduler of this process with so many worker processes; one that is killed is begun anew."""
    from distributed.utils import LoopRunner

    runner = LoopRunner()
    # of the thread that begins the workers: one that an interrupt ends is not begun anew, and its missions would be waited for
    with _uninterrupted():
        runner.start()
    try:
        cluster = _processes(workers, runner.loop)
        try:
            yield cluster.scheduler_address
        finally:
            cluster.close(timeout=10)
    finally:
        runner.stop()


def _processes(workers: int, loop: Any) -> Any:
    """Return a scheduler with worker processes; where one of these is killed before it works, all are begun anew."""
    from distributed import LocalCluster

    for _ in range(_ATTEMPTS):
        with suppress(RuntimeError):
            return LocalCluster(
                loop=loop,
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                # the memory of one mission is not known to the library, which would stop a worker that takes its share
                memory_limit=0,
                dashboard_address=":0",
                silence_logs=logging.CRITICAL,
            )
    raise UnreachableError("worker processes end while they begin; is there enough memory?")


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let no interrupt reach threads begun in the block, and their processes, where signals have masks."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # what begins it anew lets interrupts in again
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _cores() -> int:
    """Return the number of cores that this process may use; of the machine where the system does not say."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _connected(address: str) -> Any:
    from distributed import Client

    try:
        client = Client(address, timeout=TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UnreachableError(
            f"{address}: the scheduler does not answer in {TIMEOUT_S:g} s; is it running, the address right?"
        ) from error
    try:
        client.wait_for_workers(1, timeout=TIMEOUT_S)
    except TimeoutError as error:
        client.close()
        raise UnreachableError(
            f"{address}: the scheduler has no worker in {TIMEOUT_S:g} s; begin: dask worker {address}"
        ) from error
    return client


def _outcome(future: Any) -> tuple[Any, Exception | None]:
    """Return the value of a call that has ended, and the error that it ended with."""
    try:
        return future.result(), None
    except Exception as error:
        return None, error


def _is_large(argument: Any) -> bool:
    import dask.sizeof

    return (
        not isinstance(argument, str | int | float | None) and dask.sizeof.sizeof(argument) > _KEPT
    )


def _alone(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return the value of a function with one BLAS thread; xarray, which looks for a cluster that it runs on, writes as anywhere."""
    import dask

    with threadpool_limits(limits=1), dask.config.set(scheduler="synchronous"):
        return function(*arguments)


def _same(value: Any) -> Any:
    return value
