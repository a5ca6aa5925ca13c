"""Options of ``replay`` for following growing logs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.console import write_json
from replay_kit.cli.options import FLAG, option
from replay_kit.core.errors import ConfigError, LogError

if TYPE_CHECKING:
    from rich.console import Console

    from replay_kit.config.run import RunConfig
    from replay_kit.workflows.replay.inputs.job import ReplayJob

# Seconds between two looks, at least: a look reads the names in a folder.
_LEAST = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Following:
    """Options for following growing logs.

    Attributes:
        follow: Replay new data as logs grow or folders fill, until Ctrl-C; see the README.
        interval: Polling interval of --follow [s].
        until_idle: Stop --follow after this long without new data [s]. Default: never.
        goal_file: File with the goal LON,LAT,DEPTH; it may be edited during --follow.
        notify: Shell command that receives each alarm of --follow as a JSON line on standard input.
    """

    follow: Annotated[bool, FLAG] = False
    interval: Annotated[float, option(least=_LEAST, seconds=True)] = 60.0
    until_idle: Annotated[float | None, option("SECONDS", least=0.0, seconds=True)] = None
    goal_file: Annotated[Path | None, option("FILE")] = None
    notify: Annotated[str | None, option("COMMAND")] = None

    def check(self, others: Mapping[str, object]) -> None:
        """Raise ConfigError for incompatible options.

        Args:
            others: Options incompatible with ``--follow``, by name.
        """
        if self.follow and (given := [name for name, value in others.items() if value]):
            raise ConfigError(f"{given[0]}: cannot be combined with --follow; omit one")
        alone = {
            "--until-idle": self.until_idle,
            "--goal-file": self.goal_file,
            "--notify": self.notify,
        }
        if not self.follow and (
            given := [name for name, value in alone.items() if value is not None]
        ):
            raise ConfigError(f"{given[0]}: needs --follow; add it, or omit the option")

    def goes_on(self, out: Path) -> bool:
        """Return whether an earlier ``--follow`` is continued and its outputs are rewritten."""
        return self.follow and (self.states(out) / "mission").is_file()

    @staticmethod
    def page(out: Path) -> Path:
        """Return the status page of a followed mission."""
        return out.with_suffix(".status.html")

    @staticmethod
    def states(out: Path) -> Path:
        """Return the folder of the states kept between replays of a followed mission."""
        return out.with_name(f"{out.name}.follow")

    def run(
        self,
        job: "ReplayJob",
        config: "RunConfig",
        console: "Console",
        page: Path | None,
        json_file: Path | None,
    ) -> int:
        """Follow the logs of a job, and return the exit code of the last replay."""
        from replay_kit.show.summary import print_summary
        from replay_kit.workflows.follow.follow import follow
        from replay_kit.workflows.follow.watch import FollowOptions
        from replay_kit.workflows.planning.adapters import planner_of
        from replay_kit.workflows.status import read_status

        assert job.out is not None
        if job.vehicles and self.goal_file is not None:
            raise ConfigError(
                "--goal-file: needs a single vehicle; give each its goal with --goal NAME=LON,LAT,DEPTH"
            )
        if job.goal is not None and self.goal_file is not None:
            raise ConfigError("--goal-file: cannot be combined with --goal; omit one")

        def tell(text: str) -> None:
            console.print(text)

        options = FollowOptions(
            states=self.states(job.out),
            status=self.page(job.out),
            interval_s=self.interval,
            until_idle_s=self.until_idle,
            goal_file=self.goal_file,
            command=self.notify or "",
            report=page,
            tell=tell,
        )
        outcome = follow(job, config, planner_of, options)
        if outcome is None:
            raise LogError(
                "no log that can be replayed has arrived; check the folder and the messages about its files"
            )
        print_summary(read_status(job.out)[0], outcome, console)
        write_json(json_file, outcome.to_json())
        return outcome.exit_code
