"""The innovations to publish: of each measurement that the gate rejects, and of the accepted ones of a column together."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.observation import Flag, GroupTotals, Innovation, reasons_of
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.state import State
from replay_kit.estimator.update.assimilate import Update
from replay_kit.estimator.update.columns import Column
from replay_kit.estimator.update.grouping import ProfileGroup, mean_time
from replay_kit.estimator.update.screening import Screened


def outcomes(
    group: Sequence[Screened],
    update: Update | None,
    before: State,
    against: Callable[[State], Array] | None,
) -> list[Stepped[State]]:
    """Return the outcome of each measurement of a group that is not used or rejected, and then of the accepted ones together.

    Args:
        group: After screening.
        update: What those that are used did; None where none is.
        before: The state before them.
        against: As of ``Stepped``.
    """
    unused = [one for one in group if not one.is_used]
    found = [Stepped(one.event, before, before, one.unused()) for one in unused]
    if update is None:
        return found
    assert update.after is not None
    used, accepted = update.column.screened, list[int]()
    for i, judgement in enumerate(update.judgements):
        if judgement.accepted:
            accepted.append(i)
        else:
            # nothing changes
            moments: Any = {"mean_after": update.before, "covariance_after": update.covariance}
            same = replace(update, **moments, signal=0.0, log_likelihood=np.nan)
            found.append(Stepped(used[i].event, before, before, _innovation(same, [i])))
    if accepted:
        # Any: what is grouped are profiles
        events: Any = tuple(used[i].event for i in accepted)
        event = ProfileGroup(events) if len(events) > 1 else events[0]
        known = against if len(accepted) == len(used) else None
        factors = [1.0 / update.judgements[i].error_factor for i in accepted]
        innovation = replace(
            _innovation(update, accepted),
            accepted=True,
            decision="accepted",
            error_inflation=len(factors) / sum(factors),
        )
        found.append(Stepped(event, before, update.after, innovation, known))
    return found


def _innovation(update: Update, at: Sequence[int]) -> Innovation:
    """Return the innovation of some of the measurements of a column together: means over them, and sums."""
    column, judgements = update.column, [update.judgements[i] for i in at]
    own, first = [column.screened[i] for i in at], column.screened[at[0]].unused()
    means = np.stack([update.before, update.mean_after, np.zeros_like(update.before)])
    noise, shown = np.sum(column.axes**2, axis=0), list[Array]()
    for i, one in zip(at, own, strict=True):
        predicted = column.predicted_variance(i, update.covariance)
        stated = np.outer(column.layouts[i].std ** 2, noise)
        value = column.measured(i, update.mean_after)
        shown.append(one.among(np.array([*column.misfit(i, means), predicted, stated, value])))
    mean, counts, totals, flags = shown[0], np.ones(1), None, first.flags
    dof = sum(one.rows + one.left for one in judgements)
    if len(at) > 1:
        each = np.stack(shown, axis=1)
        # of a value that no measurement uses the mean is NaN
        counts, total = np.isfinite(each[0]).sum(axis=0), np.nansum(each, axis=1)
        mean = np.divide(total, counts, out=np.full(total.shape, np.nan), where=counts > 0)
        flags = np.where(counts[:, 0] > 0, Flag.GOOD, flags).astype(np.int8)
        before, left, against = np.nansum(each[:3] ** 2, axis=(1, 2, 3)).tolist()
        reasons, of_bins = (
            np.array([getattr(one, name) for one in own]) for name in ("reasons", "flags")
        )
        totals = GroupTotals(dof // 2, before, left, against, tuple(reasons_of(reasons, of_bins)))
    innovation, residual, prior, of_estimate, of_noise, measured = mean
    estimated_std = np.nan
    if own[0].linear.label.mean is not None:
        variance = column.predicted_variance(0, update.covariance_after)
        estimated_std = float(np.sqrt(np.mean(variance)))
    return replace(
        first,
        time_ns=mean_time([one.event for one in own]),
        flags=flags,
        depth=np.mean([one.linear.value_depth for one in own], axis=0),
        innovation=innovation,
        # the estimate's error is shared, the noise is not
        innovation_std=np.sqrt(of_estimate + of_noise / np.maximum(counts, 1)),
        residual=residual,
        prior_innovation=prior,
        measured=measured,
        nis=sum(one.nis for one in judgements),
        dof=dof,
        decision="rejected",
        gate_statistic=judgements[0].statistic,
        gate=judgements[0].threshold,
        signal_dof=update.signal,
        log_likelihood=update.log_likelihood,
        estimated_std=estimated_std,
        profiles=len(at),
        totals=totals,
    )


def misfits(group: Sequence[Screened], column: Column, mean: Array) -> Array:
    """Return measured minus predicted values of all measurements of a group, shape (n m, 2) [m/s]; NaN, or 0 of several, where not used."""
    used = iter(one.among(column.misfit(i, mean)) for i, one in enumerate(column.screened))
    if len(group) == 1:
        return next(used)
    nothing = np.zeros((group[0].flags.size, 2))
    return np.concatenate([np.nan_to_num(next(used)) if one.is_used else nothing for one in group])
