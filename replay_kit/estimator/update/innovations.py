"""Innovations to publish: of each rejected measurement, and of the accepted ones of a column together."""

from collections.abc import Callable
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, Indices, replace
from replay_kit.core.observation import (
    Flag,
    GroupTotals,
    Innovation,
    Profiles,
    mean_time,
    reasons_of,
)
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.state import State
from replay_kit.estimator.update.assimilate import Update
from replay_kit.estimator.update.columns import Column
from replay_kit.estimator.update.screening import Screened


def outcomes(
    group: Screened, update: Update | None, before: State, against: Callable[[State], Array] | None
) -> list[Stepped[State]]:
    """Return the outcomes of a group: of each unused or rejected measurement, then of the accepted ones together.

    Args:
        group: Group after screening.
        update: Update by the used ones; None without any.
        before: State before them.
        against: See ``Stepped``.
    """
    unused = np.flatnonzero(~group.used.any(axis=1)).tolist()
    found = [Stepped(_subset(group, [i]), before, before, group.unused(i)) for i in unused]
    if update is None:
        return found
    assert update.after is not None
    judgements, at = update.judgements, update.column.at
    accepted = np.flatnonzero(judgements.accepted)
    for i in np.flatnonzero(~judgements.accepted).tolist():
        # nothing changes
        moments: Any = {"mean_after": update.before, "covariance_after": update.covariance}
        same = replace(update, **moments, signal=0.0, log_likelihood=np.nan)
        event = _subset(group, [int(at[i])])
        found.append(Stepped(event, before, before, _innovation(same, np.array([i]))))
    if accepted.size:
        known = against if accepted.size == len(at) else None
        innovation = replace(
            _innovation(update, accepted),
            accepted=True,
            decision="accepted",
            error_inflation=float(accepted.size / np.sum(1.0 / judgements.error_factor[accepted])),
        )
        found.append(Stepped(_subset(group, at[accepted]), before, update.after, innovation, known))
    return found


def _subset(group: Screened, at: Any) -> Any:
    """Return the event of a subset of a group."""
    event = group.event
    return event.rows(at) if isinstance(event, Profiles) and len(at) < len(event) else event


def _innovation(update: Update, at: Indices) -> Innovation:
    """Return the joint innovation of some measurements of a column: means over them, and sums."""
    column, judgements, several = update.column, update.judgements, len(at) > 1
    group, rows = column.screened, column.at[at]
    first = group.unused(int(rows[0]))
    means = np.stack([update.before, update.mean_after, np.zeros_like(update.before)])
    variances = column.predicted_variance(update.covariance), column.stated_variance()
    measured = column.measured(update.mean_after)
    each = np.stack([*column.misfit(means), *variances, measured])[:, at]
    mean, counts, totals, flags = each[:, 0], np.ones(1), None, first.flags
    dof = int((judgements.rows + judgements.left)[at].sum())
    if several:
        # of a value that no measurement uses the mean is NaN
        counts, total = np.isfinite(each[0]).sum(axis=0), np.nansum(each, axis=1)
        mean = np.divide(total, counts, out=np.full(total.shape, np.nan), where=counts > 0)
        flags = np.where(counts[:, 0] > 0, Flag.GOOD, flags).astype(np.int8)
        before, left, against = np.nansum(each[:3] ** 2, axis=(1, 2, 3)).tolist()
        reasons = tuple(reasons_of(group.reasons[rows], group.flags[rows]))
        totals = GroupTotals(dof // 2, before, left, against, reasons)
    innovation, residual, prior, of_estimate, of_noise, measured = mean
    estimated_std = np.nan
    if group.linear is not None and group.linear.label.mean is not None:
        variance = column.predicted_variance(update.covariance_after)
        estimated_std = float(np.sqrt(np.mean(variance)))
    return replace(
        first,
        time_ns=mean_time(group.columns["time"][rows]),
        flags=flags,
        depth=group.columns["depth"][rows].mean(axis=0),
        innovation=innovation,
        # the estimate's error is shared, the noise is not
        innovation_std=np.sqrt(of_estimate + of_noise / np.maximum(counts, 1)),
        residual=residual,
        prior_innovation=prior,
        measured=measured,
        nis=float(judgements.nis[at].sum()),
        dof=dof,
        decision="rejected",
        gate_statistic=float(judgements.statistic[at[0]]),
        gate=float(judgements.threshold[at[0]]),
        signal_dof=update.signal,
        log_likelihood=update.log_likelihood,
        estimated_std=estimated_std,
        profiles=len(at),
        totals=totals,
    )


def misfits(group: Screened, column: Column, mean: Array) -> Array:
    """Return the innovations of all values of a group, shape (n m, 2) [m/s]; unused ones are NaN, or 0 in a group."""
    used = column.misfit(mean)
    if len(group.flags) == 1:
        return np.asarray(used[0])
    each = np.zeros((*group.flags.shape, 2))
    each[column.at] = np.nan_to_num(used)
    return each.reshape(-1, 2)
