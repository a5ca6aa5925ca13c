"""The innovations to publish: of each measurement that the gate rejects, and of the accepted ones of a column together."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, replace
from replay_kit.core.observation import Flag, GroupTotals, Innovation, reasons_of
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.state import State
from replay_kit.estimator.update.assimilate import Update
from replay_kit.estimator.update.columns import Column
from replay_kit.estimator.update.grouping import ProfileGroup, mean_time
from replay_kit.estimator.update.screening import ScreenedGroup


def outcomes(
    group: ScreenedGroup,
    update: Update | None,
    before: State,
    against: Callable[[State], Array] | None,
) -> list[Stepped[State]]:
    """Return the outcome of each measurement of a group, and of the accepted ones together, in the order of the first.

    Args:
        group: After screening.
        update: What those that are used did; None where none is.
        before: The state before them.
        against: As of ``Stepped``.
    """
    used = set(group.used.tolist())
    found = [
        Stepped(event, before, before, group.unused(i))
        for i, event in enumerate(group.events)
        if i not in used
    ]
    if update is None:
        return found
    assert update.after is not None
    decided = np.array([judgement.accepted for judgement in update.judgements])
    accepted = np.flatnonzero(decided)
    for i in np.flatnonzero(~decided).tolist():
        found.append(
            Stepped(group.events[group.used[i]], before, before, _rejected(group, update, i))
        )
    if accepted.size:
        events = tuple(group.events[group.used[i]] for i in accepted)
        event = ProfileGroup(events) if len(events) > 1 else events[0]
        known = against if accepted.size == len(used) else None
        found.append(
            Stepped(event, before, update.after, _accepted(group, update, accepted), known)
        )
    return found


def _rejected(group: ScreenedGroup, update: Update, i: int) -> Innovation:
    """Return the innovation of one of the usable measurements, which the gate rejected."""
    judgement, at = update.judgements[i], int(group.used[i])
    means = np.stack([update.before, np.zeros_like(update.before)])
    before, prior = _spread(group, i, update.column.misfit(i, means))
    return replace(
        group.unused(at),
        innovation=before,
        innovation_std=np.sqrt(_variances(group, update, i).sum(axis=0)),
        residual=before,
        prior_innovation=prior,
        nis=judgement.nis,
        dof=judgement.rows + judgement.left,
        decision="rejected",
        gate_statistic=judgement.statistic,
        gate=judgement.threshold,
        signal_dof=0.0,
        estimated_std=_estimated_std(group, update, update.covariance),
    )


def _accepted(group: ScreenedGroup, update: Update, accepted: NDArray[np.intp]) -> Innovation:
    """Return the innovation of the accepted measurements together: means over them, and sums."""
    judgements, at = [update.judgements[i] for i in accepted], group.used[accepted]
    means = np.stack([update.before, update.mean_after, np.zeros_like(update.before)])
    shown = [_spread(group, i, update.column.misfit(i, means)) for i in accepted.tolist()]
    before, after, prior = np.stack(shown, axis=1)
    several, dof = len(at) > 1, sum(each.rows + each.left for each in judgements)
    flags = group.flags[at[0]]
    if several:
        flags = np.where(np.isfinite(before[..., 0]).any(axis=0), Flag.GOOD, flags).astype(np.int8)
    events = [group.events[i] for i in at]
    factors = np.array([each.error_factor for each in judgements])
    return replace(
        group.unused(int(at[0])),
        time_ns=mean_time(events),
        flags=flags,
        depth=_mean(np.stack([each.linear.value_depth for each in events])),
        innovation=_mean(before),
        innovation_std=_mean_std(group, update, accepted),
        residual=_mean(after),
        prior_innovation=_mean(prior),
        nis=sum(each.nis for each in judgements),
        dof=dof,
        accepted=True,
        error_inflation=float(len(at) / np.sum(1.0 / factors)),
        decision="accepted",
        gate_statistic=judgements[0].statistic,
        gate=judgements[0].threshold,
        signal_dof=update.signal,
        log_likelihood=update.log_likelihood,
        estimated_std=_estimated_std(group, update, update.covariance_after),
        profiles=len(at),
        totals=GroupTotals(
            dof // 2,
            float(np.nansum(before**2)),
            float(np.nansum(after**2)),
            float(np.nansum(prior**2)),
            tuple(reasons_of(group.reasons[at], group.flags[at])),
        )
        if several
        else None,
    )


def misfits(group: ScreenedGroup, column: Column, mean: Array) -> Array:
    """Return measured minus predicted values of all measurements of a group, shape (n m, 2) [m/s]; NaN, or 0 of several, where not used."""
    each = [_spread(group, i, column.misfit(i, mean)) for i in range(len(group.used))]
    if len(group.events) == 1:
        return each[0]
    out = np.zeros((len(group.events), *each[0].shape))
    out[group.used] = np.nan_to_num(each)
    return out.reshape(-1, 2)


def _spread(group: ScreenedGroup, i: int, values: Array) -> Array:
    """Return values of the used bins, shape (..., m, 2), among all bins, shape (..., n, 2)."""
    used = group.is_used[i]
    out = np.full((*values.shape[:-2], used.size, 2), np.nan)
    out[..., used, :] = values
    return out


def _variances(group: ScreenedGroup, update: Update, i: int) -> Array:
    """Return the estimate's and the noise's part of the variance of a measurement's innovation, shape (2, n, 2) [m^2/s^2]."""
    column = update.column
    own = column.predicted_variance(i, update.covariance)
    noise = np.outer(column.layouts[i].std ** 2, np.sum(column.axes**2, axis=0))
    return _spread(group, i, np.stack([own, noise]))


def _mean_std(
    group: ScreenedGroup, update: Update, accepted: Sequence[int] | NDArray[np.intp]
) -> Array:
    """Return the standard deviation of the mean innovation, shape (n, 2): the estimate's error is shared, the noise is not."""
    own, noise = np.stack([_variances(group, update, i) for i in accepted], axis=1)
    if len(own) > 1:
        noise = noise / np.maximum(np.isfinite(own[..., 0]).sum(axis=0), 1)[:, None]
    return np.asarray(np.sqrt(_mean(own) + _mean(noise)))


def _mean(values: Array) -> Array:
    """Return the mean over measurements, shape (n, 2), of those that use a value; NaN where none does."""
    if len(values) == 1:
        return np.asarray(values[0])
    known = np.isfinite(values)
    counts = known.sum(axis=0)
    total = np.sum(np.where(known, values, 0.0), axis=0)
    return np.asarray(np.divide(total, counts, out=np.full(total.shape, np.nan), where=counts > 0))


def _estimated_std(group: ScreenedGroup, update: Update, covariance: Array) -> float:
    """Return the error of each component of a mean along a path, as its root mean square [m/s]; NaN of profiles."""
    if group.usable_linear[0].label.mean is None:
        return np.nan
    return float(np.sqrt(np.mean(update.column.predicted_variance(0, covariance))))
