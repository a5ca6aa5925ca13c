"""What is published of the measurements of a step: of each that the gate rejects, and of the accepted ones together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, replace
from replay_kit.core.observation import Flag, GroupTotals, Innovation, reasons_of
from replay_kit.estimator.update.gate import SOFTENED
from replay_kit.estimator.update.grouping import mean_time
from replay_kit.estimator.update.screening import ScreenedGroup
from replay_kit.estimator.update.stack import Stack
from replay_kit.estimator.update.superobservation import Column, GroupUpdate


@dataclass(frozen=True, slots=True, eq=False)
class GroupResult:
    """A group's evaluation, its update's effect, and what is published of them.

    Attributes:
        screened: The group after screening.
        update: Its evaluation.
        before: The column before it.
        prior: shape (c q,), the column's mean before any observation.
        prior_inflation: Factor on the estimate's covariance after it.
    """

    screened: ScreenedGroup
    update: GroupUpdate
    before: Column
    prior: Array
    prior_inflation: float

    @property
    def _is_one(self) -> bool:
        """Whether there is one measurement, which is judged with its stated errors."""
        return self.screened.used.size == 1

    def rejected(self, i: int) -> Innovation:
        """Return the innovation of one of the usable measurements, which the gate rejected."""
        update, at, only = self.update, int(self.screened.used[i]), np.array([i], np.intp)
        one, gate = update.stack.part(only), update.gate
        before = _shown(one, update.before[only])[0]
        of_estimate, errors = self._variances(one)
        return replace(
            self.screened.unused(at),
            innovation=before,
            innovation_std=_shown(one, np.sqrt(of_estimate + errors))[0],
            residual=before,
            prior_innovation=_shown(one, column_misfits(one, self.prior[None])[0])[0],
            nis=float(update.nis[i]),
            dof=int(one.layouts[0].dof),
            decision="rejected",
            gate_statistic=float(gate.statistic[i]),
            gate=float(gate.threshold[i]),
            signal_dof=0.0,
            # the first alone is told the monitor
            prior_inflation=self.prior_inflation if update.step is None and i == 0 else 1.0,
            log_likelihood=self._log_likelihood(one, np.ones(1)) if self._is_one else np.nan,
            estimated_std=self._estimated_std(one, self.before),
        )

    def combined(self, accepted: NDArray[np.intp]) -> Innovation:
        """Return the innovation of the accepted ones together."""
        update, gate, screened = self.update, self.update.gate, self.screened
        stack, at = update.stack.part(accepted), screened.used[accepted]
        assert update.step is not None, "some are accepted"
        means = np.stack([self.before.means[:, 0], update.step.after.means[:, 0], self.prior])
        before, after, prior = column_misfits(stack, means)
        error_factor, dof = gate.error_factor[accepted], int(np.sum(stack.of_each("dof")))
        softened = int(np.count_nonzero(gate.decision[accepted] == SOFTENED))
        flags = screened.flags[at[0]]
        if not self._is_one:
            flags = np.where(stack.used.any(axis=0), Flag.GOOD, flags).astype(np.int8)
        likelihood = self._log_likelihood(stack, np.ones(1) if self._is_one else error_factor)
        return replace(
            screened.unused(int(at[0])),
            time_ns=mean_time([screened.events[i] for i in at]),
            flags=flags,
            depth=np.mean([each.value_depth for each in stack.observations], axis=0),
            innovation=_mean_of(stack, before),
            residual=_mean_of(stack, after),
            prior_innovation=_mean_of(stack, prior),
            innovation_std=_mean_std(stack, *self._variances(stack)),
            nis=float(update.nis[accepted].sum()),
            dof=dof,
            accepted=True,
            error_inflation=float(accepted.size / np.sum(1.0 / error_factor)),
            decision="softened" if softened else "accepted",
            gate_statistic=float(gate.statistic[0]),
            gate=float(gate.threshold[0]),
            signal_dof=update.step.signal_dof,
            prior_inflation=self.prior_inflation,
            log_likelihood=likelihood,
            estimated_std=self._estimated_std(stack, update.step.after),
            profiles=accepted.size,
            totals=None
            if self._is_one
            else GroupTotals(
                softened,
                dof // 2,
                float(np.sum(update.before[accepted] ** 2)),
                float(np.sum(after**2)),
                float(np.sum(prior**2)),
                tuple(reasons_of(screened.reasons[at], screened.flags[at])),
            ),
        )

    def _variances(self, stack: Stack, column: Column | None = None) -> tuple[Array, Array]:
        """Return the variances that a column, by default that before, and the stated errors give values, shape (n, m, 2) each."""
        return stack.variances((column or self.before).predicted_cov(stack.of("r")))

    def _estimated_std(self, stack: Stack, column: Column) -> float:
        """Return the error of each component of a mean along a path in a column, as its root mean square [m/s]; NaN of profiles."""
        if stack.observations[0].label.mean is None:
            return np.nan
        return float(np.sqrt(np.mean(self._variances(stack, column)[0][:, stack.used[0]])))

    def _log_likelihood(self, stack: Stack, error_factor: Array) -> float:
        """Return the logarithm of the density of all values under the column before the group, with errors that some factor inflates."""
        update = self.update
        if self._is_one:
            # of unit noise, as stated: along the eigenvectors that the gate found
            square = float(update.nis[0])
            half_log_det = 0.5 * float(np.sum(np.log1p(update.gate.variance[0])))
        else:
            assert update.step is not None
            square, half_log_det = update.step.fit
            square += update.step.rows.residual + float(
                np.sum(stack.residual_square / error_factor)
            )
        noise = len(stack.components) * stack.of_each("half_log_det")
        noise = noise + 0.5 * stack.of_each("dof") * np.log(error_factor)
        return float(-0.5 * square - half_log_det - np.sum(noise))


def column_misfits(stack: Stack, means: Array) -> Array:
    """Return measured minus predicted values, shape (k, n, m, 2) [m/s], 0 where not used; ``means``, shape (k, c q), are of columns."""
    r, columns = stack.of("r"), means.reshape(len(means), 1, len(stack.components), -1)
    return stack.misfit(np.matmul(columns, r.swapaxes(1, 2)))


def _shown(stack: Stack, values: Array) -> Array:
    """Return values, shape (n, m, 2), NaN where not used."""
    return np.where(stack.used[..., None], values, np.nan)


def _mean_of(stack: Stack, values: Array) -> Array:
    """Return the mean over the measurements that use a value, shape (m, 2); NaN where none does."""
    if len(values) == 1:
        return np.asarray(_shown(stack, values)[0])
    counts = stack.used.sum(axis=0)[:, None]
    total = np.sum(np.where(stack.used[..., None], values, 0.0), axis=0)
    return np.asarray(np.divide(total, counts, out=np.full(total.shape, np.nan), where=counts > 0))


def _mean_std(stack: Stack, of_estimate: Array, errors: Array) -> Array:
    """Return the standard deviation of the mean innovation, shape (m, 2): the estimate's error is shared, the noise is not."""
    counts = np.maximum(stack.used.sum(axis=0), 1)[:, None]
    return np.asarray(np.sqrt(_mean_of(stack, of_estimate) + _mean_of(stack, errors) / counts))
