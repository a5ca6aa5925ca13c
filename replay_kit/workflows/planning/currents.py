"""Current during a mission: an estimate that evolves, files of several times, or one time held constant."""

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from math import ceil, inf, log
from pathlib import Path

import numpy as np

from planners.request import MissionPlan
from planners.simulation.currents import Flow, Sample, graph_key, is_noticed, with_local
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.local import LocalCurrent, Oscillation
from replay_kit.core.flow.process import Process
from replay_kit.core.words.text import time_text

_NS = 1_000_000_000
# Days from the one time of a current within which a mission may begin: a month later its eddies are others.
_DAYS_HELD = 30
# Flows of an estimate that changes come in multiples of this number of steps: a program serves all sequences of one length.
_STEPS = 4
# Flows in each period of an oscillation.
_A_PERIOD = 8
# In a current that changes for longer a mission may take more time, and samples of it do.
_LONGER = 1.25
# Half the distance, in kernel lengths, over which the current's rotation is taken.
_STENCIL = 0.05


@dataclass(frozen=True, eq=False)
class KnownCurrent:
    """Knowledge of the current during a mission.

    Attributes:
        estimates: One estimate, or several in order of time.
        flow_step: Time between the flows of a changing estimate [s].
        fixes: Time of the last fix of each vehicle [ns, UTC], empty name for a single one; empty for a pure estimate.
    """

    estimates: tuple[FlowEstimate, ...]
    flow_step: float
    fixes: Mapping[str, int] = field(default_factory=dict)

    @property
    def first(self) -> FlowEstimate:
        """The only or earliest estimate."""
        return self.estimates[0]

    @property
    def _only(self) -> FlowEstimate | None:
        return self.first if len(self.estimates) == 1 and self.first.time_ns is not None else None

    @property
    def process(self) -> Process | None:
        """Process of the only estimate; None if it is static or there are several."""
        if (flow := self._only) is None or flow.process is None:
            return None
        last_ns = flow.last_observation_ns
        return flow.process if last_ns is None else flow.process.since(last_ns)

    @cached_property
    def changes(self) -> bool:
        """Whether the current changes in time."""
        return len(self.estimates) > 1 or is_noticed(self.local) or self.process is not None

    @property
    def ends_ns(self) -> int | None:
        """Last time of the forecast [ns, UTC]; None if only one time is known."""
        if len(self.estimates) > 1:
            return self.estimates[-1].time_ns
        known = self.process
        return int(known.times_ns[-1]) if known is not None and known.times_ns.size > 1 else None

    @property
    def local(self) -> LocalCurrent | None:
        """Local correction to the only estimate from the dives so far."""
        return None if self._only is None else self._only.local

    def begin(self, asked_ns: int | None, vehicle: str = "") -> tuple[int, tuple[str, ...]]:
        """Return the start of a mission [ns, UTC], 0 without times, and notes on it.

        Args:
            asked_ns: Requested start [ns, UTC]; None for the time of the last fix, or else of the estimate.
            vehicle: Name; of one that is not known the latest fix of all counts.

        Raises:
            PlanError: The forecast does not cover the requested time.
        """
        if asked_ns is not None:
            self.check_time("--start-time", asked_ns)
            return asked_ns, ()
        fix_ns = self.fixes.get(vehicle, max(self.fixes.values(), default=None))
        what, known = (
            ("last fix", fix_ns) if fix_ns is not None else ("estimate", self.first.time_ns)
        )
        if known is None:
            return 0, ()
        told = f"it begins at {time_text(known)}, the time of the {what}; --start-time sets another"
        return known, (told,)

    def flow(self, begin_ns: int, seconds: float) -> Flow:
        """Return the current for planners: one constant flow, or flows at increasing times.

        Args:
            begin_ns: Start of the period [ns, UTC].
            seconds: Length of the period [s]; afterwards the last flow holds.
        """
        if len(self.estimates) > 1:
            return self.estimates
        if not self.changes:
            return self.first
        # a step may begin before the estimate: what is known is then that of its time, in the forecast of the step's beginning
        first = self.first
        return [
            _with(
                first.moved(time) if first.unknowns else replace(first, time_ns=time),
                self._beside(time),
            )
            for time in self._times(begin_ns, seconds)
        ]

    def longer(self, begin_ns: int, seconds: float, plans: Sequence[MissionPlan]) -> float:
        """Return the period [s] that ``flow`` needs for plans that last longer than it changes; 0 where it needs no other.

        Args:
            begin_ns: See ``flow``.
            seconds: See ``flow``.
            plans: Missions planned in it.
        """
        lasts = max((one.start_time_ns - begin_ns) / _NS + one.duration for one in plans)
        until = self._times(begin_ns, seconds)[-1]
        ends = min(begin_ns + lasts * _NS, self.ends_ns or inf)
        changes = self.changes and len(self.estimates) == 1
        return _LONGER * lasts if changes and ends > until else 0.0

    def samples(self, begin_ns: int, seconds: float, count: int, seed: int) -> Sequence[Sample]:
        """Return samples of the current: time-dependent for a changing estimate, otherwise constant.

        If the local correction is known, each includes a time course of its deviation from that in ``flow``.

        Args:
            begin_ns: See ``flow``.
            seconds: See ``flow``.
            count: Number of samples.
            seed: Seed of the draws.
        """
        if count == 0:
            return ()
        times, first, drawn = self._times(begin_ns, seconds), self.first, list[Flow]()
        if self.process is None:
            beside = self._beside(times[0])
            drawn += [_with(one, beside) for one in first.sample(count, seed)]
        else:
            times = [max(time_ns, first.time_ns or 0) for time_ns in times]
            each = [self._beside(time) for time in times]
            drawn += [[*map(_with, one, each)] for one in first.sample_through(times, count, seed)]
        if self.local is None:
            return drawn
        return with_local(drawn, self.local, begin_ns, seconds, seed)

    @property
    def oscillation(self) -> Oscillation | None:
        """Oscillation in addition to the slow current of the only estimate."""
        return self.first.oscillation if len(self.estimates) == 1 else None

    @property
    def _step(self) -> float:
        """Longest time between flows [s]; linear interpolation of an oscillation errs by at most 8 % of its amplitude."""
        return (
            self.flow_step
            if self.oscillation is None
            else min(self.flow_step, self.oscillation.shortest_period / _A_PERIOD)
        )

    def _times(self, begin_ns: int, seconds: float) -> list[int]:
        """Return times [ns, UTC] that cover a mission: those of the forecast, where it bends, and evenly spaced ones between and beyond."""
        step, ends = round(self._step * _NS), begin_ns + round(seconds * _NS)
        known = [begin_ns] if self.process is None else [*map(int, self.process.times_ns)]
        times = [*range(known[0] + min((begin_ns - known[0]) // step, 0) * step, known[0], step)]
        for last, time in pairwise(known):
            parts = ceil((time - last) / step)
            times += [last + (time - last) * part // parts for part in range(parts)]
        times += range(known[-1], max(ends, known[-1]) + _STEPS * step + 1, step)
        times = times[bisect_right(times, begin_ns) - 1 :]
        steps = max(ceil(bisect_left(times, ends) / _STEPS), 1)
        return times[: _STEPS * steps + 1]

    @cached_property
    def _uniform(self) -> Array:
        """Latent values of uniform currents of 1 m/s towards local east and north, shape (M, 2)."""
        # loads slowly, and a current without others beside it needs none
        from replay_kit.estimator.basis.embedding import embed

        flow, nugget = self.first, EstimatorConfig().nugget
        both = np.repeat(np.eye(2), len(flow.nodes), axis=0)
        return embed(flow.horizontal, flow.nodes, both, nugget)

    def _beside(self, time_ns: int) -> Array | float:
        """Return the latent values of currents added to the slow current at a time [ns, UTC], shape (M, Z) or (M, 1); 0 without."""
        added = (
            0.0 if self.oscillation is None else self._uniform @ self.oscillation.velocity(time_ns)
        )
        if self.local is None or not is_noticed(self.local):
            return added
        return added + self._uniform @ self.local.velocity(time_ns)[:, None]

    def check_time(self, name: str, time_ns: int) -> None:
        """Raise PlanError for a time [ns, UTC] outside the forecast; ``name`` is that of the option.

        A single known time is held constant for a limited number of days; without times any time is accepted.
        """
        known, last = self.first.time_ns, self.ends_ns
        if known is None:
            return
        held = _DAYS_HELD * 86_400 * _NS
        # from its last fix on a vehicle can be told where to go, also where dead reckoning went on
        since = min([known, *self.fixes.values()])
        begins, ends = (known - held, known + held) if last is None else (since, last)
        if begins <= time_ns <= ends:
            return
        within = (
            "the forecast"
            if last is not None
            else f"{_DAYS_HELD} days of the only time that is known, {time_text(known)}"
        )
        raise PlanError(
            f"{name}: expected a time within {within}, {time_text(begins)} to {time_text(ends)}, got {time_text(time_ns)}; choose a time "
            "between, or give the estimate of a longer forecast"
        )

    def notes(self, begin_ns: int, end_ns: int) -> tuple[str, ...]:
        """Return notes on the parts of a mission [ns, UTC] outside the known times; empty if a forecast covers it."""
        last = self.ends_ns
        if last is None:
            return (self._one_time_note(),)
        if (over := (end_ns - max(last, begin_ns)) / 3.6e12) <= 0.0:
            return ()
        return (
            f"the forecast ends at {time_text(last)}, {over:.1f} h before the mission does: from there the current is held constant",
        )

    def _one_time_note(self) -> str:
        hours = self.hours_known
        when = (
            "a time that is not stated"
            if self.first.time_ns is None
            else time_text(self.first.time_ns)
        )
        if self.process is not None:
            return f"after {when} the estimate returns to the forecast; beyond {hours:.0f} h this is a guess"
        if not np.isfinite(hours):
            return (
                f"the current is frozen at {when}; for how long is unknown, as it has no vorticity"
            )
        return (
            f"the current is frozen at {when}; beyond {hours:.0f} h this is a guess: the ensemble's rate of change "
            "is unknown, and its eddies turn by one radian in that time"
        )

    @property
    def hours_known(self) -> float:
        """Time after which a current of a single time is a guess [h].

        With a known rate of change, the time at which the correlation with the observations is a half: later the frozen current errs more
        than the ensemble mean. Otherwise the turnover time of the eddies, 1 over the root mean square of
        the vorticity (Vallis 2017, Atmospheric and Oceanic Fluid Dynamics, chapter 11).
        """
        if self.process is not None:
            return float(self.process.tau.min()) * log(2.0) / 3600.0
        rotation = float(np.sqrt(np.mean(_vorticity(self.first) ** 2)))
        return 1.0 / (3600.0 * rotation) if rotation > 1e-9 else inf


def known_current(files: Sequence[tuple[Path, FlowEstimate]], flow_step: float) -> KnownCurrent:
    """Return the current of the estimates in files, several in order of time.

    Args:
        files: Files with their estimates.
        flow_step: Time between the flows of a changing estimate [s].

    Raises:
        PlanError: A file's time is missing or not after the one before, or its region, levels or functions differ from the first.
    """
    for (earlier, before), (path, flow) in pairwise(files):
        if before.time_ns is None or flow.time_ns is None or flow.time_ns <= before.time_ns:
            raise PlanError(
                f"{path}: expected a time after that of {earlier}, {time_text(before.time_ns)}, got {time_text(flow.time_ns)}; give the "
                "files in the order of their times, each time once"
            )
        if graph_key(flow) != graph_key(files[0][1]):
            raise PlanError(
                f"{path}: expected the region, levels and functions of {files[0][0]}, {files[0][1].grid}, got {flow.grid}; give "
                "estimates of one forecast and region"
            )
    return KnownCurrent(tuple(flow for _, flow in files), flow_step)


def _with(flow: FlowEstimate, added: Array | float) -> FlowEstimate:
    """Return an estimate with more latent values."""
    return replace(flow, latent=flow.latent + added)


def _vorticity(flow: FlowEstimate) -> Array:
    """Return the vorticity dv/dx - du/dy at the nodes of each level, shape (N, Z) [1/s]."""
    kernel, (east, north) = flow.horizontal.kernel, (values[:, None] for values in flow.nodes.T)
    dx, dy = _STENCIL * kernel.length_east, _STENCIL * kernel.length_north

    def slope(across: float, along: float, part: int) -> Array:
        """Return the central difference of a component along one axis."""
        more, less = (
            flow.velocity(east + sign * across, north + sign * along, flow.levels)[..., part]
            for sign in (1.0, -1.0)
        )
        return np.asarray((more - less) / (2.0 * (across + along)))

    return slope(dx, 0.0, 1) - slope(0.0, dy, 0)
