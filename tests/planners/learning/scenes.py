"""Estimates that plans which learn are tested on: small, static and through time."""

from dataclasses import replace
from functools import cache

import numpy as np

from planners.front.current import shares_of_levels
from planners.learning.closed_loop import mean_currents, slices
from planners.learning.comparison import _spaced
from planners.learning.loops import Survey
from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.depth_means import depth_means
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from tests import synthetic

NOON = 1_767_268_800 * 10**9
HOUR = 3600.0
DEPTH, SPEED = 290.0, 0.29
MEMBERS = synthetic.ensemble(n_members=8, shape=(9, 11))
# without an error of what the basis does not represent, which would count as that of the profiles
CONFIG = EstimatorConfig(modes=12, representation_error_std=0.0)


@cache
def estimator():
    """An estimator that does not know of time."""
    return build_estimator(MEMBERS, CONFIG)


@cache
def static():
    """Its estimate before any observation, at a third of the members' current."""
    flow = estimator().flow(estimator().initial())
    return replace(flow, latent=0.3 * flow.latent, time_ns=NOON)


@cache
def through_time(scale_h=40.0):
    """An estimate through two times, two days apart."""
    members = (synthetic.ensemble(n_members=8, seed=seed, shape=(9, 11)) for seed in (0, 1))
    series = [replace(one, time_ns=NOON + k * 48 * 3600 * 10**9) for k, one in enumerate(members)]
    made = build_evolving(series, CONFIG, TimeConfig(scale=scale_h * HOUR))
    return made.flow(made.predict(made.initial(), NOON))


@cache
def known(changes=False):
    """The errors of its mean current over the dives."""
    flow = through_time() if changes else static()
    return depth_means(flow, shares_of_levels(flow, DEPTH, 0.0)[None])


@cache
def mean(changes=False):
    """Its mean current over the dives, for two days."""
    return mean_currents(known(changes), slices(known(changes), 0.0, 48.0 * HOUR))


def places(count, seed=0):
    """Places inside the region, shape (count, 2) [m]."""
    return np.random.default_rng(seed).uniform([-30e3, -25e3], [30e3, 25e3], (count, 2))


def random_waypoints(mapping, rng, count):
    """Profiles on ways past places at random in a map's box: what a plan is to beat."""
    low, high = mapping.box.min(axis=0), mapping.box.max(axis=0)
    places = rng.uniform(low, high, (count, mapping.times.size, 2))
    middles, ends = (
        np.array(part)
        for part in zip(
            *(_spaced(mapping, one[:, 0] + 1j * one[:, 1]) for one in places), strict=True
        )
    )
    return Survey(ends, ends, middles, mapping.profile_times, np.ones(count, dtype=bool))
