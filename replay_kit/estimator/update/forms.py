"""Which form of the posterior is the cheaper one from here on."""

from replay_kit.estimator.update.dense import DensePrior, dense_prior
from replay_kit.estimator.update.directions import directions
from replay_kit.estimator.update.dual import Dual, initial
from replay_kit.estimator.update.posterior import Posterior
from replay_kit.estimator.update.span import Span, mode_scale, span_of

# Directions for each profile below which the span form is cheaper; at scattered places there are two.
_FEW = 1.25
# Rows for each weight above which the dual form is dearer however the places lie.
_MANY = 1.25
# The first number of profiles at which directions are counted; then at every doubling.
_FIRST = 32
# Share of all directions from which the span form is dearer than a dual one that begins anew from the covariance.
_NEARLY_ALL = 0.75
# Rows that are gathered before such a dual form begins anew again.
_FOLDED = 1024


def in_cheaper_form(posterior: Posterior) -> Posterior:
    """Return the same posterior, in the form that is the cheaper one from here on.

    Both forms are exact. The dual one starts without any cost, but works on all rows measured; the span form on the directions that they
    have, which along a track are fewer than the rows. When rows outnumber the weights and have nearly all directions, the posterior becomes
    the prior of a dual form without rows, and again after every few profiles: memory and time for each are then bounded.
    A change costs as much as some dozens of updates.
    """
    if isinstance(posterior, Span):
        return folded(posterior) if posterior.size > _NEARLY_ALL * posterior.mode_std.size else posterior
    assert isinstance(posterior, Dual)
    if isinstance(posterior.prior, DensePrior):
        return folded(posterior) if posterior.n_rows > _FOLDED else posterior
    n, many = posterior.n, posterior.n_rows > _MANY * posterior.prior.mean.size
    # powers of two, because counting costs about as much as an update
    if not many and (n < _FIRST or n & (n - 1)):
        return posterior
    mode_std = mode_scale(posterior.prior)
    found = directions(posterior.places * mode_std)
    if len(found) <= min(_FEW * n, _NEARLY_ALL * mode_std.size):
        return span_of(posterior, found, mode_std)
    return folded(posterior) if many else posterior


def folded(posterior: Dual | Span) -> Dual:
    """Return the same posterior as the prior of one without rows."""
    if isinstance(posterior, Dual) and isinstance(posterior.prior, DensePrior):
        if posterior.n == 0:
            return posterior
        return initial(posterior.prior.less(posterior.mean, posterior.whitened_cross()), posterior.answers())
    return initial(dense_prior(posterior.mean, posterior.covariance(), posterior.n_levels), posterior.answers())


def inflated(posterior: Posterior, factor: float) -> Dual:
    """Return a posterior whose covariance has grown by a factor."""
    assert isinstance(posterior, Dual | Span)
    dense = folded(posterior)
    assert isinstance(dense.prior, DensePrior)
    return initial(DensePrior(dense.prior.mean, factor * dense.prior.blocks), dense.prior_answers)
