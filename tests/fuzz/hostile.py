"""What a command takes, in a process of its own, that is given an input made to take time or memory."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from tests.places import ROOT

#: What a command may take: memory at its peak [MB] and time [s].
MOST_MB, MOST_S = 300.0, 10.0


@dataclass(frozen=True)
class Measured:
    """What a command took: exit code, processor time [s], memory at its peak [MB], and what it printed."""

    code: int
    seconds: float
    megabytes: float
    said: str


def measured(arguments: list[str], folder: Path) -> Measured:
    """Run ``replay-kit`` in a process of its own, in a folder, with 6 GB of address space, and return what it took."""
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "160"},
        timeout=90.0,
        text=True,
    )
    # a process that was killed has written nothing
    seconds, kilobytes = map(float, (folder / "took").read_text().split())
    return Measured(done.returncode, seconds, kilobytes / 1024.0, done.stdout)


#: The resident memory that the kernel remembers of a process is, unlike that of ``getrusage``, not its parent's before it.
_CHILD = """
import resource, time
from replay_kit.cli.app import main
resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
try:
    main()
finally:
    (peak,) = (line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM"))
    open("took", "w").write(f"{time.process_time()} {peak}")
"""
