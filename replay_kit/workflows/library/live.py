"""Live interface: a replay fed by a vehicle's own program, message by message or in blocks of any size.

    now = rk.live("ensemble.nc")
    for message in source:
        now.feed([message])
    now.estimate.velocity_at(152.6, -40.0, 150.0)

After the same messages the estimate equals that of a replay, bit for bit. ``now.messages`` counts messages by topic and reason.
"""

# keeps the signatures in help() short: the names of types, not what they stand for
from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from threadpoolctl import ThreadpoolController

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError, Finding
from replay_kit.core.files.paths import Paths
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.message import Message
from replay_kit.core.observation import VehicleState
from replay_kit.core.plan import Place, Plan
from replay_kit.core.words.progress import Stopwatch
from replay_kit.measurements.step import for_region
from replay_kit.workflows.library.calls import (
    At,
    Forecast,
    Settings,
    forecast_files,
    place_of,
    planned,
    settings_of,
)
from replay_kit.workflows.replay.account import LATE
from replay_kit.workflows.replay.consistency import checked_speeds
from replay_kit.workflows.replay.inputs.forecast import build, read_forecasts
from replay_kit.workflows.replay.inputs.planner import PlanQuery
from replay_kit.workflows.replay.run import END, Run, follow_up
from replay_kit.workflows.replay.surfacings import forecast_end
from replay_kit.workflows.replay.vehicle import Setup


def live(ensemble: Forecast, *, settings: Settings = None) -> Live:
    """Return an estimate that is updated by feeding messages.

    Args:
        ensemble: The forecast, see ``replay``. The whole region is used, or ``forecast.region``.
        settings: See ``replay``.

    Raises:
        ReplayKitError: The forecast cannot be used, or a setting is wrong.
    """
    with forecast_files(ensemble, settings_of(settings)) as held:
        return Live(held.forecast_paths(ensemble), held.config)


class Live:
    """Estimate of the current from the messages so far; only ``feed`` changes it."""

    def __init__(self, ensemble: Paths, config: RunConfig) -> None:
        """Read the forecast and build its prior."""
        self._threads = ThreadpoolController()
        forecasts = read_forecasts(ensemble, config, None, None)
        speeds = checked_speeds(forecasts.ensemble, config)
        with self._threads.limit(limits=config.output.threads):
            setup = Setup(build(forecasts, config), config, speeds=speeds)
        self._run = Run([setup], for_region(config, forecasts.ensemble).measurements, Stopwatch())
        self._run.follow_up = follow_up
        self._late, self._latest_ns = Counter[tuple[str, str]](), 0

    def feed(self, messages: Iterable[Message], *, last: bool = False) -> None:
        """Assimilate messages, in order of time; one older than its predecessors by more than ``logs.reorder_window`` is excluded.

        Args:
            messages: One or more messages.
            last: Whether these are the last messages; pings waiting for a position are then processed without it.

        Raises:
            ConfigError: They are no messages.
            MeasurementError: Messages are unusable, or contradict each other and ``consistency.on_failure`` is ``stop``.
        """
        given, block = list(messages), list[Message]()
        if foreign := {type(one).__name__ for one in given if not isinstance(one, Message)}:
            raise ConfigError(f"feed: expected a list of Message, it holds {', '.join(foreign)}")
        window_ns = self._run.config.logs.reorder_window * 1e9
        for one in given:
            if one.time_ns < self._latest_ns - window_ns:
                self._late[one.topic, LATE] += 1
            else:
                block.append(one)
                self._latest_ns = max(self._latest_ns, one.time_ns)
        if last:
            block.append(Message(self._latest_ns, "", END, {}, 0, 0))
        with self._threads.limit(limits=self._run.config.output.threads):
            self._run.take(block)

    @property
    def estimate(self) -> FlowEstimate:
        """Estimate at the time of the last message, including observations that wait for their group."""
        with self._threads.limit(limits=self._run.config.output.threads):
            return self._run.finished().flow_now()

    @property
    def messages(self) -> dict[tuple[str, str], int]:
        """Number of messages so far by topic and reason for exclusion, which is empty for used ones."""
        return dict(self._run.vehicles[0].counts.messages) | self._late

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Contradictions found so far."""
        return self._run.vehicles[0].monitoring.findings

    @property
    def position(self) -> VehicleState | None:
        """Last position of the vehicle; None before the first."""
        with self._threads.limit(limits=self._run.config.output.threads):
            return self._run.finished().vehicles[0].counts.last_position

    def plan(self, goal: At, *, start: At | None = None) -> Plan:
        """Return the best plan to a goal on the present estimate, as a replay of these messages ends with.

        A glider, a vehicle with mean currents of dives or dives at a glider's speed, is given a mission of dives as flown so far.

        Args:
            goal: Goal.
            start: Start position; None for the last position.

        Raises:
            ConfigError: Neither a start nor a position is known.
            PlanError: Start or goal is outside the region or on land.
        """
        if start is None:
            if (at := self.position) is None:
                raise ConfigError("start: expected a place, as no message had a position, got none")
            start = Place(at.longitude, at.latitude, at.depth)
        with self._threads.limit(limits=self._run.config.output.threads):
            run = self._run.finished()
            estimate = run.flow_now()
            # the last dive has ended
            known = forecast_end(run.vehicles[0].forecasts)
            query = PlanQuery(
                place_of(start, "start"), place_of(goal, "goal"), estimate.time_ns or 0
            )
            flown = known.as_flown
            gliding = known.states_means or (flown is not None and flown.is_plausible)
            return planned(estimate, query, run.config.planner.resolved(gliding), flown)
