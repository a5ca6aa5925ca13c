"""What a command takes, in a process of its own, that is given an input made to take time or memory."""

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from tests.places import ROOT

#: What a command may take: memory at its peak [MB] and time [s].
MOST_MB, MOST_S = 300.0, 10.0


@dataclass(frozen=True)
class Measured:
    """What a command took: exit code, processor time [s], memory at its peak [MB], and what it printed last."""

    code: int | None
    seconds: float
    megabytes: float
    said: str


def measured(
    arguments: list[str], folder: Path, limit_s: float = 90.0, limit_mb: int = 6000
) -> Measured:
    """Run ``replay-kit`` in a process of its own and return what it took.

    Args:
        arguments: Of the command.
        folder: In which it runs.
        limit_s: After which it is stopped [s of the clock].
        limit_mb: Address space that it may have [MB].
    """
    begin, peak, killed = time.perf_counter(), 0.0, False
    with open(folder / "said", "w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-c", _CHILD, str(limit_mb << 20), *arguments],
            stdout=said,
            stderr=said,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "160"},
        )
        while (ended := os.wait4(process.pid, os.WNOHANG))[0] == 0:
            peak = _peak(f"/proc/{process.pid}/status") or peak
            if time.perf_counter() - begin > limit_s and not killed:
                process.kill()
                killed = True
            time.sleep(0.02)
        process.returncode = os.waitstatus_to_exitcode(ended[1])
        said.seek(0)
        text = said.read()
    if (folder / "peak").exists():
        peak = _peak(str(folder / "peak"))
    # of the process alone: other work on the machine takes none of it
    seconds = ended[2].ru_utime + ended[2].ru_stime
    return Measured(None if killed else process.returncode, seconds, peak, text)


#: The resident memory that the kernel remembers of a process is, unlike that of ``getrusage``, not its parent's before it.
_CHILD = """
import resource, sys
from replay_kit.cli.app import main
resource.setrlimit(resource.RLIMIT_AS, 2 * (int(sys.argv.pop(1)),))
try:
    main()
finally:
    open("peak", "w").write(open("/proc/self/status").read())
"""


def _peak(status: str) -> float:
    """Return the resident memory at its peak [MB] that a process's status states; 0 when it has ended."""
    try:
        lines = Path(status).read_text().splitlines()
    except (OSError, ProcessLookupError):
        return 0.0
    return next(
        (float(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmHWM")), 0.0
    )
