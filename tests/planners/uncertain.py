"""Estimates with errors that plans are tested on."""

from dataclasses import replace
from functools import cache

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build
from tests import synthetic
from tests.planners.flow_samples import eddying_flow
from tests.synthetic_flow import with_weights

NOON = 1_767_268_800 * 10**9


@cache
def static():
    """An estimate before any observation, at a third of its members' current."""
    # without an error of what the basis does not represent
    config = EstimatorConfig(modes=12, representation_error_std=0.0)
    estimator = build([synthetic.ensemble(n_members=8, shape=(9, 11))], config)
    flow = estimator.flow(estimator.initial())
    return replace(flow, latent=0.3 * flow.latent, time_ns=NOON)


def uncertain(flow, speed):
    """A flow whose errors are those of four other eddying flows, alike at all levels, of some RMS speed [m/s]."""
    others = [eddying_flow(100 + k, speed=speed).latent.mean(axis=1) for k in range(4)]
    n_levels = flow.levels.size
    covariance = np.kron(np.ones((n_levels, n_levels)), np.eye(4)) / 4.0
    return with_weights(flow, np.column_stack(others), covariance)
