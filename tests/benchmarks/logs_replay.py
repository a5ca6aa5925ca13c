"""Whole replays: the memory that a large log takes, and the share of each stage in a day of pings at 1 Hz."""

import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.message import Message
from replay_kit.core.observation import Reason
from replay_kit.forecast import read_truth
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins import Twin, make_twin, write_ensemble
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from tests.benchmarks.measure import Row, alone, row, seconds
from tests.places import SAMPLES

# bytes of each
_PICTURE, _ATTITUDE = 60_000, 100
_SECOND = 1_000_000_000
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
    """Replay in a process of its own; return what its memory grew by [MB], its time, the profiles used and the time of each stage."""
    config = load_config(None, settings)

    def work() -> dict[str, Any]:
        took, (summary, _) = seconds(
            lambda: replay(ReplayJob((log,), ensemble, folder / "out.mcap", overwrite=True), config)
        )
        read = sum(topic.read for topic in summary.messages)
        return {
            "seconds": took,
            "profiles": summary.profiles_used,
            "read": read,
            "stages": dict(summary.seconds),
        }

    return alone(work)


def decisions(result: Path) -> Counter[str]:
    """Return how many profiles of a result ended with each decision; those that came twice or too late are ``repeated``."""
    repeated = int(Reason.DUPLICATE | Reason.OUT_OF_ORDER)
    with result.open("rb") as file:
        said = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
            topics="/flow/innovation"
        )
        found: Counter[str] = Counter()
        for *_, one in said:
            # profiles that were combined have one message
            found["repeated" if any(bits & repeated for bits in one.reasons) else one.decision] += (
                one.profiles
            )
        return found


def stages_row(folder: Path, tiny: bool) -> Row:
    """A day of pings at 1 Hz with 300 modes a level: what each stage takes, beside reading alone."""
    pings, modes = (12, 4) if tiny else (86_400, 300)
    where = SAMPLES if tiny else folder
    ensemble, truth = where / "ensemble.nc", where / "truth.nc"
    if not tiny:
        write_ensemble(ensemble, truth, n_members=95)
    make_twin(
        read_truth(str(truth), RunConfig().forecast),
        Twin("vessel", pings, 0.09, 0),
        folder / "slow.mcap",
        True,
    )
    log = folder / "fast.mcap"
    write_mcap_log(log, _hurried(folder / "slow.mcap", pings))
    return whole_row(log, ensemble, folder, pings, modes)


def whole_row(log: Path, ensemble: Path, folder: Path, pings: int, modes: int) -> Row:
    """The row of one log's replay: every message is read, and every ping is judged by the estimator.

    A ping that the gate rejects was judged as one that is used; how many there were is a figure of its own, and no difference.
    """
    reading_s, count = seconds(lambda: sum(1 for _ in open_log(log).messages()))
    ours = _replayed(log, ensemble, folder, {"estimator": {"modes": modes}})
    found = decisions(folder / "out.mcap")
    judged = found["accepted"] + found["softened"] + found["rejected"]
    stages = {f"share_{name}": took / ours["seconds"] for name, took in ours["stages"].items()}
    return row(
        f"whole replay of {pings} pings at 1 Hz, {modes} modes asked a level; {count} messages read alone in {reading_s:.2f} s",
        ours["seconds"],
        error={
            "messages_differ": float(abs(ours["read"] - count)),
            "messages_not_judged": float(abs(pings - judged)),
        },
        **stages,
        profiles_used=ours["profiles"],
        profiles_gated=found["rejected"],
        peak_mb=ours["peak_mb"],
    )


def _hurried(path: Path, pings: int) -> Iterator[Message]:
    """Yield a log's messages as if its pings had come once a second."""
    times = [message.time_ns for message in open_log(path).messages()]
    first, last = times[0], max(times)
    for message in open_log(path).messages():
        yield message._replace(
            time_ns=first + (message.time_ns - first) * pings * _SECOND // max(last - first, 1)
        )


def rows(tiny: bool) -> list[Row]:
    """All rows; temporary files go when they end."""
    with tempfile.TemporaryDirectory() as folder:
        return [memory_row(Path(folder), tiny), stages_row(Path(folder), tiny)]
