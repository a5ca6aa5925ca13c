"""The estimator: one filter for constant and changing currents.

    state = estimator.initial() state = estimator.predict(state, time_ns) state, outcomes = estimator.assimilate(state, block) flow =
    estimator.flow(state)

States are immutable values. The state is the posterior under the Gaussian prior; revisions of the prior by the log are applied to the
published estimate (``update/evidence.py``).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.errors import Caveat
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.process import Unknowns
from replay_kit.core.grid import Grid
from replay_kit.core.observation import Measurement
from replay_kit.estimator.interface import Estimator, Stepped
from replay_kit.estimator.state import Doubt, State, predict
from replay_kit.estimator.update.assimilate import Update, assimilate, scale_jacobian
from replay_kit.estimator.update.columns import Column, Observer
from replay_kit.estimator.update.evidence import CENTRED, SCALED
from replay_kit.estimator.update.grouping import Grouping
from replay_kit.estimator.update.innovations import misfits, outcomes
from replay_kit.estimator.update.revision import FAR, Evidence, with_decisions
from replay_kit.estimator.update.screening import Screened, screened

# Columns whose products with the covariance are computed together.
_TOGETHER = 16
# Share of the shortest decorrelation time that a block may span: its rows count at its mean time, without the noise in between. Of a sum
# over a path, which is surer than a profile, that noise would count: it is a block of its own.
_SPAN = 0.001
# Observations late by no more count at the state's time: pings wait for the position after them, other measurements do not.
_LATE_NS = 1_200_000_000_000
_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class ReducedBasisEstimator(Estimator[State]):
    """2.5D estimator for both presets, constant or changing in time.

    Attributes:
        observer: Observation operator with basis, process and representation error.
        evidence: Revision of the prior by the log; None for a fixed prior.
        probability: Probability that valid measurements exceed the gate; None accepts all with their stated errors.
        time_ns: Time of the forecast [ns, UTC].
        grouping: Rule for combining profiles; None for no groups.
        made: Notes on the prior for the user.
    """

    observer: Observer
    evidence: Evidence | None
    probability: float | None
    time_ns: int | None
    grouping: Grouping | None = None
    made: tuple[str, ...] = ()

    supports_path_means = True
    block_size = _TOGETHER

    @property
    def grid(self) -> Grid:
        """Grid of the region."""
        return self.observer.basis.grid

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return self.observer.size

    def notes(self) -> list[str]:
        """Return notes on the prior for the user."""
        return list(self.made)

    def usable(self, observation: Measurement) -> bool:
        """Return whether a measurement has a usable value."""
        ((group,), _) = screened([observation], self.grid)
        return group.is_used

    def innovation(self, state: State, event: Measurement) -> Array:
        """Return measured minus predicted, shape (n, 2) [m/s], local axes; unusable values are NaN, or 0 in a group."""
        (group,), _ = screened([event], self.grid)
        columns = self.observer.columns([group])
        if not columns:
            return np.full((group.flags.size, 2), 0.0 if len(group.flags) > 1 else np.nan)
        return self._against(group, columns[0], state)

    def _against(self, group: Screened, column: Column, state: State) -> Array:
        """Return measured minus predicted values of a group for an earlier state."""
        seconds = 0.0 if state.time_ns is None else max(column.time_ns - state.time_ns, 0) / _NS
        return misfits(
            group, column, column.design @ (np.exp(-seconds / self.observer.tau) * state.x)
        )

    def initial(self) -> State:
        """Return the state before any observation."""
        begun = State.initial(self.observer.size)
        doubted = self.evidence is not None and self.probability is not None
        return replace(begun, doubt=Doubt()) if doubted else begun

    def predict(self, state: State, time_ns: int) -> State:
        """Return the state at a later time [ns, UTC] without observations; unchanged for an earlier time."""
        return predict(state, self.observer.tau, time_ns)

    def assimilate(
        self, state: State, block: Sequence[Measurement]
    ) -> tuple[State, list[Stepped[State]]]:
        """Return the state after measurements, and the outcome of each; several for a partly used group.

        Args:
            state: State before them.
            block: Measurements in order, grouped by ``grouping``; a constant estimate depends on the division only by rounding.
        """
        found, now = list[Stepped[State]](), state
        for groups, columns, updates, after in self.blocks(state, block):
            made = iter(zip(columns, updates, strict=True))
            for group in groups:
                update, against = None, None
                if group.is_used:
                    column, update = next(made)
                    against = partial(self._against, group, column)
                found += outcomes(group, update, now, against)
                now = found[-1].after
            found[-1], now = found[-1]._replace(after=after), after
        return now, found

    def blocks(
        self, state: State, block: Sequence[Measurement]
    ) -> Iterator[tuple[list[Screened], list[Column], list[Update], State]]:
        """Yield groups that are assimilated together, their columns and updates, and the state after them."""
        # whether one that comes late counts depends on the state that it meets
        ends = [i for i in range(1, len(block)) if block[i].time_ns < block[i - 1].time_ns]
        for begin, end in pairwise([0, *ends, len(block)]):
            state, waiting = self._screened(state, block[begin:end])
            while waiting:
                n = self._batch_length(state, waiting)
                some, waiting = waiting[:n], waiting[n:]
                columns = self.observer.columns(some, state.revised)
                after, updates = self._assimilated(state, columns)
                if after.profiles == state.profiles:
                    # also the time stays: an earlier measurement may still come
                    after = state
                after = with_decisions(state, after, updates)
                if self.evidence is not None and columns:
                    after = self.evidence.revised(state.profiles, after, self.observer.columns)
                state = after
                yield some, columns, updates, state

    def _screened(self, state: State, block: Sequence[Measurement]) -> tuple[State, list[Screened]]:
        """Return measurements after screening, and the state with the last one."""
        # a state without a time is before all, and of a constant current none is late
        earliest = -np.inf
        if state.time_ns is not None and np.isfinite(self.observer.tau).any():
            earliest = state.time_ns - _LATE_NS
        groups, last = screened(block, self.grid, state.last, earliest)
        measured, levels = state.measured, self.grid.levels
        for group in groups:
            if group.is_used and (measured is None or not measured.all()):
                depth = np.where(group.used, group.columns["depth"], np.nan)[group.at]
                first, end = (
                    np.abs(levels - extreme(depth, axis=1)[:, None]).argmin(axis=1)[:, None]
                    for extreme in (np.nanmin, np.nanmax)
                )
                number = np.arange(levels.size)
                now = ((number >= first) & (number <= end)).any(axis=0)
                measured = now if measured is None else measured | now
        if last is not state.last:
            state = replace(state, last=last, measured=measured)
        return state, groups

    def _batch_length(self, state: State, waiting: list[Screened]) -> int:
        """Return the number of groups that are assimilated together."""
        most, tau = _TOGETHER, self.observer.tau
        if self._has_scale_error or state.doubt is not None:
            return 1
        if self.evidence is not None:
            # the prior is looked at after numbers of profiles, however the log is cut
            counts = (*SCALED, CENTRED, state.profiles + most)
            most = min(count for count in counts if count > state.profiles) - state.profiles
        if np.isfinite(tau).any():
            latest = waiting[0].columns["time"][0] + _SPAN * float(tau.min()) * _NS
            for i, group in enumerate(waiting[:most]):
                if group.columns["time"][0] > latest or not group.at_one_place:
                    return max(i, 1)
        return most

    def _assimilated(self, state: State, columns: list[Column]) -> tuple[State, list[Update]]:
        """Return the state after columns, at the time of the last or, for a changing current, their mean time; and the updates."""
        tau, times = self.observer.tau, [column.time_ns for column in columns]
        if not columns:
            return state, []
        if np.isfinite(tau).any():
            middle = times[0] + sum(time - times[0] for time in times) // len(times)
            state = self.predict(state, middle)
            now = middle if state.time_ns is None else state.time_ns
            # of unknowns at another time a column knows less by what they decay in between
            seconds = [abs(now - time) / _NS for time in times]
            columns = [
                replace(column, design=column.design * np.exp(-away / tau))
                for column, away in zip(columns, seconds, strict=True)
            ]
            after, updates = assimilate(state, columns, self.probability)
        else:
            after, updates = assimilate(state, columns, self.probability)
            latest = state.time_ns
            for i, update in enumerate(updates):
                assert update.after is not None
                if update.judgements.accepted.any():
                    latest = times[i] if latest is None else max(latest, times[i])
                updates[i] = replace(update, after=replace(update.after, time_ns=latest))
            after = replace(after, time_ns=latest)
        if self._has_scale_error:
            (update,) = updates
            after = replace(after, x=after.x - after.products(self.gradient(update)[None])[0])
            updates = [replace(update, after=after)]
        return after, updates

    @property
    def _has_scale_error(self) -> bool:
        return self.observer.extras is not None and "scale" in self.observer.extras.names

    def gradient(self, update: Update) -> Array:
        """Return the gradient in the unknowns, shape (k,), of a scale error's Jacobian after an update."""
        out, extras = np.zeros(self.observer.size), self.observer.extras
        if extras is not None and self._has_scale_error:
            at = extras.names.index("scale") - len(extras.names)
            out[at] = extras.std[at] * scale_jacobian(update)
        return out

    # ---- what is published

    def flow(self, state: State) -> FlowEstimate:
        """Return the current estimate of a state at its time; the standard error is computed on demand."""
        basis, observer, extras = self.observer.basis, self.observer, self.observer.extras
        slow, known = slice(0, observer.process.size), None
        x, p, scale = (
            (state.x, state.covariance, 1.0)
            if self.evidence is None
            else self.evidence.published(state)
        )
        if extras is not None and state.time_ns is not None:
            known = extras.known(state.x[slow.stop :], self.grid.levels, state.time_ns)
        unknowns = Unknowns(
            observer.process,
            basis.offset,
            x[slow],
            p[slow, slow],
            state.time_ns,
            observer.error(state.scale),
            scale,
            known,
            None if observer.stated_std is not None else state.measured,
        )
        at = self._time(state)
        return FlowEstimate(
            basis.grid,
            basis.horizontal,
            basis.depth_functions,
            unknowns.latent(basis.modes, at),
            basis.modes,
            None if state.time_ns is None and self.time_ns is None else at,
            unknowns,
            basis.potential,
        )

    def remarks(self, state: State) -> list[str]:
        """Return notes on estimated instrument errors."""
        extras, found = self.observer.extras, list[str]()
        shown = 1.0 if self.evidence is None else self.evidence.shown(state)
        if state.scale != 1.0 or shown > FAR:
            words = f"the variance of the ensemble was multiplied by {float(f'{shown:.2g}'):g}, as the measurements show"
            hardly = Caveat(f"{words}; the ensemble hardly covers this current")
            found.append(hardly if shown > FAR else words)
        if further := state.revised.further:
            words = f"measurements err by {100.0 * further:.0f} cm/s more than stated, as by tides"
            found.append(Caveat(words))
        if extras is None:
            return found
        last = slice(self.observer.size - extras.std.size, None)
        std = np.sqrt(np.diag(state.covariance)[last])
        return found + extras.remarks(state.x[last], std)

    def _time(self, state: State) -> int:
        at = self.time_ns if state.time_ns is None else state.time_ns
        return int(self.observer.process.times_ns[0]) if at is None else at
