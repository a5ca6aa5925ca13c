"""Commands killed at random instants: what is under the final name is whole, and the next run gives the bytes of one that was not killed.

A child is forked from a process that has everything imported, so that an instant falls into the work and not into the imports.
"""

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from replay_kit.config.run import RunConfig
from tests.command import invoke
from tests.workflows.replay.interrupted import make_ocean

_SETTINGS = "[output]\ncheckpoint_interval = 600.0\ninterval = 3600.0\n[estimator]\nmodes = 4\n"
#: What lies under the final name before some of the runs.
_EARLIER = b"an earlier output"
#: The commands.
KINDS = ("replay", "replay --checkpoint", "convert")


@dataclass
class Killed:
    """What came of the kills of one command.

    Attributes:
        kills: Runs that were killed before they ended.
        finished: Runs that ended before their instant came, in which the output must be complete.
        resumed: Kills that left a checkpoint, from which the next run went on.
        wrong: What is wrong, in words.
    """

    kills: int
    finished: int
    resumed: int
    wrong: list[str]


def make_inputs(folder: Path, pings: int = 30) -> None:
    """Write a small log with its ensemble and settings."""
    make_ocean(folder, RunConfig(), pings)
    (folder / "run.toml").write_text(_SETTINGS)


def kill(kind: str, folder: Path, count: int, seed: int) -> Killed:
    """Kill a command so many times, and run it to its end after each.

    Args:
        kind: ``replay``, ``replay --checkpoint`` or ``convert``.
        folder: With the inputs of ``make_inputs``; outputs are written there.
        count: Kills before the end of the command.
        seed: Of the instants.
    """
    out, checkpoint = folder / "out.mcap", folder / "run.ck"
    out.unlink(missing_ok=True)
    arguments = [kind.split()[0], str(folder / "glider.mcap"), "-o", str(out), "--overwrite"]
    if kind != "convert":
        arguments += [
            "--ensemble",
            str(folder / "ensemble.nc"),
            "--config",
            str(folder / "run.toml"),
        ]
    arguments += ["--checkpoint", str(checkpoint)] if "checkpoint" in kind else []
    begin = time.perf_counter()
    _run(arguments)
    took, whole = time.perf_counter() - begin, out.read_bytes()
    rng, found = np.random.default_rng(seed), Killed(0, 0, 0, [])
    while found.kills < count:
        before = _EARLIER if rng.random() < 0.5 else None
        out.unlink(missing_ok=True)
        if before is not None:
            out.write_bytes(before)
        instant = rng.uniform(0.0, 1.1 * took)
        killed = _killed(lambda: _run(arguments), instant)
        found.kills, found.finished = found.kills + killed, found.finished + (not killed)
        found.resumed += checkpoint.exists()
        left = out.read_bytes() if out.exists() else None
        if left not in ((before, whole) if killed else (whole,)):
            found.wrong.append(
                f"{kind}, killed after {instant:.3f} s: {'nothing' if left is None else len(left)} under the final name"
            )
        _run(arguments)
        if out.read_bytes() != whole:
            found.wrong.append(
                f"{kind}, killed after {instant:.3f} s: the next run gives other bytes"
            )
        beside = sorted(
            path.name
            for path in folder.iterdir()
            if path.name.endswith((".part", ".ck", ".journal"))
        )
        if beside:
            found.wrong.append(
                f"{kind}, killed after {instant:.3f} s: after the next run there are {', '.join(beside)}"
            )
    return found


def _run(arguments: list[str]) -> None:
    done = invoke(arguments)
    assert done.exit_code in (0, 6), done.output


def _killed(work: Callable[[], None], instant: float) -> bool:
    """Do some work in a process of its own and kill that after so many seconds; return whether it had not ended before."""
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            # nothing of the parent's is flushed or cleaned up here
            os._exit(0)
    time.sleep(instant)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)
