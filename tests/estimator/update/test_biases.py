"""Errors of the instrument: their effect on a profile, and what a log says of them."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.update.biases import (
    NAMES,
    Biases,
    bias_rows,
    in_words,
    scale_jacobian,
)
from replay_kit.estimator.update.gate import Spectrum, gate_innovations
from replay_kit.studies.twins.adcp import random_observations
from replay_kit.studies.twins.field import build_field
from tests import synthetic
from tests.estimator.evolving.test_extras import faulty

LEVELS = np.array([5.0, 60.0, 150.0, 300.0])
ENSEMBLE = synthetic.ensemble(n_members=24, shape=(6, 7), levels=LEVELS)
OTHERS = Ensemble(ENSEMBLE.grid, ENSEMBLE.velocity[1:], None, "the others")
CONFIG = EstimatorConfig(modes=20, mean_variance=0.1)


def mission(heading, scale, n=110):
    """Profiles of member 0 from a vehicle that goes round, with an instrument's faults."""
    truth = Ensemble(ENSEMBLE.grid, ENSEMBLE.velocity[:1], None, "member 0")
    for k, profile in enumerate(random_observations(build_field(truth), n, 0.05, 7)):
        angle = 0.7 * k
        through_water = 0.3 * np.array([np.cos(angle), np.sin(angle)])
        yield faulty(replace(profile, time_ns=k), heading, scale, through_water, common_std=0.01)


def compressed(rows, velocity):
    """What the rows make of velocities of the used bins."""
    stack = rows.stack
    return (stack.layouts[0].rows[:, stack.used[0]] @ velocity).T.ravel()


def test_a_shear_goes_along_the_way_through_the_water_expected_and_is_what_a_state_says_without_its_own():
    relative, innovation = np.array([[0.2, 0.0]]), np.array([[0.2, -0.3]])
    distance = np.array([0.0, 20.0, 60.0])
    along, measured = (
        bias_rows(np.ones((1, 3)), distance[None], relative, off)[0, ..., NAMES.index("shear")]
        for off in (innovation, 0.0 * innovation)
    )
    np.testing.assert_allclose(along, np.outer([0.0, -1.0], distance), atol=1e-12)
    of_state = Biases(("shear",), np.ones(1))
    column = of_state.functions(10.0 + distance) @ of_state.factor(relative[0])
    np.testing.assert_allclose(measured, column[..., 0])


def test_the_water_s_own_shear_is_no_error_of_the_instrument():
    """Profiles whose shear is the prior's alone, at random: along the way measured it would seem to be one."""
    estimator, rng = build_estimator(OTHERS, CONFIG), np.random.default_rng(5)
    (profile,) = list(mission(0.0, 0.0, 1))
    used, scores = np.arange(6), []
    for _ in range(400):
        velocity = profile.velocity.copy()
        velocity[used] += (
            2e-3 * rng.standard_normal(2) * (profile.depth[used] - profile.depth[0])[:, None]
        )
        sheared = replace(profile, velocity=velocity)
        rows = estimator.rows(sheared, used)
        innovation = rows.stack.values - estimator.rows(profile, used).stack.values
        pairs = [
            rows.stack.bias_rows(off).reshape(-1, len(NAMES))[:, 2]
            for off in (innovation, 0.0 * innovation)
        ]
        of_bins = compressed(rows, innovation[0, used])
        scores.append([column @ of_bins for column in pairs])
    mean, spread = np.mean(scores, axis=0), np.std(scores, axis=0) / np.sqrt(len(scores))
    assert abs(mean[0]) < 3.0 * spread[0]
    assert mean[1] < -10.0 * spread[1]


def test_the_stretch_is_the_slope_of_the_measure_of_what_is_logged():
    """A profile of one bin, with a platform known exactly: two components, so -2 log(1 + s); with a useless platform none."""
    estimator = build_estimator(OTHERS, CONFIG)
    (profile,) = list(mission(0.0, 0.0, 1))
    for common_std, expected in ((0.0, 2.0), (1e3, 0.0)):
        one = replace(profile, common_std=common_std)
        rows = estimator.rows(one, np.arange(1))
        # an innovation as large as its covariance says
        nothing = np.array([0.0]), np.array([0])
        spectrum = Spectrum.of(np.ones((1, 2)), np.zeros((1, 2, 2)))
        gates = gate_innovations(spectrum, np.array([2]), nothing, None)
        found = scale_jacobian(gates, np.ones(1), rows.stack.ones, np.array([common_std]))
        assert found == pytest.approx(expected, abs=1e-3)


@pytest.mark.full
def test_a_sound_log_gives_no_scale_error_on_the_average():
    """The regressor is made of what was measured: without the Jacobian it would find an error in its own noise."""
    estimator = build_evolving([OTHERS], CONFIG, TimeConfig(scale="static", biases=("scale",)))
    static = build_estimator(OTHERS, CONFIG)
    places = list(mission(0.0, 0.0, 40))
    z = []
    for seed in range(16):
        # a truth that the prior itself draws
        rng = np.random.default_rng(seed)
        weights = estimator.operator.process.weights(
            rng.standard_normal(estimator.operator.process.size), 0
        )
        truth = static.flow_of(weights.ravel(), np.empty((0, 0)), None)
        log = []
        for place in places:
            east, north = to_local(ENSEMBLE.grid.projection, place.longitude, place.latitude)
            local = truth.velocity(east, north, np.minimum(place.depth, 300.0))
            u, v = rotate_to_geographic(
                ENSEMBLE.grid.projection, place.longitude, place.latitude, *local.T
            )
            common = 0.03 * rng.standard_normal(2)
            platform = np.array(place.platform_velocity) + common
            velocity = np.column_stack([u, v]) + common + 0.05 * rng.standard_normal(local.shape)
            log.append(
                replace(
                    place,
                    velocity=velocity,
                    platform_velocity=(float(platform[0]), float(platform[1])),
                    common_std=0.03,
                )
            )
        *_, (state, _) = estimator.steps(estimator.initial(), log)
        estimate, std = estimator.biases(state)["scale"]
        z.append(estimate / std)
    assert abs(np.mean(z)) < 3.0 / np.sqrt(len(z))


def test_faults_in_words():
    assert in_words("heading", np.deg2rad(5.0), np.deg2rad(0.5)) == "heading +5.0 +- 0.5 degrees"
    assert in_words("scale", -0.031, 0.002) == "scale -3.1 +- 0.2 %"
    assert in_words("shear", 2e-4, 1e-5) == "shear +0.20 +- 0.01 mm/s a metre"
