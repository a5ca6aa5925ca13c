"""Logs passed through an estimator one observation at a time, as online; and what tests ask of them."""

import numpy as np
import pytest


def run(estimator, observations, state=None):
    """Return the last state, and all innovations."""
    state, innovations = state or estimator.initial(), []
    for observation in observations:
        state, innovation = estimator.step(state, observation)
        innovations.append(innovation)
    return state, innovations


def after(estimator, observations, state=None):
    """Return the last state."""
    return run(estimator, observations, state)[0]


def rows_of(estimator, observations):
    """The design and the values of all rows of observations within the grid."""
    deepest = estimator.grid.levels[-1]
    rows = [estimator.rows(each, np.flatnonzero(each.depth <= deepest)) for each in observations]
    return np.concatenate([each.design() for each in rows]), np.concatenate(
        [each.y for each in rows]
    )


def assert_static(evolving, static, observations, rel, atol):
    """An estimator through time without change is the static one."""
    (state, said), (other, same) = (run(each, observations) for each in (static, evolving))
    assert [each.nis for each in same] == pytest.approx([each.nis for each in said], rel=rel)
    np.testing.assert_allclose(evolving.weights([other])[0], state.mean, atol=atol)


def assert_alike(said, expected, rel, atol):
    for ours, theirs in zip(said, expected, strict=True):
        assert ours.nis == pytest.approx(theirs.nis, rel=rel)
        for name in ("innovation", "innovation_std", "residual", "prior_innovation"):
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=atol)
