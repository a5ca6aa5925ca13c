"""Which of the two forms of the posterior is the cheaper one from here on."""

import numpy as np
import scipy.linalg

from replay_kit.estimator.dual import Dual
from replay_kit.estimator.posterior import Posterior
from replay_kit.estimator.span import TOLERANCE, mode_scale, span_of
from replay_kit.types import Array

# Directions for each profile below which the span form is cheaper; at scattered places there are two.
_FEW = 1.25
# Rows for each weight above which the dual form is dearer however the places lie.
_MANY = 1.25
# The first number of profiles at which directions are counted; then at every doubling.
_FIRST = 32


def in_cheaper_form(posterior: Posterior) -> Posterior:
    """Return the same posterior, in the span form when its rows lie in few directions or outnumber the weights.

    Both forms are exact. The dual one starts without any cost, but works on all rows measured; the span form on the directions that they
    have, which along a track are fewer, and never more than the weights. The change costs as much as some dozens of updates and is
    made once.
    """
    if not isinstance(posterior, Dual):
        return posterior
    n, many = posterior.n, posterior.n_rows > _MANY * posterior.prior.mean.size
    # powers of two, because counting costs about as much as an update
    if not many and (n < _FIRST or n & (n - 1)):
        return posterior
    mode_std = mode_scale(posterior.prior)
    found = directions(posterior.places * mode_std)
    return span_of(posterior, found, mode_std) if many or len(found) <= _FEW * n else posterior


def directions(rows: Array) -> Array:
    """Return an orthonormal basis, shape (s, r), of the span of rows, shape (m, r), up to ``span.TOLERANCE`` of the longest."""
    q, r, _ = scipy.linalg.qr(rows.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return np.ascontiguousarray(q[:, size > TOLERANCE * size[0]].T)
