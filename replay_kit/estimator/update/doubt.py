"""A prior that is far too narrow: what its first measurements say when it rejects most of them.

A gate that rejects all would keep a wrong estimate for ever. Single faults are few, and an instrument that fails at first gets better;
where most of the first measurements are rejected, and the latest too, it is the ensemble that does not hold this water. Its variance
is then multiplied by the likeliest factor, and what was rejected is assimilated under it.
"""

from collections.abc import Sequence

import numpy as np

from replay_kit.core.arrays import replace
from replay_kit.estimator.state import Doubt, State
from replay_kit.estimator.update.assimilate import assimilate
from replay_kit.estimator.update.columns import Column
from replay_kit.estimator.update.evidence import of_scales, with_variance

#: Columns after which the prior's variance is no longer doubted.
MOST = 16
# Columns from which on it is, the share of them that is rejected then, and how many of the latest four are.
_LEAST, _SHARE, _LATEST = 10, 0.6, 3
_SCALES = 2.0 ** np.arange(0.0, 9.0)


def noted(state: State, column: Column, rejected: bool) -> State:
    """Return the state with the decision on a column."""
    if state.doubt is None:
        return state
    if len(state.doubt.rejected) + 1 >= MOST and not rejected:
        return replace(state, doubt=None)
    columns = (*state.doubt.columns, column) if rejected else state.doubt.columns
    return replace(state, doubt=Doubt((*state.doubt.rejected, rejected), columns))


def is_refuted(doubt: Doubt | None) -> bool:
    """Return whether the first columns speak against the prior's variance."""
    if doubt is None or len(doubt.rejected) < _LEAST:
        return False
    share = sum(doubt.rejected) / len(doubt.rejected)
    return share >= _SHARE and sum(doubt.rejected[-4:]) >= _LATEST


def rescaled(state: State, part: slice) -> State:
    """Return the state with the likeliest prior variance of some unknowns, and with the columns that were rejected.

    Args:
        state: With columns that speak against the prior.
        part: The unknowns.
    """
    assert state.doubt is not None
    columns: Sequence[Column] = state.doubt.columns
    x, p, root = state.x, state.covariance, np.sqrt(state.scale)
    misfit, determinant, _ = of_scales(x[part] / root, p[part, part] / state.scale, _SCALES)
    before = -0.5 * (misfit + determinant)
    found = []
    for scale, evidence in zip(_SCALES.tolist(), before.tolist(), strict=True):
        begun = state.with_moments(*with_variance(x, p, part, state.scale, state.scale * scale))
        begun = replace(begun, doubt=None, scale=state.scale * scale)
        after, updates = assimilate(begun, columns, None)
        found.append((evidence + sum(update.log_likelihood for update in updates), after))
    times = [
        *(column.time_ns for column in columns),
        columns[0].time_ns if state.time_ns is None else state.time_ns,
    ]
    return replace(max(found, key=lambda each: each[0])[1], time_ns=max(times))
