"""A folder that fills, in a time that passes only by waiting."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from mcap.reader import make_reader

from replay_kit.config.run import RunConfig
from replay_kit.core.plan import Place
from replay_kit.workflows.follow.follow import follow
from replay_kit.workflows.follow.watch import Clock, FollowOptions
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from tests.workflows.replay.interrupted import QUICK

GOAL = Place(152.3, -39.8, 150.0)
#: As little as shows everything: each replay of a dive builds the estimator anew.
CONFIG = RunConfig(planner={"kind": "glide"}, estimator=QUICK)
#: Waits shorter than this are those between two looks at a file that must not change; nothing arrives in them.
INTERVAL = 10.0


class Sea:
    """A vehicle's shore station: deliveries that happen one at each wait."""

    def __init__(self, ocean: Path, folder: Path, goal: Place | None = None):
        self.inbox, self.out = folder / "inbox", folder / "result.mcap"
        self.inbox.mkdir(exist_ok=True)
        self.job = ReplayJob((self.inbox,), ocean / "ensemble.nc", self.out, goal=goal)
        self.told: list[str] = []
        files = folder / "states", folder / "status.html"
        self.options = FollowOptions(*files, INTERVAL, 2.5 * INTERVAL, tell=self.told.append)
        self._passed = 0.0

    def follow(
        self,
        deliveries: Sequence[Callable[[], object]] = (),
        config: RunConfig = CONFIG,
        **options: object,
    ):
        """Follow the inbox while deliveries arrive, and return the last summary."""
        waiting = list(deliveries)

        def wait(seconds: float) -> None:
            self._passed += seconds
            if seconds >= INTERVAL and waiting:
                waiting.pop(0)()

        clock = Clock(lambda: 1_600_000_000 * 10**9, lambda: self._passed, wait)
        return follow(self.job, config, planner_of, replace(self.options, **options), clock)

    def put(self, name: str, data: bytes) -> Callable[[], object]:
        """Return the delivery of a file, which appears whole."""
        return lambda: (self.inbox / name).write_bytes(data)

    def at_once(self, config: RunConfig = CONFIG) -> Path:
        """Replay what is in the inbox in the end, planned at the same times."""
        when = config.planner.model_copy(update={"when": "surfacing"})
        logs = sorted(path for path in self.inbox.iterdir() if path.suffix in (".mcap", ".tlog"))
        job = replace(self.job, logs=tuple(logs), out=self.out.with_name("at-once.mcap"))
        replay(job, config.model_copy(update={"planner": when}), planner_of)
        return job.out


def contents(path: Path) -> tuple[dict[str, bytes], list[tuple[str, int, bytes]]]:
    """Return the attachments of a result by name, and its messages in their order."""
    with path.open("rb") as file:
        reader = make_reader(file)
        attached = {record.name: record.data for record in reader.iter_attachments()}
        return attached, [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
