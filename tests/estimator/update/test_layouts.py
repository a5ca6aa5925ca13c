"""What an observer remembers of measurements: those alike share it, and nothing that others had counts for one."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.estimator import build
from replay_kit.estimator.update.screening import screened
from tests.estimator.seas import CONFIG, SEA, profiles

ESTIMATOR = build([SEA], CONFIG)
PLAIN = profiles(1)[0].linear
N = len(PLAIN.value)
CORRELATION = 0.5 * (np.eye(N) + 1.0)
EXCHANGED = np.eye(N)[[1, 0, *range(2, N)]]

VARIANTS = {
    "noise": {"error_std": 2.0 * PLAIN.error_std},
    "depth": {"depth": PLAIN.depth + 3.0},
    "common error": {"common_std": 0.1},
    "relative": {"common_std": np.inf},
    "correlated in depth": {"correlation_depth": 40.0},
    "correlated": {"correlation": CORRELATION},
    "exchanged": {"weights": EXCHANGED},
    "fewer": {"flags": np.where(np.arange(N) % 2, PLAIN.flags, 4).astype(np.int8)},
    "elsewhere": {"longitude": PLAIN.longitude + 0.2},
    "one component": {"value": PLAIN.value[:, :1], "components": np.array([[0.6, 0.8]])},
}


def columns(observer, measurements, scale=1.0):
    revised = ESTIMATOR.initial().revised._replace(scale=scale)
    return observer.columns([screened([m], SEA.grid)[0][0] for m in measurements], revised)


def said(column):
    (part,) = column.parts
    (y,), (left,), dof, _ = column.compressed(part)
    rows = column.rows(part) @ column.design
    return rows.T @ rows, rows.T @ y, y @ y + left, dof, part.layout.half_log_det


def assert_alike(one, other):
    for ours, theirs in zip(said(one), said(other), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", VARIANTS)
def test_a_measurement_is_what_it_is_alone_whatever_was_before_and_beside_it(name):
    observer, other = replace(ESTIMATOR.observer), replace(PLAIN, **VARIANTS[name])
    columns(observer, [PLAIN])
    found = columns(observer, [other, PLAIN, other])
    (plain,), (alone,) = (columns(replace(observer), [each]) for each in (PLAIN, other))
    for ours, theirs in zip(found, (alone, plain, alone), strict=True):
        assert_alike(ours, theirs)
    # of values exchanged only what they say differs
    assert max(np.abs(said(alone)[k] - said(plain)[k]).max() for k in (0, 1)) > 1e-3


def test_the_factor_on_the_prior_variance_counts_for_what_is_remembered():
    config = CONFIG.model_copy(update={"dropped_std": 0.05})
    observer = build([SEA], config).observer
    columns(observer, [PLAIN])
    (wide,), (alone,) = (columns(each, [PLAIN], 9.0) for each in (observer, replace(observer)))
    assert_alike(wide, alone)
    (plain,) = columns(observer, [PLAIN])
    assert wide.parts[0].layout.std.min() > plain.parts[0].layout.std.min()


def test_more_measurements_than_are_remembered_are_what_they_are():
    observer = replace(ESTIMATOR.observer)
    many = [replace(PLAIN, depth=PLAIN.depth + 0.1 * k) for k in range(100)]
    for _ in range(2):
        for k in (0, 50, 99):
            (alone,) = columns(replace(observer), [many[k]])
            assert_alike(columns(observer, many)[k], alone)
    assert len(observer._layouts) < 100
