"""Commands that get a signal at random instants: what is under the final name is whole, and the next run gives the bytes of one left alone.

A child is forked from a process that has everything imported, so that an instant falls into the work and not into the imports. SIGKILL,
SIGTERM and SIGINT end it; stopped and continued it ends by itself. Of a fleet the child begins workers.
"""

import os
import shutil
import signal
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import numpy as np

from replay_kit.config.run import RunConfig
from tests.command import invoke
from tests.workflows.replay.interrupted import make_ocean

_SETTINGS = "[output]\ncheckpoint_interval = 600.0\ninterval = 3600.0\n[estimator]\nmodes = 4\n"
#: What lies under the final name before some of the runs.
_EARLIER = b"an earlier output"
_INPUTS = "{0}/glider.mcap --ensemble {0}/ensemble.nc --config {0}/run.toml"
_FLEET = f"fleet {{0}}/second.mcap {_INPUTS} -o {{0}}/fleet --workers 1 --resume"
#: Kinds of commands, each with the outputs that are compared.
KINDS = {
    "replay": (f"replay {_INPUTS} --overwrite -o {{0}}/out.mcap", "out.mcap"),
    "replay --checkpoint": (
        f"replay {_INPUTS} --overwrite -o {{0}}/out.mcap --checkpoint {{0}}/run.ck",
        "out.mcap",
    ),
    "convert": ("convert {0}/glider.mcap --overwrite -o {0}/out.mcap", "out.mcap"),
    "export": ("export {0}/whole.mcap --overwrite -o {0}/out.nc", "out.nc"),
    "replay --follow": (
        f"replay {_INPUTS} -o {{0}}/out.mcap --follow --interval 0.1 --until-idle 0.01",
        "out.mcap",
    ),
    "fleet": (_FLEET, "fleet/*.mcap"),
}
#: The signals.
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGSTOP)
# s for which a process is stopped, one that goes on is waited for, and workers may live on without their scheduler
_STOPPED, _LONGEST, _ORPHANED = 0.2, 120.0, 10.0


def make_inputs(folder: Path) -> None:
    """Write a small log, and a copy of it, with its ensemble, settings and a result."""
    make_ocean(folder, RunConfig(), 30)
    shutil.copy(folder / "glider.mcap", folder / "second.mcap")
    (folder / "run.toml").write_text(_SETTINGS)
    _run(f"replay {_INPUTS} -o {{0}}/whole.mcap".format(folder))


def kill(kind: str, folder: Path, count: int, seed: int, sent: signal.Signals) -> list[str]:
    """Give a command a signal so many times, run it to its end after each, and return what is wrong.

    Args:
        kind: One of ``KINDS``.
        folder: With the inputs of ``make_inputs``; outputs are written there.
        count: Signals before the end of the command.
        seed: Of the instants.
        sent: The signal.
    """
    command, pattern = KINDS[kind][0].format(folder), KINDS[kind][1]
    # what it imports every child has
    invoke(KINDS["replay" if "fleet" in kind else kind][0].format(folder))
    if "fleet" in kind:
        import_module("replay_kit.workflows.fleet.page")
    _clear(folder)
    begin = time.perf_counter()
    _run(command)
    took, whole = time.perf_counter() - begin, _outputs(folder, pattern)
    assert whole, "the command wrote nothing"
    rng, kills, wrong = np.random.default_rng(seed), 0, list[str]()
    while kills < count:
        _clear(folder)
        before = {}
        if "--overwrite" in command and rng.random() < 0.5:
            before = {pattern: _EARLIER}
            (folder / pattern).write_bytes(_EARLIER)
        instant = rng.uniform(0.0, 1.1 * took)
        met = _signalled(command, instant, sent)
        kills += met
        left, when = _outputs(folder, pattern), f"{kind}, {sent.name} after {instant:.3f} s"
        must_end = sent == signal.SIGSTOP or not met
        # of a fleet some results may be there already
        partly = left.items() <= whole.items() and "*" in pattern
        if left != whole and (must_end or not (left == before or partly)):
            wrong.append(f"{when}: {sorted(left) or 'nothing'} under the final name")
        _run(command)
        if _outputs(folder, pattern) != whole:
            wrong.append(f"{when}: the next run gives other bytes")
        beside = sorted(
            path.name
            for path in (*folder.iterdir(), *folder.glob("fleet/*"))
            if path.name.endswith((".part", ".ck", "unfinished"))
        )
        if beside:
            wrong.append(f"{when}: after the next run there are {', '.join(beside)}")
    return wrong


def _outputs(folder: Path, pattern: str) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob(pattern)}


def _clear(folder: Path) -> None:
    """Leave the inputs of ``make_inputs`` alone, and nothing of an earlier run."""
    for path in (*folder.glob("out.*"), folder / "fleet"):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _run(command: str) -> None:
    """Run a command to its end, in a child too."""
    _, status = os.waitpid(_started(command), 0)
    assert os.waitstatus_to_exitcode(status) in (0, 6), command


def _started(command: str) -> int:
    """Return a process, the first of its group, that runs a command and ends with its exit code."""
    # before the try it must not raise
    own = signal.signal(signal.SIGINT, signal.SIG_DFL)
    child = os.fork()
    if child:
        signal.signal(signal.SIGINT, own)
        return child
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.setpgid(0, 0)
        code = invoke(command).exit_code
    finally:
        # nothing of the parent's is flushed or cleaned up here
        os._exit(code)


def _signalled(command: str, instant: float, sent: signal.Signals) -> bool:
    """Run a command and send it a signal after so many seconds; return whether it came before its end."""
    child = _started(command)
    time.sleep(instant)
    if os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
        with suppress(ChildProcessError):
            os.waitpid(child, 0)
        return False
    with suppress(ProcessLookupError):
        os.kill(child, sent)
        if sent == signal.SIGSTOP:
            time.sleep(_STOPPED)
            os.kill(child, signal.SIGCONT)
    if sent == signal.SIGSTOP:
        signal.alarm(int(_LONGEST))
    os.waitpid(child, 0)
    # workers of a fleet that was killed end by themselves
    signal.alarm(int(_ORPHANED))
    with suppress(ProcessLookupError):
        while True:
            os.killpg(child, 0)
            time.sleep(0.01)
    signal.alarm(0)
    return True
