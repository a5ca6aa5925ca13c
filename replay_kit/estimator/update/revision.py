"""Revision of the prior by the log after assimilation, with the formulas of ``evidence.py``.

A **far too narrow** prior rejects valid measurements, and a gate that rejects all would keep a wrong estimate; so does an unknown tide.
If many of the first measurements of each kind are rejected, all are assimilated anew, with the likeliest factor on the variance and further
error of each. Where one kind agrees with the prior, the other is at fault.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.estimator.prior.calibration import MembersPrior, calibration, fitted_kernels
from replay_kit.estimator.prior.factor import Parts, PriorSettings
from replay_kit.estimator.prior.fit import Members
from replay_kit.estimator.state import Doubt, Revised, State
from replay_kit.estimator.update.assimilate import Update, assimilate
from replay_kit.estimator.update.columns import Column
from replay_kit.estimator.update.evidence import (
    CENTRED,
    SCALED,
    Marginal,
    amplitude_mixture,
    fitted_scale,
    member_centre,
    scale_changes,
    with_marginal,
    with_mean,
    with_variance,
)

#: Factor on the prior variance, or one over it, from which on the prior is changed, and not the stated errors alone.
FAR = 3.0
# Columns after which the prior's variance is no longer doubted.
_MOST = 16
# Columns from which on it is, the share of them that is rejected then, and how many of the latest four are; and the same after all of them.
_REFUTED = (10, 0.6, 3), (_MOST, 0.3, 0)
_SCALES = 2.0 ** np.arange(0.0, 9.0)
# Further errors of a measurement that are tried with it [m/s], and their correlation depths [m]: as of tides, and of internal waves. Last,
# of those rejected alone, which are then wrong.
_FURTHER = (0.0, np.inf), *product((0.05, 0.1, 0.2), (np.inf, 200.0))
_TRIED = *zip(_FURTHER, _FURTHER, strict=True), (_FURTHER[0], (1.0, np.inf))


# Not slotted: what members left out show is computed when first asked for.
@dataclass(frozen=True, eq=False)
class Evidence:
    """Revision of the prior by the log.

    Attributes:
        parts: Slices of the unknowns by kind.
        members: Members of the ensemble in few modes.
        settings: Settings of the prior.
        bound: Standard deviation below which directions were dropped [m/s].
        is_made: Whether the ensemble was built from other fields, with another variance than a forecast's.
        averages_amplitude: Whether to average over the prior variance of the ensemble mean's amplitude.
    """

    parts: Parts
    members: Members
    settings: PriorSettings
    bound: float
    is_made: bool
    averages_amplitude: bool

    @cached_property
    def expected(self) -> float:
        """Factor on variances by cross-validation over members."""
        return calibration(self._prior)

    @cached_property
    def kernels(self) -> Array:
        """Probabilities of the kernels about members by cross-validation, shape (H,)."""
        return fitted_kernels(self._prior)

    @cached_property
    def _prior(self) -> MembersPrior:
        return MembersPrior.of(self.members, self.settings, self.bound)

    def revised(self, before: int, state: State, observe: Callable[..., list[Column]]) -> State:
        """Return a state under the revised prior, if a revision is due: after more profiles than ``before``; columns by ``observe``."""
        doubt = state.doubt
        if doubt is not None:
            if _is_refuted(doubt):
                return self._refitted(state, doubt, observe)
            if len(doubt.rejected) >= _MOST and not doubt.rejected[-1]:
                state = replace(state, doubt=None)
        if any(before < count <= state.profiles for count in SCALED):
            factor = self._scale(state)
            far = max(factor / self.expected, 1.0 / factor) > FAR
            if self.is_made or state.scale != 1.0 or far:
                state = self._scaled(state, factor)
        if state.centre is None and state.profiles >= CENTRED:
            state = replace(state, centre=self._centre(state))
        return state

    def published(self, state: State) -> tuple[Array, Array, float | Callable[[], float]]:
        """Return mean and covariance under the revised prior, and the factor on all variances or a function that returns it."""
        if not state.profiles:
            return state.x, state.covariance, 1.0
        centre = self._centre(state) if state.centre is None else state.centre
        x, p = self._averaged(state)
        return with_mean(x, p, self.parts.sample, centre), p, partial(self._stated, state)

    def _stated(self, state: State) -> float:
        return self.shown(state) / state.scale * _few_members_factor(self.parts.members)

    def shown(self, state: State) -> float:
        """Return the factor on the variance of the ensemble that the measurements show."""
        return state.scale * max(1.0, self._scale(state))

    def _scale(self, state: State) -> float:
        """Return the most probable factor on the prior variance of members and local directions for a state."""
        expected = 1.0 if self.is_made or state.scale != 1.0 else self.expected
        return fitted_scale(*self._of_unit_scale(state), expected, state.rows, state.square)

    def _of_unit_scale(self, state: State) -> tuple[Array, Array]:
        """Return mean and covariance (its lower triangle) of the scaled unknowns in units of their prior standard deviation."""
        part = self.parts.scaled
        return state.x[part] / np.sqrt(state.scale), state.folded().p[part, part] / state.scale

    def _scaled(self, state: State, factor: float) -> State:
        """Return the state with the prior variance of members and local directions multiplied by a factor."""
        scales = state.scale, state.scale * factor
        moments = with_variance(state.x, state.covariance, self.parts.scaled, *scales)
        return replace(
            state.with_moments(*moments), revised=state.revised._replace(scale=scales[1])
        )

    def _averaged(self, state: State) -> tuple[Array, Array]:
        """Return mean and covariance averaged over the prior variance of the ensemble mean's amplitude."""
        x, p, variance = state.x, state.covariance, self.parts.amplitude_variance
        if not (self.parts.has_amplitude and self.averages_amplitude):
            return x, p
        size = np.sqrt(variance)
        mean, left = amplitude_mixture(size * x[0], variance * p[0, 0], variance)
        return with_marginal(x, p, 0, mean / size, left / variance)

    def _centre(self, state: State) -> Array:
        """Return the prior mean of the sample's unknowns under the members' kernels; zero if the current resembles no member."""
        parts = self.parts
        if state.scale != 1.0 or self.is_made:
            return np.zeros(parts.sample.stop - parts.sample.start)
        x, p = self._averaged(state)
        marginal = Marginal.of(x[parts.sample], p[parts.sample, parts.sample])
        return member_centre(marginal, parts.anomaly, parts.members, state.profiles, self.kernels)

    def _refitted(self, state: State, doubt: Doubt, observe: Callable[..., list[Column]]) -> State:
        """Return a state after all columns, without a gate, with the likeliest prior variance and further error of a measurement."""
        assert doubt.before is not None
        found = []
        begun = replace(
            doubt.before,
            time_ns=max(column.time_ns for column in doubt.columns),
            last=state.last,
            measured=state.measured,
            doubt=None,
        )
        for further in _TRIED:
            stated, of_rejected = (Revised(doubt.before.scale, *each) for each in further)
            columns = [
                observe([column.screened], of_rejected if rejected else stated)[0]
                for column, rejected in zip(doubt.columns, doubt.rejected, strict=True)
            ]
            after, updates = assimilate(replace(begun, revised=stated), columns, None)
            misfit, determinant, _ = scale_changes(*self._of_unit_scale(after), _SCALES)
            logs = sum(update.log_likelihood for update in updates) - 0.5 * (misfit + determinant)
            found.append((logs.max(), _SCALES[logs.argmax()], after))
        _, scale, after = max(found, key=lambda each: each[0])
        return self._scaled(after, float(scale))


