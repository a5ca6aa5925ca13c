"""A mission as it comes in, one file at a time: processor time and memory of each answer, whatever the files and the process go through.

Thirty dives of a twin come in 31 instalments, three of them after the next one, one wrong at first; the process that follows them is
killed ten times. Each time the estimate is compared with that of one replay of the final files.
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from tests.benchmarks.measure import Row, row
from tests.instalments import Instalment, delivered, dives_of
from tests.places import ROOT

# Seconds asked of each answer, on two cores, and megabytes; seconds after which there is none.
_ASKED, _ASKED_MB, _PATIENCE = 15.0, 1000.0, 300.0
_KILLS, _DIVES = 10, 30
_REPLAY = (sys.executable, "-m", "replay_kit", "replay", "--samples", "10")
_ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def rows(tiny: bool) -> list[Row]:
    """Return the row of a mission; when tiny of three dives."""
    with tempfile.TemporaryDirectory() as name:
        return [_twin(Path(name), tiny)]


class Shore:
    """A process that follows a folder, started, killed and started again: processor and wall time [s] of its answers, most memory [MB]."""

    def __init__(self, inbox: Path, out: Path, arguments: Sequence[str]) -> None:
        self.inbox, self.out, self.arguments = inbox, out, arguments
        self.seconds, self.walls, self.peak_mb = list[float](), list[float](), 0.0

    def start(self) -> None:
        """Start the process, which goes on from what is on the disk."""
        follow = *self.arguments, "-o", str(self.out), "--follow", "--interval", "0.2"
        # in the background a shell lets its children ignore Ctrl-C
        signal.signal(signal.SIGINT, signal.default_int_handler)
        self.process = subprocess.Popen(
            [*_REPLAY, str(self.inbox), *follow],
            env=_ENVIRONMENT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def deliver(self, one: Instalment) -> None:
        """Put a file into the folder, whole."""
        part = self.inbox / f".{one.name}"
        part.write_bytes(one.data)
        part.replace(self.inbox / one.name)

    def answered(self, since_ns: int) -> None:
        """Wait until the result is of a time after a delivery, and measure what it took."""
        begin, used = time.monotonic(), self._used()
        made = self.out, self.out.with_suffix(".status.html")
        while not all(path.exists() and path.stat().st_mtime_ns > since_ns for path in made):
            if self.process.poll() is not None or time.monotonic() - begin > _PATIENCE:
                self.process.kill()
                raise RuntimeError(f"no answer: {self.process.communicate()[0]}")
            time.sleep(0.05)
        self.seconds.append(self._used() - used)
        self.walls.append(time.monotonic() - begin)

    def end(self, by: signal.Signals) -> int:
        """End the process by a signal, and return its exit code."""
        self._used()
        self.process.send_signal(by)
        self.process.communicate()
        return int(self.process.returncode)

    def _used(self) -> float:
        """Return the processor time so far [s], and look at the memory."""
        proc = Path(f"/proc/{self.process.pid}")
        peak = re.search(r"VmHWM:\s+(\d+)", (proc / "status").read_text())
        self.peak_mb = max(self.peak_mb, int(peak[1]) / 1024.0 if peak else 0.0)
        fields = (proc / "stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _twin(folder: Path, tiny: bool) -> Row:
    """Return the row of a twin's mission in the sample ocean."""
    from replay_kit.config.run import ForecastConfig
    from replay_kit.forecast import read_truth
    from replay_kit.studies.twins.make import Twin, make_twin

    count, kills = (3, 1) if tiny else (_DIVES, _KILLS)
    log, samples = folder / "twin.mcap", ROOT / "sample_logs"
    truth = read_truth(str(samples / "truth.nc"), ForecastConfig())
    # more pings than the dives take
    make_twin(truth, Twin("glider", 18 * count, 0.09, 7), log)
    dives = dives_of(log, folder)[:count]
    whole = dives[count // 2]
    wrong = Instalment(whole.name, whole.data[: 2 * len(whole.data) // 3])
    order = delivered(dives, [1] if tiny else [4, 12, 22], count // 2, wrong)
    line = f"--region 151.5,-41,153.5,-39 --ensemble {samples}/ensemble.nc --goal=152.8,-40.1,300"
    arguments = (line + " --modes 10 --planner glide" * tiny).split()
    (folder / "inbox").mkdir()
    shore, rng = Shore(folder / "inbox", folder / "out.mcap", arguments), np.random.default_rng(5)
    killed = set(rng.choice(len(order), size=kills, replace=False).tolist())
    shore.start()
    for k, one in enumerate(order):
        since_ns = time.time_ns()
        shore.deliver(one)
        if k in killed:
            time.sleep(float(rng.uniform(0.1, 12.0 if len(order) > 4 else 3.0)))
            shore.end(signal.SIGKILL)
            shore.start()
            since_ns = time.time_ns()
        shore.answered(since_ns)
    code, once, settings = shore.end(signal.SIGINT), folder / "once.mcap", folder / "once.toml"
    settings.write_text('[planner]\nwhen = "surfacing"\n')
    more = [*map(str, sorted(shore.inbox.iterdir())), "--config", str(settings), "-o", str(once)]
    subprocess.run(
        [*_REPLAY, *arguments, *more], env=_ENVIRONMENT, capture_output=True, check=False
    )
    differing = float(_estimate(shore.out) != _estimate(once))
    return row(
        f"at sea: twin, {len(order)} instalments, killed {len(killed)} times",
        max(shore.seconds),
        asked=_ASKED,
        error={"differing": differing, "exit": float(code != 130)},
        median_s=float(np.median(shore.seconds)),
        wall_s=max(shore.walls),
        peak_mb=shore.peak_mb,
        asked_mb=_ASKED_MB,
    )


def _estimate(path: Path) -> bytes:
    with path.open("rb") as file:
        found = make_reader(file).iter_attachments()
        return next(record.data for record in found if record.name == "estimate.npz")
