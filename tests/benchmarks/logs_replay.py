"""The memory that the replay of a large log takes."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from replay_kit.config.run import load_config
from replay_kit.core.message import Message
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from tests.benchmarks.measure import Row, alone, row, seconds
from tests.places import SAMPLES

# bytes of each
_PICTURE, _ATTITUDE = 60_000, 100
_SMALL = {"forecast": {"levels": (5.0, 150.0, 500.0)}, "estimator": {"modes": 20}}


def memory_row(folder: Path, tiny: bool) -> Row:
    """A log of 1 GB (pings, many small messages, large ones) against one of the same pings alone: peak memory of the process."""
    megabytes = 12 if tiny else 1100
    pings = folder / "pings.mcap"
    write_mcap_log(pings, list(open_log(SAMPLES / "survey.mcap").messages())[:60])
    large = folder / "large.mcap"
    write_mcap_log(large, padded(pings, megabytes * 1_000_000))
    before, ours = (
        _replayed(path, SAMPLES / "ensemble.nc", folder, _SMALL) for path in (pings, large)
    )
    grown = ours["peak_mb"] - before["peak_mb"]
    return row(
        f"replay of a log of {large.stat().st_size / 1e6:.0f} MB: memory above that of its pings alone, {grown:.0f} MB of 200 allowed",
        ours["seconds"],
        error={"messages_differ": float(ours["profiles"] != before["profiles"])},
        peak_mb=grown,
        peak_asked_mb=200.0,
        whole_peak_mb=ours["peak_mb"],
    )


def padded(path: Path, size: int) -> Iterator[Message]:
    """Yield a log's messages with others between them, of no use to the estimator, that make up a size [bytes]."""
    messages = list(open_log(path).messages())
    each = size // len(messages)
    for message in messages:
        yield message
        large = int(0.8 * each) // _PICTURE
        for n in range(large):
            yield message._replace(
                topic="/camera",
                schema="foxglove.CompressedImage",
                payload={"n": n, "data": f"{n:06d}" * (_PICTURE // 6)},
            )
        for n in range(int(0.2 * each) // 150):
            yield message._replace(
                topic="/attitude",
                schema="Attitude",
                payload={"n": n, "roll": 0.1, "pitch": 0.2, "yaw": 0.3},
            )


def _replayed(log: Path, ensemble: Path, folder: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """Replay in a process of its own; return what its memory grew by [MB], its time and the profiles used."""
    config = load_config(None, settings)

    def work() -> dict[str, Any]:
        took, (summary, _) = seconds(
            lambda: replay(ReplayJob((log,), ensemble, folder / "out.mcap", overwrite=True), config)
        )
        return {"seconds": took, "profiles": summary.profiles_used}

    return alone(work)


def rows(tiny: bool) -> list[Row]:
    """The row; temporary files go when it ends."""
    with tempfile.TemporaryDirectory() as folder:
        return [memory_row(Path(folder), tiny)]
