"""How far the errors of members left out exceed the stated ones: more where members come in families."""

import numpy as np
import pytest

from replay_kit.estimator.prior.calibration import MembersPrior, calibration, fitted_kernels
from replay_kit.estimator.prior.factor import PriorSettings
from replay_kit.estimator.prior.fit import Members

SETTINGS = PriorSettings(0.95, 0.0, 2e4)


def members_of(families, each):
    """Smooth fields, and variations of them that are alike."""
    rng = np.random.default_rng(1)
    x, y = (axis.ravel() for axis in np.meshgrid(1e4 * np.arange(8), 1e4 * np.arange(7)))

    def field():
        return sum(
            rng.normal() * np.concatenate([np.cos(a * x + p), np.cos(b * y + p)])
            for a, b, p in rng.normal(0.0, 6e-5, (8, 3)) * [1.0, 1.0, 1e5]
        )

    fields = 0.1 * np.array([field() for _ in range(families)])
    near = 0.02 * np.array([[field() for _ in range(each)] for _ in range(families)])
    whole = (fields[:, None] + (near if each > 1 else 0.0)).reshape(families * each, 1, -1)
    weights = np.concatenate([whole, 0.5 * whole], axis=1)
    return Members(weights, np.eye(2 * x.size), np.column_stack([x, y]))


def prior_of(families, each):
    return MembersPrior.of(members_of(families, each), SETTINGS, 1e-3)


def test_it_is_one_or_more_and_larger_for_members_in_families():
    alone, families = (calibration(prior_of(*of)) for of in ((20, 1), (4, 5)))
    assert 1.0 <= alone < 1.5
    assert families > 1.5 * alone


def test_members_in_families_put_more_on_narrow_kernels_than_members_alone():
    alone, families = (fitted_kernels(prior_of(*of)) for of in ((20, 1), (4, 5)))
    for probability in (alone, families):
        assert probability.sum() == pytest.approx(1.0)
        assert (probability > 0.0).all()
    assert alone[0] > 0.5 > families[0]
    np.testing.assert_array_equal(fitted_kernels(prior_of(3, 1)), [0.5, 0.25, 0.25])


@pytest.mark.parametrize("count", [2, 3])
def test_with_too_few_members_to_leave_out_any_it_is_one(count):
    assert calibration(prior_of(count, 1)) == 1.0
