"""How a benchmark measures: wall time, peak memory in a process of its own, and what the machine can do."""

import ctypes
import multiprocessing
import platform
import resource
import sys
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

Row = dict[str, Any]


def row(
    name: str,
    ours_s: float,
    peer: str = "none",
    peer_s: float | None = None,
    asked: float | None = None,
    error: Mapping[str, float] = MappingProxyType({}),
    **more: Any,
) -> Row:
    """Return a row: our time, the peer's, the ratio asked of them, errors, and other figures by name."""
    ratio = None if peer_s is None else peer_s / ours_s
    figures = {"name": name, "ours_s": ours_s, "peer": peer, "peer_s": peer_s, "ratio": ratio}
    return figures | {"asked": asked, "error": dict(error), "peak_mb": None} | more


def cpu(work: Callable[[], Any], repeats: int = 1) -> tuple[float, Any]:
    """Return the least processor time of some repeats, and what the last gave."""
    return seconds(work, repeats, time.process_time)


def of_children() -> float:
    """Return the processor time of the processes that were begun here and have ended [s], a clock for ``seconds``."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def seconds(
    work: Callable[[], Any], repeats: int = 1, clock: Callable[[], float] = time.perf_counter
) -> tuple[float, Any]:
    """Return the least time of some repeats by a clock, and what the last gave."""
    best, value = np.inf, None
    for _ in range(repeats):
        start = clock()
        value = work()
        best = min(best, clock() - start)
    return best, value


def peak_mb(anew: bool = False) -> float:
    """Return the most memory this process has had [MB]; anew, forget what it had before and gave back."""
    if anew and sys.platform == "linux":
        # freed memory that malloc keeps would hide what the work takes
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024.0
    except (OSError, StopIteration):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def runner(tiny: bool) -> Callable[[Callable[[], Row]], Row]:
    """Return what runs the work of a row: a process of its own, or this one where it is tiny."""
    return (lambda work: work()) if tiny else alone


def alone(work: Callable[[], Row]) -> Row:
    """Return what the work gave in a forked process, with ``peak_mb``, what its memory grew by at most, unless the work says itself."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)

    def run() -> None:
        before = peak_mb(anew=True)
        row = work()
        grown = peak_mb() - before
        theirs.send(row if row.get("peak_mb") is not None else row | {"peak_mb": grown})

    process = context.Process(target=run)
    process.start()
    theirs.close()
    try:
        row: Row = ours.recv()
    finally:
        process.join()
    return row


def limits(tiny: bool) -> dict[str, float]:
    """Return the machine's rate of matrix products [Gflop/s] and of reading memory [GB/s], with the BLAS threads in force."""
    n = 100 if tiny else 2000
    square = np.random.default_rng(0).random((n, n))
    gemm = 2.0 * n**3 / seconds(lambda: square @ square, 5)[0] / 1e9
    large = np.ones((n, n)) if tiny else np.ones((6080, 6080))
    vector = np.ones(len(large))
    return {
        "gemm_gflops": gemm,
        "read_gb_s": large.nbytes / seconds(lambda: large @ vector, 5)[0] / 1e9,
    }


def environment() -> dict[str, Any]:
    """Return what the machine and the libraries are."""
    from threadpoolctl import threadpool_info

    names = ("numpy", "scipy", "replay-kit")
    return {
        "machine": {
            "processor": _processor(),
            "system": platform.platform(),
            "blas": [
                {key: info[key] for key in ("internal_api", "version", "num_threads")}
                for info in threadpool_info()
            ],
        },
        "versions": {"python": platform.python_version()} | {name: version(name) for name in names},
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo") as file:
            return next(
                line.split(":", 1)[1].strip() for line in file if line.startswith("model name")
            )
    except (OSError, StopIteration):
        return platform.processor()
