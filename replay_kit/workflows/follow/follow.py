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
from replay_kit.core.files.inputs import stamps_of
from replay_kit.core.plan import Place
from replay_kit.core.words.text import count_text, place_text
from replay_kit.estimator import Estimator
from replay_kit.forecast import ensemble_files
from replay_kit.logs.opening import may_grow
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.reader import ResultReader
from replay_kit.show.status.held import Held
from replay_kit.show.status.status import Status, status_of
from replay_kit.workflows.follow.watch import (
    Clock,
    FollowOptions,
    alarm_line,
    key_of,
    look,
    look_again,
    new_alarms,
    notify,
    read_goal,
    read_memory,
    standing_alarms,
    with_goal,
    with_vehicle_name,
    write_memory,
)
from replay_kit.workflows.replay.inputs.forecast import Forecasts, build
from replay_kit.workflows.replay.inputs.job import Following, ReplayJob, forecasts_of, logs_of
from replay_kit.workflows.replay.inputs.planner import PlannerFactory
from replay_kit.workflows.replay.inputs.provenance import named_hash
from replay_kit.workflows.replay.inputs.region import from_record
from replay_kit.workflows.replay.inputs.vehicles import with_vehicles
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
        clock: None for the system clock.

    Raises:
        ForecastError: It cannot be used for the first replay.
        ConfigError: An output cannot be written, another process follows into it, or the goal's file is unreadable.
    """
    if "when" not in config.planner.model_fields_set:
        planner = config.planner.model_copy(update={"when": "surfacing"})
        config = config.model_copy(update={"planner": planner})
    follower = Follower(job, config, planner_of, options, clock or Clock())
    try:
        with claimed(options.states / "lock", follower.out):
            return follower.run()
    except KeyboardInterrupt:
        # the result of the replay before is whole
        part_of(follower.out).unlink(missing_ok=True)
        raise


class Follower:
    """State of a followed mission; mutable, changes with each look.

    Attributes:
        out: File of the result.
    """

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
        self.out, self._job, self._config, self._planner_of = job.out, job, config, planner_of
        self._options, self._clock, self._tell = options, clock, options.tell
        self._memory = read_memory(options.states)
        self._good = set(self._memory.used)
        # stamps of the forecast's files and the beginning of the logs, the forecast, and the estimator once it is built
        self._forecast: tuple[Any, Forecasts] | None = None
        self._built: Estimator[Any] | None = None
        self._held, self._shown, self._due = dict[str, Held](), dict[str, Status](), False
        self._made: Outcome | None = None
        if self._good and self.out.is_file():
            reader = ResultReader(self.out)
            self._held, self._made = read_each(reader), reader.outcome
        self._set_goal(job.goal if options.goal_file is None else read_goal(options.goal_file))

    def run(self) -> Outcome | None:
        """Look and replay until the logs have not grown for long enough."""
        limit, between = self._options.until_idle_s, self._options.interval_s
        if limit is not None:
            between = min(between, max(limit, 0.01))
        first, idle_since = True, self._clock.idle_s()
        while True:
            if self.poll(first):
                idle_since = self._clock.idle_s()
            first = False
            if limit is not None and self._clock.idle_s() - idle_since >= limit:
                return self._made
            self._clock.wait(between)

    def poll(self, always: bool = False) -> bool:
        """Look once, and return whether the inputs changed.

        Args:
            always: Replay even without a change.
        """
        moved, changed = self._look_at_goal(), self._look_at_files()
        if (moved or changed or always or self._due) and self._memory.used:
            self._replay()
        elif always:
            self._tell("waiting for a log")
        if self._held:
            self._answer()
        return moved or changed

    def _look_at_files(self) -> bool:
        """Examine changed files, and return whether the set of used files changed."""
        job, options, known = self._job, self._options, self._memory.sources
        written = (options.report, options.goal_file, job.netcdf, job.save_estimate)
        ours = [self.out, options.states, options.status, *ensemble_files(job.ensemble)]
        looked = partial(look, job.logs, [*ours, *filter(None, written)])
        about = self._config.logs, self._clock, options.interval_s, self._vehicle_of
        sources, said, changed = look_again(looked, known, *about)
        for text in said:
            self._tell(text)
        self._remember(sources=sources, said=(*self._memory.said, *said))
        return changed

    def _vehicle_of(self, path: Path) -> str:
        """Return the vehicle under whose name a file or its folder is followed; empty without a name."""
        each = self._job.vehicles
        return next((one.name for one in each if {path, path.parent} & {*one.logs}), "")

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
        before, last_ns = self._memory.goals, [held.last_ns for held in self._held.values()]
        goals = with_goal(before, goal, max(last_ns, default=0))
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
        whole = [path for path in used if not may_grow(path)]
        whole += ensemble_files(self._job.ensemble)
        stamps = stamps_of(whole)
        try:
            made = self._run(used)
        except ReplayKitError as error:
            if stamps_of(whole) != stamps:
                self._due = True
                self._tell(f"a file changed while it was read; it is read again: {error}")
            elif isinstance(error, _UNUSABLE):
                self._without_new(used, error)
            elif self._held:
                self._say(f"not replayed, the previous result is kept: {error}", once=True)
            else:
                raise
            return
        each = made.vehicles.values() or (made,)
        dives = count_text(sum(len(one.by_dive) for one in each), "dive")
        files, took = count_text(len(self._memory.used), "file"), self._clock.idle_s() - began
        self._tell(f"{files}, {dives} replayed in {took:.1f} s: {self.out}")

    def _without_new(self, used: tuple[Path, ...], error: ReplayKitError) -> None:
        """Replay without the new files that made a replay fail, found one by one; the first files of a mission are awaited instead."""
        fresh = [path for path in used if path not in self._good]
        if not self._good or not fresh:
            self._say(f"not replayed: {error}", once=True)
            return
        for path in fresh:
            try:
                self._run(tuple(other for other in used if other in self._good or other == path))
            except _UNUSABLE as reason:
                why = f"makes the replay fail: {reason}"
                source = replace(self._memory.sources[path], aside=why)
                sources = {**self._memory.sources, path: source}
                self._say(f"{path.name} not used: it {why}", sources=sources)

    def _run(self, used: tuple[Path, ...]) -> Outcome:
        """Replay files, and read the status of the result."""
        vehicle_of, goals = {path: self._vehicle_of(path) for path in used}, self._memory.goals
        vehicles = tuple(
            replace(one, logs=tuple(path for path in used if vehicle_of[path] == one.name))
            for one in self._job.vehicles
            if one.name in vehicle_of.values()
        )
        goal = goals[0][1] if goals else None
        job = replace(self._job, logs=used, vehicles=vehicles, goal=goal, overwrite=True)
        job = with_vehicles(job, self._config)
        forecasts = self._forecasts(job)
        said = (self._without_folders(text) for text in self._memory.said)
        record = {f"{number:03d}": text for number, text in enumerate(said)}
        job = replace(
            job,
            following=Following(self._options.states, record, goals[1:]),
            estimator=partial(self._estimator, len(job.each_vehicle)),
            tell=self._tell,
        )
        made, _ = replay(job, self._config, self._planner_of, forecasts=forecasts)
        self._made, self._held = made, read_each(ResultReader(self.out))
        self._good |= set(used)
        if self._options.report is not None:
            report(self.out, self._options.report, overwrite=True, made=made)
        return made

    def _estimator(self, vehicles: int, forecasts: Forecasts, config: RunConfig) -> Estimator[Any]:
        """Return the estimator of a forecast, built once for all replays until the forecast changes."""
        if self._built is None:
            self._built = build(forecasts, config, vehicles)
        return self._built

    def _without_folders(self, text: str) -> str:
        """Return a text with file names without folders, so that a result does not depend on the folder of its inputs."""
        goal = filter(None, [self._options.goal_file])
        for path in (*self._memory.sources, *ensemble_files(self._job.ensemble), *goal):
            text = text.replace(str(path), path.name)
        return text

    def _forecasts(self, job: ReplayJob) -> Forecasts:
        """Return the forecast, read again when its files or the beginning of the logs changed."""
        files, before, memory = ensemble_files(job.ensemble), self._forecast, self._memory
        stamps, ahead = stamps_of(files), logs_of(job, self._config).ahead()
        if before is not None and before[0] == (stamps, ahead):
            return before[1]
        try:
            # found from the first files, it does not change: states depend on it
            record = json.loads(memory.region or "null")
            region = None if record is None else from_record(record)
            found = forecasts_of(replace(job, region=region), self._config)
        except ReplayKitError as error:
            if before is None or before[0][1] != ahead:
                raise
            self._say(
                f"the newer forecast cannot be used, the previous one is kept: {error}", once=True
            )
            return before[1]
        name = ", ".join(map(named_hash, files))
        if memory.forecast and memory.forecast != name:
            self._say(
                f"a newer forecast: {name}, before it {memory.forecast}; all observations so far are used with it"
            )
        part = None if found.region is None else found.region.to_record()
        self._remember(forecast=name, region=json.dumps(part))
        self._forecast, self._built = ((stamps, ahead), found), None
        return found

    def _answer(self) -> None:
        """Write the status page, and give new alarms."""
        wall_ns, statuses, options = self._clock.now_ns(), dict[str, Status](), self._options
        for name, held in self._held.items():
            under_way = 0 <= wall_ns - held.last_ns < _UNDER_WAY_NS
            statuses[name] = status_of(held, wall_ns if under_way else None, name)
        if statuses != self._shown:
            write_pages(statuses, self._made, options.status, max(int(options.interval_s), 5))
            self._shown = statuses
        self._remember(given=standing_alarms(statuses, self._memory.given))
        for name, status in statuses.items():
            for alarm in new_alarms(status, self._memory.given, name):
                self._tell(f"ALARM: {with_vehicle_name(name, alarm.kind)}: {alarm.text}")
                line = alarm_line(alarm, status, name)
                if options.command and (failure := notify(options.command, line)):
                    self._tell(failure)
                else:
                    self._remember(given=(*self._memory.given, key_of(alarm, name)))

    def _say(self, text: str, once: bool = False, **changes: object) -> None:
        """Report a text and store it with other changes in one write; ``once``: unless reported recently."""
        if not once or text not in self._memory.said[-20:]:
            self._tell(text)
            self._remember(said=(*self._memory.said, text), **changes)

    def _remember(self, **changes: object) -> None:
        """Change the memory, in the process and on disk."""
        changed = replace(self._memory, **changes)  # type: ignore[arg-type]
        if changed != self._memory:
            self._memory = changed
            write_memory(self._options.states, changed)