def _few_members_factor(members: int) -> float:
    """Return the factor on variances away from the log, where few members do not span what is there; 1 from 20 members on.

    Of what is drawn like E members the variance, given them, is (1 + 1/E) (E - 1) / (E - 3) times theirs (Student's distribution). That of
    20, for which variances were found to hold, is the measure.
    """
    factor, usual = ((1.0 + 1.0 / n) * (n - 1.0) / (n - 3.0) for n in (max(members, 4), 20))
    return max(1.0, factor / usual)


def with_decisions(before: State, state: State, updates: list[Update]) -> State:
    """Return the state with gate decisions recorded, as long as the prior variance is in doubt.

    Args:
        before: State before the updates.
        state: State after them.
        updates: Updates.
    """
    for update in updates if state.doubt is not None else ():
        doubt, rejected = state.doubt, not bool(update.judgements.accepted.all())
        assert doubt is not None
        more = (*doubt.rejected, rejected), (*doubt.columns, update.column)
        state = replace(state, doubt=Doubt(doubt.before or before, *more))
    return state


def _is_refuted(doubt: Doubt) -> bool:
    """Return whether the first columns refute the prior variance or the stated errors."""
    rejected = np.array(doubt.rejected)
    means = np.array([column.screened.linear is not None for column in doubt.columns])
    shares = [rejected[kind].mean() for kind in (means, ~means) if kind.any()]
    latest = sum(doubt.rejected[-4:])
    return any(
        len(rejected) >= least and min(shares) >= share and latest >= late
        for least, share, late in _REFUTED
    )
