"""Following of growing logs: look, replay new data, write result, status and report, raise alarms, wait."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import (
    ConfigError,
    LogError,
    MeasurementError,
    PlanError,
    ReplayKitError,
)
from replay_kit.core.files.atomic import claimed, part_of
from replay_kit.core.files.inputs import Stamp, stamps_of
from replay_kit.core.plan import Place
from replay_kit.core.words.text import count_text, place_text
from replay_kit.estimator import Estimator
from replay_kit.forecast import ensemble_files
from replay_kit.logs.opening import may_grow
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.reader import ResultReader
from replay_kit.show.status.held import Held
from replay_kit.show.status.status import Status, status_of
from replay_kit.workflows.follow.sources import read_goal, with_goal
from replay_kit.workflows.follow.watch import (
    Clock,
    FollowOptions,
    Watched,
    alarm_line,
    key_of,
    look_again,
    new_alarms,
    notify,
    of_vehicle,
    read_memory,
    standing,
    write_memory,
)
from replay_kit.workflows.replay.inputs.forecast import Forecasts, build
from replay_kit.workflows.replay.inputs.job import (
    Following,
    ReplayJob,
    Vehicle,
    forecasts_of,
    logs_of,
)
from replay_kit.workflows.replay.inputs.provenance import named_hash
from replay_kit.workflows.replay.inputs.region import from_record
from replay_kit.workflows.replay.inputs.vehicles import identified
from replay_kit.workflows.replay.plans import PlannerFactory
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.report import report
from replay_kit.workflows.status import read_each, write_pages

# A vehicle whose last message is younger is under way, and its surfacings can be overdue by the clock [ns].
_UNDER_WAY_NS = 3 * 86_400 * 10**9
_UNUSABLE = (LogError, MeasurementError, PlanError, ConfigError)


def follow(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory,
    options: FollowOptions,
    clock: Clock | None = None,
) -> Outcome | None:
    """Follow logs until they have not grown for a while, and return the last outcome; None without a replay.

    The estimate equals that of one replay of the final files. Another call continues from the state on disk.

    Args:
        job: Replay whose logs are growing files and folders.
        config: The run's settings.
        planner_of: Factory of the planner.
        options: Options for following.
        clock: Clock; None for the system clock.

    Raises:
        ForecastError: The forecast cannot be used for the first replay.
        ConfigError: An output cannot be written, another process follows into it, or the goal's file cannot be read at the beginning.
    """
    follower = Follower(job, _planned_at_surfacings(config), planner_of, options, clock or Clock())
    try:
        with claimed(options.states / "lock", follower.out):
            return follower.run()
    except KeyboardInterrupt:
        # the result of the replay before is whole
        if job.out is not None:
            part_of(job.out).unlink(missing_ok=True)
        raise


def _planned_at_surfacings(config: RunConfig) -> RunConfig:
    """Return the settings with a plan at each surfacing, unless they state the times of plans."""
    if "when" in config.planner.model_fields_set:
        return config
    return config.model_copy(
        update={"planner": config.planner.model_copy(update={"when": "surfacing"})}
    )


class Follower:
    """State of a followed mission; mutable, changes with each look."""

    def __init__(
        self,
        job: ReplayJob,
        config: RunConfig,
        planner_of: PlannerFactory,
        options: FollowOptions,
        clock: Clock,
    ) -> None:
        """Begin with the stored memory; for the arguments see ``follow``."""
        try:
            options.states.mkdir(exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"{options.states}: cannot create the folder: {error.strerror}; choose another"
            ) from error
        assert job.out is not None
        self._job, self._config, self._planner_of, self._options, self._clock = (
            job,
            config,
            planner_of,
            options,
            clock,
        )
        self._out = job.out
        self._memory = read_memory(options.states)
        self._good = set(self._memory.used)
        self._forecast: tuple[dict[Path, Stamp], Forecasts, object] | None = None
        self._built: tuple[Forecasts, Estimator[Any]] | None = None
        self._held: dict[str, Held] = {}
        self._made: Outcome | None = None
        if self._good and self._out.is_file():
            reader = ResultReader(self._out)
            self._held, self._made = read_each(reader), reader.outcome
        self._shown: dict[str, Status] = {}
        self._due = False
        self._set_goal(job.goal if options.goal_file is None else read_goal(options.goal_file))

    @property
    def out(self) -> Path:
        """File of the result."""
        return self._out

    def run(self) -> Outcome | None:
        """Look and replay until the logs have not grown for long enough."""
        first, idle_since = True, self._clock.idle_s()
        while True:
            if self.poll(first):
                idle_since = self._clock.idle_s()
            first = False
            limit = self._options.until_idle_s
            if limit is not None and self._clock.idle_s() - idle_since >= limit:
                return self._made
            self._clock.wait(
                self._options.interval_s
                if limit is None
                else min(self._options.interval_s, max(limit, 0.01))
            )

    def poll(self, always: bool = False) -> bool:
        """Look once, and return whether the inputs changed.

        Args:
            always: Replay even without a change.
        """
        moved, changed = self._look_at_goal(), self._look_at_files()
        if (moved or changed or always or self._due) and self._memory.used:
            self._replay()
        elif always:
            self._options.tell("waiting for a log")
        if self._held:
            self._answer()
        return moved or changed

    def _look_at_files(self) -> bool:
        """Examine changed files, and return whether the set of used files changed."""
        own = [
            self._out,
            self._options.states,
            self._options.status,
            *filter(None, [self._options.report, self._options.goal_file]),
        ]
        own += [path for path in (self._job.netcdf, self._job.save_estimate) if path is not None]
        own += ensemble_files(self._job.ensemble)
        watched = Watched(
            self._job.logs,
            tuple(own),
            self._config.logs,
            self._clock,
            self._options.interval_s,
            self._vehicle_of,
        )
        sources, said, changed = look_again(watched, self._memory.sources)
        for text in said:
            self._options.tell(text)
        self._remember(sources=sources, said=(*self._memory.said, *said))
        return changed

    def _vehicle_of(self, path: Path) -> str:
        """Return the vehicle under whose name a file or its folder is followed; empty without a name."""
        for vehicle in self._job.vehicles:
            if path in vehicle.logs or path.parent in vehicle.logs:
                return vehicle.name
        return ""

    def _look_at_goal(self) -> bool:
        """Read the goal file, if any, and return whether the goal changed."""
        if self._options.goal_file is None:
            return False
        try:
            return self._set_goal(read_goal(self._options.goal_file))
        except ConfigError as error:
            self._say(f"{error}; the goal is unchanged", once=True)
            return False

    def _set_goal(self, goal: Place | None) -> bool:
        if goal is None:
            return False
        before = self._memory.goals
        goals = with_goal(
            before, goal, max((held.last_ns for held in self._held.values()), default=0)
        )
        if not before or before[-1][1] == goal:
            self._remember(goals=goals)
            return False
        place = place_text(goal.longitude, goal.latitude)
        self._say(f"the goal moved to {place}, {goal.depth:g} m", goals=goals)
        return True

    def _replay(self) -> None:
        """Replay the used files; new files that make the replay fail are excluded."""
        began, used, self._due = self._clock.idle_s(), self._memory.used, False
        # those that grow may change, up to what is read of them
        whole = [
            *(path for path in used if not may_grow(path)),
            *ensemble_files(self._job.ensemble),
        ]
        stamps = stamps_of(whole)
        try:
            self._run(used)
        except ReplayKitError as error:
            if stamps_of(whole) != stamps:
                self._due = True
                self._options.tell(f"a file changed while it was read; it is read again: {error}")
                return
            if isinstance(error, _UNUSABLE):
                self._without_new(used, error)
                return
            if not self._held:
                raise
            self._say(f"not replayed, the previous result is kept: {error}", once=True)
            return
        assert self._made is not None
        each = self._made.vehicles.values() or (self._made,)
        dives = count_text(sum(len(one.by_dive) for one in each), "dive")
        took = self._clock.idle_s() - began
        self._options.tell(
            f"{count_text(len(self._memory.used), 'file')}, {dives} replayed in {took:.1f} s: {self._out}"
        )

    def _without_new(self, used: tuple[Path, ...], error: ReplayKitError) -> None:
        """Replay without the new files that made a replay fail, found one by one; the first files of a mission are awaited instead."""
        fresh = [path for path in used if path not in self._good]
        if not self._good or not fresh:
            self._say(f"not replayed: {error}", once=True)
            return
        for path in fresh:
            kept = tuple(other for other in used if other in self._good or other == path)
            try:
                self._run(kept)
            except _UNUSABLE as reason:
                why = f"makes the replay fail: {reason}"
                source = replace(self._memory.sources[path], aside=why)
                sources = {**self._memory.sources, path: source}
                self._say(f"{path.name} not used: it {why}", sources=sources)

    def _run(self, used: tuple[Path, ...]) -> None:
        """Replay files, and read the status of the result."""
        job = replace(
            self._job,
            logs=used,
            overwrite=True,
            goal=self._memory.goals[0][1] if self._memory.goals else None,
            vehicles=self._vehicles(used),
        )
        job = identified(job, self._config)
        forecasts = self._forecasts(job)
        record = {
            f"{number:03d}": self._without_folders(text)
            for number, text in enumerate(self._memory.said)
        }
        job = replace(
            job,
            following=Following(self._options.states, record, self._memory.goals[1:]),
            estimator=partial(self._estimator, job),
            tell=self._options.tell,
        )
        self._made, _ = replay(job, self._config, self._planner_of, forecasts=forecasts)
        self._held = read_each(ResultReader(self._out))
        self._good |= set(used)
        if self._options.report is not None:
            report(self._out, self._options.report, overwrite=True, made=self._made)

    def _vehicles(self, used: tuple[Path, ...]) -> tuple[Vehicle, ...]:
        """Return the vehicles that have used files, with these files."""
        of = {path: self._vehicle_of(path) for path in used}
        return tuple(
            replace(one, logs=tuple(path for path in used if of[path] == one.name))
            for one in self._job.vehicles
            if one.name in of.values()
        )

    def _estimator(self, job: ReplayJob, forecasts: Forecasts, config: RunConfig) -> Estimator[Any]:
        """Return the estimator of a forecast, built once for all replays until the forecast changes."""
        if self._built is None or self._built[0] is not forecasts:
            self._built = forecasts, build(forecasts, config, len(job.each_vehicle))
        return self._built[1]

    def _without_folders(self, text: str) -> str:
        """Return a text with file names without folders, so that a result does not depend on the folder of its inputs."""
        for path in (
            *self._memory.sources,
            *ensemble_files(self._job.ensemble),
            *filter(None, [self._options.goal_file]),
        ):
            text = text.replace(str(path), path.name)
        return text

    def _forecasts(self, job: ReplayJob) -> Forecasts:
        """Return the forecast, read again when its files or the beginning of the logs changed."""
        stamps = stamps_of(ensemble_files(job.ensemble))
        ahead = logs_of(job, self._config).ahead()
        if (
            self._forecast is not None
            and self._forecast[0] == stamps
            and self._forecast[2] == ahead
        ):
            return self._forecast[1]
        try:
            # found from the first files, it does not change: states depend on it
            record = json.loads(self._memory.region or "null")
            region = None if record is None else from_record(record)
            found = forecasts_of(replace(job, region=region), self._config)
        except ReplayKitError as error:
            if self._forecast is None or self._forecast[2] != ahead:
                raise
            self._say(
                f"the newer forecast cannot be used, the previous one is kept: {error}", once=True
            )
            return self._forecast[1]
        name = ", ".join(named_hash(path) for path in ensemble_files(job.ensemble))
        if (before := self._memory.forecast) and before != name:
            self._say(
                f"a newer forecast: {name}, before it {before}; all observations so far are used with it"
            )
        part = None if found.region is None else found.region.to_record()
        self._remember(forecast=name, region=json.dumps(part))
        self._forecast = stamps, found, ahead
        return found

    def _answer(self) -> None:
        """Write the status page, and give new alarms."""
        wall_ns, statuses = self._clock.now_ns(), dict[str, Status]()
        for name, held in self._held.items():
            under_way = 0 <= wall_ns - held.last_ns < _UNDER_WAY_NS
            statuses[name] = status_of(held, wall_ns if under_way else None)
        if statuses != self._shown:
            again_s = max(int(self._options.interval_s), 5)
            write_pages(statuses, self._made, self._options.status, again_s)
            self._shown = statuses
        self._remember(given=standing(statuses, self._memory.given))
        for name, status in statuses.items():
            self._warn(name, status)

    def _warn(self, name: str, status: Status) -> None:
        """Give the new alarms of a vehicle."""
        for alarm in new_alarms(status, self._memory.given, name):
            self._options.tell(f"ALARM: {of_vehicle(name, alarm.kind)}: {alarm.text}")
            if self._options.command and (
                failure := notify(self._options.command, alarm_line(alarm, status, name))
            ):
                self._options.tell(failure)
                continue
            self._remember(given=(*self._memory.given, key_of(alarm, name)))

    def _say(self, text: str, once: bool = False, **changes: object) -> None:
        """Report a text and store it with other changes in one write; ``once``: unless reported recently."""
        if not once or text not in self._memory.said[-20:]:
            self._options.tell(text)
            self._remember(said=(*self._memory.said, text), **changes)

    def _remember(self, **changes: object) -> None:
        """Change the memory, in the process and on disk."""
        changed = replace(self._memory, **changes)  # type: ignore[arg-type]
        if changed != self._memory:
            self._memory = changed
            write_memory(self._options.states, changed)
