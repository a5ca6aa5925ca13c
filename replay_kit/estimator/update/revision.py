"""Revision of the prior by the log after assimilation, with the formulas of ``evidence.py``.

A **far too narrow** prior rejects valid measurements, and a gate that rejects all would keep a wrong estimate. If most of the first
measurements of each kind and the latest are rejected, the ensemble is at fault: its variance is then multiplied by the likeliest factor,
and the rejected measurements are assimilated. Where one kind agrees with the prior, the other is at fault.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.estimator.prior.calibration import MembersPrior, calibration, fitted_kernels
from replay_kit.estimator.prior.factor import Parts, PriorSettings
from replay_kit.estimator.prior.fit import Members
from replay_kit.estimator.state import Doubt, State
from replay_kit.estimator.update.assimilate import Update, assimilate
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

# Factor on the prior variance, or one over it, from which on the prior is changed, and not the stated errors alone.
_FAR = 3.0
# Columns after which the prior's variance is no longer doubted.
_MOST = 16
# Columns from which on it is, the share of them that is rejected then, and how many of the latest four are.
_LEAST, _SHARE, _LATEST = 10, 0.6, 3
_SCALES = 2.0 ** np.arange(0.0, 9.0)


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

    def revised(self, before: int, state: State) -> State:
        """Return a state under the revised prior, if a revision is due: after more profiles than ``before``."""
        if _is_refuted(state.doubt):
            return self._rescaled(state)
        if any(before < count <= state.profiles for count in SCALED):
            factor = self._scale(state)
            far = max(factor / self.expected, 1.0 / factor) > _FAR
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
        return max(1.0, self._scale(state)) * _few_members_factor(self.parts.members)

    def _scale(self, state: State) -> float:
        """Return the most probable factor on the prior variance of members and local directions for a state."""
        part, root = self.parts.scaled, np.sqrt(state.scale)
        expected = 1.0 if self.is_made or state.scale != 1.0 else self.expected
        lower = state.folded().p[part, part] / state.scale
        return fitted_scale(state.x[part] / root, lower, expected, state.rows, state.square)

    def _scaled(self, state: State, factor: float) -> State:
        """Return the state with the prior variance of members and local directions multiplied by a factor."""
        scales = state.scale, state.scale * factor
        moments = with_variance(state.x, state.covariance, self.parts.scaled, *scales)
        return replace(state.with_moments(*moments), scale=scales[1])

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

    def _rescaled(self, state: State) -> State:
        """Return a state with the likeliest prior variance and the rejected columns assimilated, if the columns refute the prior."""
        assert state.doubt is not None
        part, columns, found = self.parts.scaled, state.doubt.columns, []
        lower = state.covariance[part, part] / state.scale
        misfit, determinant, _ = scale_changes(state.x[part] / np.sqrt(state.scale), lower, _SCALES)
        before = -0.5 * (misfit + determinant)
        for scale, evidence in zip(_SCALES.tolist(), before.tolist(), strict=True):
            begun = replace(self._scaled(state, scale), doubt=None)
            after, updates = assimilate(begun, columns, None)
            found.append((evidence + sum(update.log_likelihood for update in updates), after))
        times = [column.time_ns for column in columns]
        latest = max(times if state.time_ns is None else [*times, state.time_ns])
        return replace(max(found, key=lambda each: each[0])[1], time_ns=latest)


def _few_members_factor(members: int) -> float:
    """Return the factor on variances away from the log, where few members do not span what is there; 1 from 20 members on.

    Of what is drawn like E members the variance, given them, is (1 + 1/E) (E - 1) / (E - 3) times theirs (Student's distribution). That of
    20, for which variances were found to hold, is the measure.
    """
    factor, usual = ((1.0 + 1.0 / n) * (n - 1.0) / (n - 3.0) for n in (max(members, 4), 20))
    return max(1.0, factor / usual)


def with_decisions(state: State, updates: list[Update]) -> State:
    """Return the state with gate decisions recorded, as long as the prior variance is in doubt."""
    for update in updates if state.doubt is not None else ():
        doubt, rejected = state.doubt, not bool(update.judgements.accepted.all())
        if doubt is None or (len(doubt.rejected) + 1 >= _MOST and not rejected):
            return replace(state, doubt=None)
        columns = (*doubt.columns, update.column) if rejected else doubt.columns
        is_mean = update.column.screened.linear is not None
        more = (*doubt.rejected, rejected), columns, (*doubt.means, is_mean)
        state = replace(state, doubt=Doubt(*more))
    return state


def _is_refuted(doubt: Doubt | None) -> bool:
    """Return whether the first columns refute the prior variance."""
    if doubt is None or len(doubt.rejected) < _LEAST:
        return False
    rejected, means = np.array(doubt.rejected), np.array(doubt.means)
    most = all(rejected[kind].mean() >= _SHARE for kind in (means, ~means) if kind.any())
    return most and sum(doubt.rejected[-4:]) >= _LATEST
