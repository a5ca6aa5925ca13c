"""A mission as it comes in, one file at a time: processor time and memory of each answer, whatever the files and the process go through.

Thirty dives of a twin come in 31 instalments, three of them after the next one, one wrong at first; the process that follows them is
killed ten times. Each time the estimate is compared with that of one replay of the final files.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from tests.benchmarks.measure import Row, row
from tests.instalments import Instalment, delivered, dives_of
from tests.places import ROOT

# Seconds asked of each answer, on two cores, and megabytes.
_ASKED, _ASKED_MB = 15.0, 1000.0
_PATIENCE = 300.0
_TICKS = os.sysconf("SC_CLK_TCK")
_KILLS, _DIVES = 10, 30


def rows(tiny: bool) -> list[Row]:
    """Return the row of a mission; when tiny of three dives."""
    with tempfile.TemporaryDirectory() as name:
        return [_twin(Path(name), tiny)]


_REPLAY = (sys.executable, "-m", "replay_kit", "replay")


@dataclass
class Shore:
    """A process that follows a folder: started, killed and started again.

    Attributes:
        inbox: Where files arrive.
        out: The result.
        arguments: Of the command, beside the folder and the result.
        seconds: Processor time of each answer.
        walls: Wall time of each answer.
        peak_mb: Most memory of any of the processes.
    """

    inbox: Path
    out: Path
    arguments: Sequence[str]
    seconds: list[float] = field(default_factory=list)
    walls: list[float] = field(default_factory=list)
    peak_mb: float = 0.0

    def start(self) -> None:
        """Start the process, which goes on from what is on the disk."""
        command = [*_REPLAY, str(self.inbox), *self.arguments, "-o", str(self.out)]
        command += ["--follow", "--interval", "0.2", "--samples", "10"]
        # in the background a shell lets its children ignore Ctrl-C
        signal.signal(signal.SIGINT, signal.default_int_handler)
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )

    def deliver(self, one: Instalment) -> None:
        """Put a file into the folder, whole."""
        part = self.inbox / f".{one.name}"
        part.write_bytes(one.data)
        part.replace(self.inbox / one.name)

    def answered(self, since_ns: int) -> None:
        """Wait until the result is of a time after a delivery, and measure what it took."""
        begin, used = time.monotonic(), self._used()
        status = self.out.with_suffix(".status.html")
        while not (self._changed(self.out) > since_ns and self._changed(status) > since_ns):
            if self.process.poll() is not None or time.monotonic() - begin > _PATIENCE:
                self.process.kill()
                raise RuntimeError(f"no answer: {self.process.communicate()[0]}")
            time.sleep(0.05)
        self.seconds.append(self._used() - used)
        self.walls.append(time.monotonic() - begin)
        self._look_at_memory()

    def kill(self) -> None:
        """End the process at once."""
        self._look_at_memory()
        self.process.kill()
        self.process.communicate()

    def end(self) -> int:
        """End the process as Ctrl-C does, and return its exit code."""
        self.process.send_signal(signal.SIGINT)
        self.process.communicate()
        return int(self.process.returncode)

    def _used(self) -> float:
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS

    def _look_at_memory(self) -> None:
        lines = Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
        peak = next((int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)
        self.peak_mb = max(self.peak_mb, peak / 1024.0)

    @staticmethod
    def _changed(path: Path) -> int:
        return path.stat().st_mtime_ns if path.exists() else 0


def _twin(folder: Path, tiny: bool) -> Row:
    """Return the row of a twin's mission in the sample ocean."""
    from replay_kit.config.run import ForecastConfig
    from replay_kit.forecast import read_truth
    from replay_kit.studies.twins.make import Twin, make_twin

    count = 3 if tiny else _DIVES
    log, samples = folder / "twin.mcap", ROOT / "sample_logs"
    # more pings than the dives take
    make_twin(
        read_truth(str(samples / "truth.nc"), ForecastConfig()),
        Twin("glider", 18 * count, 0.09, 7),
        log,
    )
    dives = dives_of(log, folder)[:count]
    whole = dives[count // 2]
    wrong = Instalment(whole.name, whole.data[: 2 * len(whole.data) // 3])
    order = delivered(dives, [1] if tiny else [4, 12, 22], count // 2, wrong)
    region = [
        "--region",
        "151.5,-41,153.5,-39",
        "--ensemble",
        str(samples / "ensemble.nc"),
        "--goal=152.8,-40.1,300",
    ]
    extra = ["--modes", "10", "--planner", "glide"] if tiny else []
    return _followed(
        f"twin, {len(order)} instalments",
        folder / "twin",
        order,
        [*region, *extra],
        1 if tiny else _KILLS,
    )


def _followed(
    name: str, folder: Path, order: Sequence[Instalment], arguments: Sequence[str], kills: int
) -> Row:
    """Return what it took to follow a mission, and whether its estimate is that of one replay of the final files."""
    (folder / "inbox").mkdir(parents=True)
    shore, rng = Shore(folder / "inbox", folder / "out.mcap", arguments), np.random.default_rng(5)
    killed = set(rng.choice(len(order), size=min(kills, len(order)), replace=False).tolist())
    shore.start()
    for k, one in enumerate(order):
        since_ns = time.time_ns()
        shore.deliver(one)
        if k in killed:
            time.sleep(float(rng.uniform(0.1, 12.0 if len(order) > 4 else 3.0)))
            shore.kill()
            shore.start()
            since_ns = time.time_ns()
        shore.answered(since_ns)
    code = shore.end()
    once = folder / "once.mcap"
    logs = [str(path) for path in sorted(shore.inbox.iterdir())]
    settings = folder / "once.toml"
    settings.write_text('[planner]\nwhen = "surfacing"\n')
    more = ["--samples", "10", "--config", str(settings), "-o", str(once)]
    subprocess.run(
        [*_REPLAY, *logs, *arguments, *more],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=False,
    )
    differing = float(_estimate(shore.out) != _estimate(once))
    return row(
        f"at sea: {name}, killed {len(killed)} times",
        max(shore.seconds),
        asked=_ASKED,
        error={"differing": differing, "exit": float(code != 130)},
        median_s=float(np.median(shore.seconds)),
        wall_s=max(shore.walls),
        asked_s=_ASKED,
        peak_mb=shore.peak_mb,
        asked_mb=_ASKED_MB,
    )


def _estimate(path: Path) -> bytes:
    with path.open("rb") as file:
        return next(
            record.data
            for record in make_reader(file).iter_attachments()
            if record.name == "estimate.npz"
        )


if __name__ == "__main__":
    print(json.dumps(rows("--tiny" in sys.argv), indent=1))
