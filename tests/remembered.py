"""The fit of a prior, a fifth of a small replay's time: many tests replay over the same ensemble, whose members are scored once."""

import functools
from collections.abc import Sequence

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.prior import fit
from replay_kit.estimator.prior.fit import Members
from replay_kit.estimator.prior.hybrid import PriorSettings

_found: dict[tuple[object, ...], Array] = {}


@functools.wraps(fit._score_member)
def score_member(
    members: Members,
    modes: ShiftedModes,
    member: int,
    settings: PriorSettings,
    shares: Sequence[float],
) -> Array:
    """Return what the function of this name returns, computed once for the same arguments."""
    arrays = tuple(
        array.tobytes() for array in (members.weights, members.velocity_modes, members.nodes)
    )
    key = (*arrays, members.weights.shape, member, settings, tuple(shares))
    if key not in _found:
        _found[key] = score_member.__wrapped__(members, modes, member, settings, shares)
    return np.copy(_found[key])


# a recording of which test executes which line empties every cache before each test
score_member.cache_clear = _found.clear  # type: ignore[attr-defined]
