"""The estimator: one filter for a current that is constant and for one that changes.

    state = estimator.initial()
    state = estimator.predict(state, time_ns)
    state, outcomes = estimator.assimilate(state, block)
    flow = estimator.flow(state)

States are immutable values. The state has the posterior under the Gaussian prior; what the log says of that prior, after few profiles above
all, is applied to what is published of it, after the rows (``update/evidence.py``).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.flow.estimate import FlowEstimate, Unknowns
from replay_kit.core.flow.local import Oscillation
from replay_kit.core.grid import Grid
from replay_kit.core.observation import Measurement
from replay_kit.estimator.interface import Estimator, Stepped
from replay_kit.estimator.prior.calibration import MembersPrior, calibration, fitted_kernels
from replay_kit.estimator.prior.factor import Parts, PriorSettings
from replay_kit.estimator.prior.fit import Members
from replay_kit.estimator.state import Doubt, State, predict
from replay_kit.estimator.update.assimilate import Update, assimilate, scale_jacobian
from replay_kit.estimator.update.columns import Column, Observer
from replay_kit.estimator.update.doubt import is_refuted, noted, rescaled
from replay_kit.estimator.update.evidence import (
    CENTRED,
    SCALED,
    Marginal,
    amplitude_mixture,
    fitted_scale,
    member_centre,
    with_marginal,
    with_mean,
    with_variance,
)
from replay_kit.estimator.update.grouping import Grouping, ProfileGroup
from replay_kit.estimator.update.innovations import misfits, outcomes
from replay_kit.estimator.update.screening import Screened, screened

# Columns whose products with the covariance are computed together.
_TOGETHER = 16
# Factor on the prior variance, or one over it, from which on the prior is changed, and not the stated errors alone.
_FAR = 3.0
# Share of the shortest decorrelation time that a block may span: its rows count at its mean time, without the noise in between. Of a sum
# over a path, which is surer than a profile, that noise would count: it is a block of its own.
_SPAN = 0.001
# Observations late by no more count at the state's time: pings wait for the position after them, other measurements do not.
_LATE_NS = 1_200_000_000_000
_NS = 1e9
_Group = tuple[Screened, ...]


# Not slotted: what members left out show is computed when first asked for.
@dataclass(frozen=True, eq=False)
class Evidence:
    """What the log may say of the prior.

    Attributes:
        parts: Which unknowns are what.
        members: The ensemble's, in few modes.
        settings: Of the prior.
        bound: Standard deviation below which directions were dropped [m/s].
        is_made: Whether the ensemble was made of other fields, whose variance is not that of a forecast.
        averages_amplitude: Whether the prior variance of the ensemble mean's amplitude is averaged over.
    """

    parts: Parts
    members: Members
    settings: PriorSettings
    bound: float
    is_made: bool
    averages_amplitude: bool

    @cached_property
    def expected(self) -> float:
        """The factor on variances that members left out show."""
        return calibration(self._prior)

    @cached_property
    def kernels(self) -> Array:
        """The probabilities of the kernels about members that members left out show, shape (H,)."""
        return fitted_kernels(self._prior)

    @cached_property
    def _prior(self) -> MembersPrior:
        return MembersPrior.of(self.members, self.settings, self.bound)


@dataclass(frozen=True, slots=True, eq=False)
class ReducedBasisEstimator(Estimator[State]):
    """The 2.5D estimator, in both presets, constant or through time.

    Attributes:
        observer: Makes rows of measurements; has the basis, the process and the error of what they do not hold.
        evidence: What the log may say of the prior; None where that holds as it is.
        probability: That sound measurements exceed the gate; None accepts all with their stated errors.
        time_ns: Of the forecast [ns, UTC].
        grouping: Which profiles are combined; None combines none.
        made: Notes on how the prior was made, for the user.
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
        """The region."""
        return self.observer.basis.grid

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return self.observer.size

    def notes(self) -> list[str]:
        """Return notes on how the prior was made, for the user."""
        return list(self.made)

    def usable(self, observation: Measurement) -> bool:
        """Return whether a measurement has a value that would be used."""
        ((one,),) = screened([(observation,)], self.grid)
        return one.is_used

    def innovation(self, state: State, event: Measurement | ProfileGroup) -> Array:
        """Return measured minus predicted, shape (n, 2) [m/s], local axes; NaN, or 0 of a group, for values that are not usable."""
        events = event.profiles if isinstance(event, ProfileGroup) else (event,)
        (group,) = screened([events], self.grid)
        columns = self.observer.columns([group])
        if not columns:
            return np.concatenate([one.unused().innovation for one in group])
        return self._against(group, columns[0])(state)

    def _against(self, group: Sequence[Screened], column: Column) -> Callable[[State], Array]:
        """Return what returns measured minus predicted values of a group by an earlier state."""

        def innovation(state: State) -> Array:
            seconds = 0.0 if state.time_ns is None else max(column.time_ns - state.time_ns, 0) / _NS
            mean = column.design @ (np.exp(-seconds / self.observer.tau) * state.x)
            return misfits(group, column, mean)

        return innovation

    def initial(self) -> State:
        """Return the state before any observation."""
        begun = State.initial(self.observer.size)
        doubted = self.evidence is not None and self.probability is not None
        return replace(begun, doubt=Doubt()) if doubted else begun

    def predict(self, state: State, time_ns: int) -> State:
        """Return the state at a later time [ns, UTC] without observations in between; unchanged for an earlier time."""
        return predict(state, self.observer.tau, time_ns)

    def assimilate(
        self, state: State, block: Sequence[Measurement | ProfileGroup]
    ) -> tuple[State, list[Stepped[State]]]:
        """Return the state after measurements, and the outcome of each: several of a group where some of it is not used.

        Args:
            state: Before them.
            block: In order; groups as ``grouping`` allows. However it is cut, a constant estimate is the same to rounding.
        """
        found, now = list[Stepped[State]](), state
        for groups, columns, updates, after in self._blocks(state, block):
            made, steps = iter(zip(updates, columns, strict=True)), list[Stepped[State]]()
            for group in groups:
                used = any(one.is_used for one in group)
                update, column = next(made) if used else (None, None)
                against = None if column is None else self._against(group, column)
                steps += outcomes(group, update, now, against)
                now = steps[-1].after
            steps[-1], now = steps[-1]._replace(after=after), after
            found += steps
        return now, found

    def update(
        self, state: State, block: Sequence[Measurement | ProfileGroup]
    ) -> tuple[State, list[Update]]:
        """Return the state after measurements, and what those of each column did, as it is computed."""
        found = list[Update]()
        for _, _, updates, after in self._blocks(state, block):
            state, found = after, found + updates
        return state, found

    def _blocks(
        self, state: State, block: Sequence[Measurement | ProfileGroup]
    ) -> Iterator[tuple[list[_Group], list[Column], list[Update], State]]:
        """Yield groups that are assimilated together, the columns that they see, what these did, and the state after them."""
        # whether one that comes late counts depends on the state that it meets
        ends = [i for i in range(1, len(block)) if block[i].time_ns < block[i - 1].time_ns]
        for begin, end in pairwise([0, *ends, len(block)]):
            state, waiting = self._screened(state, block[begin:end])
            while waiting:
                some, waiting = self._together(state, waiting)
                state, columns, updates = self._block(state, some)
                yield some, columns, updates, state

    def _screened(
        self, state: State, block: Sequence[Measurement | ProfileGroup]
    ) -> tuple[State, list[_Group]]:
        """Return measurements after screening, and the state with the last one."""
        events = [item.profiles if isinstance(item, ProfileGroup) else (item,) for item in block]
        # a state without a time is before all, and of a constant current none is late
        earliest = -np.inf
        if state.time_ns is not None and np.isfinite(self.observer.tau).any():
            earliest = state.time_ns - _LATE_NS
        groups = screened(events, self.grid, state.last, earliest)
        levels, measured, last = self.grid.levels, state.measured, state.last
        for one in (one for group in groups for one in group if one.is_used):
            last = one.linear
            if measured is None or not measured.all():
                depth = last.value_depth[one.used]
                first, end = (np.abs(levels - z).argmin() for z in (depth.min(), depth.max()))
                at = np.arange(levels.size)
                now = (at >= first) & (at <= end)
                measured = now if measured is None else measured | now
        if last is not state.last:
            state = replace(state, last=last, measured=measured)
        return state, groups

    def _together(self, state: State, waiting: list[_Group]) -> tuple[list[_Group], list[_Group]]:
        """Return the groups that are assimilated together, and the rest."""
        most = _TOGETHER
        if self._scale_error is not None or state.doubt is not None:
            return waiting[:1], waiting[1:]
        if self.evidence is not None:
            # the prior is looked at after numbers of profiles, however the log is cut
            counts = (count for count in (*SCALED, CENTRED) if count > state.profiles)
            most = min(most, min(counts, default=most + state.profiles) - state.profiles)
        tau = self.observer.tau
        if np.isfinite(tau).any():
            latest = waiting[0][0].event.time_ns + _SPAN * float(tau.min()) * _NS
            ends = (
                i
                for i, each in enumerate(waiting)
                if each[0].event.time_ns > latest or not each[0].linear.at_one_place
            )
            most = min(most, next(ends, most))
        return waiting[: max(most, 1)], waiting[max(most, 1) :]

    def _block(
        self, state: State, groups: list[_Group]
    ) -> tuple[State, list[Column], list[Update]]:
        """Return the state after groups that are assimilated together, the columns that they see, and what these did."""
        columns = self.observer.columns(groups, state.scale)
        if not columns:
            return state, [], []
        after, updates = self._assimilated(state, columns)
        if self._scale_error is not None:
            after, updates = self._with_jacobian(after, updates)
        if after.profiles == state.profiles:
            # also the time stays: an earlier measurement may still come
            after = state
        for update in updates:
            after = noted(after, update.column, not all(j.accepted for j in update.judgements))
        if self.evidence is not None:
            after = self._under_evidence(state.profiles, after)
        return after, columns, updates

    def _assimilated(self, state: State, columns: list[Column]) -> tuple[State, list[Update]]:
        """Return the state after columns, at the time of the last, or where it changes at their mean time; and what they did."""
        tau = self.observer.tau
        if not np.isfinite(tau).any():
            after, updates = assimilate(state, columns, self.probability)
            time_ns, timed = state.time_ns, list[Update]()
            for each in updates:
                own = each.column.time_ns
                if any(judgement.accepted for judgement in each.judgements):
                    time_ns = own if time_ns is None else max(time_ns, own)
                assert each.after is not None
                timed.append(replace(each, after=replace(each.after, time_ns=time_ns)))
            return replace(after, time_ns=time_ns), timed
        times = [column.time_ns for column in columns]
        state = self.predict(state, times[0] + sum(time - times[0] for time in times) // len(times))
        assert state.time_ns is not None
        moved = [_moved(column, state.time_ns, tau) for column in columns]
        return assimilate(state, moved, self.probability)

    def _under_evidence(self, profiles: int, state: State) -> State:
        """Return a state under the prior that the log suggests, where it is time to ask; ``profiles`` there were before its last block."""
        assert self.evidence is not None
        parts = self.evidence.parts
        if is_refuted(state.doubt):
            return rescaled(state, parts.scaled)
        if any(profiles < count <= state.profiles for count in SCALED):
            factor = self._fitted_scale(state)
            far = max(factor / self.evidence.expected, 1.0 / factor) > _FAR
            if self.evidence.is_made or state.scale != 1.0 or far:
                scales = state.scale, state.scale * factor
                moments = with_variance(state.x, state.covariance, parts.scaled, *scales)
                state = replace(state.with_moments(*moments), scale=scales[1])
        if state.centre is None and state.profiles >= CENTRED:
            state = replace(state, centre=self._centre(state))
        return state.with_toward(parts.sample)

    def _fitted_scale(self, state: State) -> float:
        """Return the most probable factor on the prior variance of members and local directions as the state has it."""
        assert self.evidence is not None
        part, root = self.evidence.parts.scaled, np.sqrt(state.scale)
        plain = self.evidence.is_made or state.scale != 1.0
        expected = 1.0 if plain else self.evidence.expected
        lower = state.folded().p[part, part] / state.scale
        return fitted_scale(state.x[part] / root, lower, expected, state.rows, state.square)

    @property
    def _scale_error(self) -> tuple[int, float] | None:
        """Position of the instrument's scale error among the unknowns, and its prior standard deviation; None where none is estimated."""
        extras = self.observer.extras
        if extras is None or "scale" not in extras.names:
            return None
        k = extras.names.index("scale")
        return self.observer.size - extras.std.size + k, float(extras.std[k])

    def gradient(self, update: Update) -> Array:
        """Return the gradient in the unknowns, shape (k,), by which a scale error's Jacobian moves the estimate after an update."""
        out = np.zeros(self.observer.size)
        if self._scale_error is not None:
            at, std = self._scale_error
            out[at] = std * scale_jacobian(update)
        return out

    def _with_jacobian(self, after: State, updates: list[Update]) -> tuple[State, list[Update]]:
        """Return the state after one column, moved by the Jacobian of a scale error."""
        moved = [self.gradient(update) for update in updates]
        after = replace(after, x=after.x - sum(after.products(each[None])[0] for each in moved))
        return after, [replace(update, after=after) for update in updates]

    # ---- what is published

    def weights(self, state: State) -> Array:
        """Return the mean weights of a state, shape (Z r,), level after level; before the centre stays without the members' kernels."""
        x = state.x if self.evidence is None else state.centred(self.evidence.parts.sample)
        process = self.observer.process
        return process.weights(x[: process.size], self._time(state)).ravel()

    def flow(self, state: State) -> FlowEstimate:
        """Return the current estimate of a state, at its time; its standard error is computed when first asked for."""
        basis, observer = self.observer.basis, self.observer
        x, p, scale = self._published(state)
        own = slice(0, observer.process.size)
        unknowns = Unknowns(
            observer.process,
            basis.offset,
            x[own],
            p[own, own],
            state.time_ns,
            observer.error(state.scale),
            scale,
            self._oscillation(state),
            None if self.observer.stated_std is not None else state.measured,
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
            observer.potential,
        )

    def _oscillation(self, state: State) -> Oscillation | None:
        extras = self.observer.extras
        if extras is None or state.time_ns is None:
            return None
        own = state.x[self.observer.process.size :]
        return extras.known(own, self.grid.levels, state.time_ns)

    def remarks(self, state: State) -> list[str]:
        """Return notes on the instrument's errors, where they are estimated."""
        extras, found = self.observer.extras, list[str]()
        if state.scale != 1.0:
            words = f"the variance of the ensemble was multiplied by {state.scale:.2g}, as the measurements show"
            narrow = "; the ensemble hardly holds this water" if state.scale > 4.0 else ""
            found.append(words + narrow)
        if extras is None:
            return found
        last = slice(self.observer.size - extras.std.size, None)
        std = np.sqrt(np.diag(state.covariance)[last])
        return found + extras.remarks(state.x[last], std)

    def _time(self, state: State) -> int:
        at = self.time_ns if state.time_ns is None else state.time_ns
        return int(self.observer.process.times_ns[0]) if at is None else at

    def _published(self, state: State) -> tuple[Array, Array, float | Callable[[], float]]:
        """Return mean and covariance under the prior that the log suggests, and what returns the factor on all variances."""
        x, p = state.x, state.covariance
        if self.evidence is None or not state.profiles:
            return x, p, 1.0

        @cache
        def scale() -> float:
            return max(1.0, self._fitted_scale(state))

        centre = self._centre(state) if state.centre is None else state.centre
        x, p = self._averaged(x, p)
        return with_mean(x, p, self.evidence.parts.sample, centre), p, scale

    def _averaged(self, x: Array, p: Array) -> tuple[Array, Array]:
        """Return mean and covariance after the average over the prior variance of the ensemble mean's amplitude."""
        assert self.evidence is not None
        parts, variance = self.evidence.parts, self.evidence.parts.amplitude_variance
        if not (parts.has_amplitude and self.evidence.averages_amplitude):
            return x, p
        size = np.sqrt(variance)
        mean, left = amplitude_mixture(size * x[0], variance * p[0, 0], variance)
        return with_marginal(x, p, 0, mean / size, left / variance)

    def _centre(self, state: State) -> Array:
        """Return the prior mean of the sample's unknowns as the members' kernels move it; zero where the current is like no member."""
        assert self.evidence is not None
        parts = self.evidence.parts
        if state.scale != 1.0 or self.evidence.is_made:
            return np.zeros(parts.sample.stop - parts.sample.start)
        x, p = self._averaged(state.x, state.covariance)
        marginal = Marginal.of(x[parts.sample], p[parts.sample, parts.sample])
        return member_centre(
            marginal, parts.anomaly, parts.members, state.profiles, self.evidence.kernels
        )


def _moved(column: Column, time_ns: int, tau: Array) -> Column:
    """Return a column of the unknowns at another time near its own [ns, UTC], of which it knows less by what they decay in between."""
    if column.time_ns == time_ns:
        return column
    factor = np.exp(-abs(time_ns - column.time_ns) / _NS / tau)
    return replace(column, design=column.design * factor)
